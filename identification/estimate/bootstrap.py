"""Computes the spread of the estimates by a bootstrap: motion segments are drawn with replacement.

The bootstrap assumes only that the errors of different segments are independent. It therefore
checks intervals that depend on a noise model (Efron and Tibshirani, An Introduction to the
Bootstrap, 1993, ch. 8). Each draw solves the estimating equations with every segment counted as
often as it was drawn; weights, noise levels and the instrument of the inertia are those of the
estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from identification.estimate.inertia import influence_on_inertia, instruments
from identification.estimate.searches import Refined
from identification.filter.likelihood import HUBER_THRESHOLD, Point
from identification.model.parameters import INDEX, INERTIA, LOGARITHMIC, unpack
from identification.numerics.arrays import Array
from identification.numerics.least_squares import BlockArrow, huber_weight
from identification.numerics.spread import CONFIDENCE
from identification.result import Resampled

_ROUNDS = 6
_SETTLED = 0.1
"""Step, in standard deviations, below which the equations of a draw count as solved."""
_LONGEST = 3.0
"""Greatest step of an iteration, in standard deviations."""


def bootstrap(
    refined: Refined,
    units: Mapping[str, str],
    draws: int,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Resampled, ...]:
    """Return the spread of every parameter over bootstrap draws of each recording's segments.

    Args:
        refined: The estimate.
        units: Parameter name to unit.
        draws: Number of bootstrap draws.
        rng: Random generator for the draws.
        progress: Called with the share of the draws that is done.

    Returns:
        One result per parameter; its bounds are None if the equations of fewer than half of the
        draws were solved.
    """
    joint = refined.joint
    equations = _Equations(joint, _deviations(refined))
    values: dict[str, list[float]] = {name: [] for name in refined.names}
    for k in range(draws):
        found = equations.solve(_counts(joint, rng))
        if found is not None:
            for name, value in unpack(joint.parameters(found), refined.names).items():
                values[name].append(value)
        progress((k + 1) / draws)
    tails = (0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE)
    out = []
    for name in refined.names:
        low, high = (
            np.quantile(values[name], tails).tolist()
            if 2 * len(values[name]) > draws
            else (None, None)
        )
        out.append(Resampled(name, units[name], low, high, draws, len(values[name])))
    return tuple(out)


def _counts(point: Point, rng: np.random.Generator) -> Array:
    """Return how often each segment is drawn among the segments of its recording, shape (m,)."""
    sizes = [len(m.table) for m in point.motions]
    return np.concatenate(
        [rng.multinomial(size, np.full(size, 1.0 / size)) for size in sizes]
    ).astype(np.float64)


def _deviations(refined: Refined) -> Array:
    """Return the standard deviation of every free parameter, in the units of the free vector, shape
    (p,).
    """
    by_place = dict(
        zip((INDEX[n] for n in refined.names), np.sqrt(np.diag(refined.covariance)), strict=True)
    )
    values = refined.joint.vector
    return np.array(
        [by_place[k] / (values[k] if k in LOGARITHMIC else 1.0) for k in refined.joint.free]
    )


class _Equations:
    """Estimating equations near the estimate: the normal equations of least squares for all
    parameters except the inertia, and the estimating equation of the inertia.
    """

    def __init__(self, point: Point, deviations: Array) -> None:
        self.deviations = deviations
        self.held = point.weighted()
        self.origin = point.origin()
        residual = self.held.residuals(self.origin)
        jacobian = self.held.jacobian(self.origin, residual)
        self.begun = (residual, jacobian)
        self.inertia = point.free.index(INERTIA) if INERTIA in point.free else None
        self.influence = np.zeros(0)
        if self.inertia is not None:
            z = instruments(point, jacobian)
            self.influence = influence_on_inertia(point, z, jacobian, residual)
        # The search may have ended at a small distance from the solution of these equations; draws
        # are compared with this solution.
        self.rest = self.sums(residual, jacobian, np.ones(point.breakaways))[0]
        self.rest[len(deviations) :] = 0.0

    def sums(self, residual: Array, jacobian: BlockArrow, counts: Array) -> tuple[Array, Array]:
        """Return the left sides of the equations and their derivatives, shapes (x,) and (x, x),
        with each segment counted ``counts`` times.
        """
        weight = huber_weight(residual, HUBER_THRESHOLD) * counts[jacobian.owners]
        side = jacobian
        if self.inertia is not None:
            columns = jacobian.parameters.copy()
            columns[:, self.inertia] = self.influence
            side = replace(jacobian, parameters=columns)
        return side.back(weight * residual), side.product(weight, jacobian)

    def solve(self, counts: Array) -> Array | None:
        """Return the free vector that solves the equations with each segment counted ``counts``
        times, or None if the search does not converge.
        """
        x = self.origin.copy()
        residual, jacobian = self.begun
        for _ in range(_ROUNDS):
            value, slope = self.sums(residual, jacobian, counts)
            scale = np.sqrt(np.maximum(np.abs(np.diag(slope)), 1e-300))
            step = (
                -(
                    np.linalg.pinv(slope / np.outer(scale, scale), rcond=1e-10)
                    @ ((value - self.rest) / scale)
                )
                / scale
            )
            size = float(np.max(np.abs(step[: len(self.deviations)]) / self.deviations))
            x = x + min(1.0, _LONGEST / max(size, 1e-300)) * step
            if size < _SETTLED:
                return x
            residual = self.held.residuals(x)
            if not np.all(np.isfinite(residual)):
                return None
            jacobian = self.held.jacobian(x, residual)
        return None
