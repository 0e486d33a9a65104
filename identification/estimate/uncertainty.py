"""Computes profile likelihoods and bootstrap spreads of the parameters (docs/method.md, M45).

The deviance of a profile consists of the likelihood at an inertia and of a score test of the
inertia's estimating equation (Rao, Proceedings of the Cambridge Philosophical Society 44 (1948)
50), scaled so that its curvature agrees with the interval (Chandler and Bate, Biometrika 94 (2007)
167). The bootstrap draws motion segments with replacement, and assumes only that the errors of
different segments are independent (Efron and Tibshirani, An Introduction to the Bootstrap, 1993,
ch. 8). Each draw solves the estimating equations with every segment counted as often as it was
drawn; weights, noise levels and the instrument of the inertia are those of the estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy import special

from identification.estimate.covariance import rise_to_static
from identification.estimate.inertia import influence_on_inertia, instruments
from identification.estimate.searches import Refined
from identification.filter.likelihood import HUBER_THRESHOLD, Point
from identification.model.parameters import INDEX, INERTIA, LOGARITHMIC, unpack
from identification.numerics.arrays import Array
from identification.numerics.least_squares import BlockArrow, Eliminated, huber_cost, huber_weight
from identification.numerics.spread import CONFIDENCE
from identification.result import Profile, Resampled

REACH = (0.8, 1.6, 2.4, 3.2)
"""Distances of the points of a profile from the estimate, in standard deviations."""
LEVEL = float(2.0 * special.gammaincinv(0.5, CONFIDENCE))  # deviance at the ends of the 90 % range
_GAIN = 0.003  # decrease of half the deviance in a step, below which no further step is taken
_ROUNDS = 6
_HALVINGS = 4
_DEGREE = 4


class _Criterion:
    """Half the deviance (M45) above its minimum; ``curve`` depends on log J alone."""

    def __init__(self, point: Point) -> None:
        self.held = point.weighted()
        self.x = point.origin()
        self.count = len(point.free)
        self.inertia = point.free.index(INERTIA) if INERTIA in point.free else None
        self.curve = np.polynomial.Polynomial([0.0])
        self._cost = 0.0
        held = np.zeros(self.count)
        if self.inertia is not None:
            held[self.inertia] = 1.0
        self.x, self.residual, self._cost = self.descend(self.x, held)

    def value(self, x: Array, residual: Array) -> float:
        return (
            huber_cost(residual, HUBER_THRESHOLD) - self._cost + float(self.curve(self._shift(x)))
        )

    def _shift(self, x: Array) -> float:
        return 0.0 if self.inertia is None else float(x[self.inertia] - self.x[self.inertia])

    def normal(self, x: Array, residual: Array) -> tuple[Array, Array, Eliminated]:
        """Return normal matrix (p, p), gradient (p,), and normal equations of the Huber cost."""
        cost = self.held.jacobian(x, residual).eliminated(
            residual, huber_weight(residual, HUBER_THRESHOLD)
        )
        matrix, gradient = cost.matrix.copy(), cost.scores.sum(axis=0)
        if self.inertia is not None:
            matrix[self.inertia, self.inertia] += self.curve.deriv(2)(self._shift(x))
            gradient[self.inertia] += self.curve.deriv(1)(self._shift(x))
        return matrix, gradient, cost

    def descend(self, x: Array, along: Array) -> tuple[Array, Array, float]:
        """Minimise the criterion from ``x``, with ``along`` @ parameters fixed; return the end
        point, its residuals and its criterion.

        If ``along`` is zero, all parameters are free.
        """
        residual = self.held.residuals(x)
        value = self.value(x, residual)
        for _ in range(_ROUNDS):
            matrix, gradient, cost = self.normal(x, residual)
            inverse = _inverse(matrix)
            back = inverse @ along
            free = inverse @ gradient
            held = float(along @ back)
            step = np.asarray((back * ((along @ free) / held) if held > 0.0 else 0.0) - free)
            if 0.5 * float(cost.pull @ (cost.pull / cost.held) - gradient @ step) < _GAIN:
                break
            whole = np.concatenate([step, cost.own_step(step)])
            for k in range(_HALVINGS):
                there = x + 0.5**k * whole
                tried = self.held.residuals(there)
                least = self.value(there, tried)
                if least < value:
                    x, residual, value = there, tried, least
                    break
            else:
                break
        return x, residual, value


def profiles(
    refined: Refined,
    units: Mapping[str, str],
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Profile, ...]:
    """Return the profile of every parameter of a refined estimate."""
    joint = refined.joint
    criterion = _Criterion(joint)
    names = refined.names
    deviations = dict(zip(names, np.sqrt(np.diag(refined.covariance)), strict=True))
    logarithmic = {n for n in names if INDEX[n] in LOGARITHMIC}
    directions = dict(zip(names, _directions(joint, names), strict=True))
    found: dict[str, tuple[Array, Array, float]] = {}
    if "J" in names:
        sigma = deviations["J"] / refined.values["J"]
        found["J"] = (*_inertia(criterion, directions["J"], sigma), 1.0)
    start, _, _ = criterion.normal(criterion.x, criterion.residual)
    for k, name in enumerate(names):
        if name not in found:
            sigma = deviations[name] / (refined.values[name] if name in logarithmic else 1.0)
            shape = _tangent(start, directions[name])
            scale = float(shape @ start @ shape) ** -1 / sigma**2
            steps, values, _ = _walk(criterion, directions[name], shape, sigma)
            found[name] = steps, 2.0 * values, scale
        progress((k + 1) / len(names))
    out = []
    least = unpack(joint.parameters(criterion.x), names)
    for name in names:
        steps, deviance, scale = found[name]
        here = least[name]
        values = here * np.exp(steps) if name in logarithmic else here + steps
        low, high = crossings(values, scale * deviance)
        out.append(Profile(name, units[name], values, scale * deviance, low, high, scale))
    return tuple(out)


def crossings(values: Array, deviance: Array) -> tuple[float | None, float | None]:
    """Return the values at which the deviance crosses :data:`LEVEL`, below and above its minimum;
    None on a side without a crossing.

    The square root of the deviance is interpolated linearly, which is exact for a parabolic
    deviance.
    """
    root, level = np.sqrt(np.maximum(deviance, 0.0)), LEVEL**0.5
    middle = int(np.argmin(deviance))
    ends: list[float | None] = []
    for way in (-1, 1):
        side = slice(middle, None, way)
        above = np.flatnonzero(root[side] >= level)
        if not above.size:
            ends.append(None)
            continue
        k = int(above[0])
        (a, b), (x, y) = root[side][k - 1 : k + 1], values[side][k - 1 : k + 1]
        ends.append(float(x + (y - x) * (level - a) / (b - a)))
    return ends[0], ends[1]


def _directions(point: Point, names: tuple[str, ...]) -> Array:
    """Return each named parameter as a row of weights of the free vector, shape (p, p)."""
    order = [point.free.index(INDEX[n]) for n in names]
    out = np.zeros((len(names), len(names)))
    out[:, order] = rise_to_static(names)
    return out


def _walk(
    criterion: _Criterion, along: Array, shape: Array, sigma: float
) -> tuple[Array, Array, list[Array]]:
    """Return steps of ``along`` @ parameters, rising, with criterion and residuals at each."""
    found = [(0.0, 0.0, criterion.residual)]
    for way in (-1.0, 1.0):
        x, at = criterion.x.copy(), 0.0
        for reach in REACH:
            goal = way * reach * sigma
            x = x.copy()
            x[: criterion.count] += shape * (goal - at)
            x, residual, value = criterion.descend(x, along)
            at = goal
            found.append((goal, value, residual))
    steps, values, residuals = zip(*sorted(found, key=lambda step: step[0]), strict=True)
    return np.array(steps), np.array(values), list(residuals)


def _inertia(criterion: _Criterion, along: Array, sigma: float) -> tuple[Array, Array]:
    """Return steps of log J with deviance Q, and store Q/2 less the least Huber cost."""
    held, x, here = criterion.held, criterion.x, criterion.residual
    jacobian = held.jacobian(x, here)
    influence = influence_on_inertia(held.point, instruments(held.point, jacobian), jacobian, here)

    def equation(residual: Array) -> float:
        return float(influence @ (residual * huber_weight(residual, HUBER_THRESHOLD)))

    shape = _tangent(criterion.normal(x, here)[0], along)
    t, least, residuals = _walk(criterion, along, shape, sigma)
    errors = np.array([equation(residual) for residual in residuals]) - equation(here)
    deviance = (errors / sigma) ** 2
    powers = (t / sigma)[:, None] ** np.arange(1, _DEGREE + 1)
    coefficients = np.linalg.lstsq(powers, 0.5 * deviance - least, rcond=None)[0]
    criterion.curve = np.polynomial.Polynomial(
        [0.0, *(coefficients / sigma ** np.arange(1, _DEGREE + 1))]
    )
    return t, deviance


def _tangent(normal: Array, along: Array) -> Array:
    """Return the change of parameters per unit of ``along`` @ them at least cost."""
    follow = _inverse(normal) @ along
    return np.asarray(follow / (along @ follow))


def _inverse(matrix: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(
        np.linalg.pinv(matrix / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    )


_SETTLED = 0.1  # step, in standard deviations, below which the equations of a draw count as solved
_LONGEST = 3.0  # greatest step of an iteration, in standard deviations


def bootstrap(
    refined: Refined,
    units: Mapping[str, str],
    draws: int,
    rng: np.random.Generator,
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[Resampled, ...]:
    """Return the spread of every parameter over bootstrap draws of each recording's segments.

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
    """Return the deviation of every free parameter, in units of the free vector, (p,)."""
    by_place = dict(
        zip((INDEX[n] for n in refined.names), np.sqrt(np.diag(refined.covariance)), strict=True)
    )
    values = refined.joint.vector
    return np.array(
        [by_place[k] / (values[k] if k in LOGARITHMIC else 1.0) for k in refined.joint.free]
    )


class _Equations:
    """Estimating equations near the estimate: least squares, and that of the inertia."""

    def __init__(self, point: Point, deviations: Array) -> None:
        self.deviations = deviations
        self.held, self.origin, residual, jacobian = point.linearised()
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
        """Return the equations (x,) and derivatives (x, x), segments counted ``counts`` times."""
        weight = huber_weight(residual, HUBER_THRESHOLD) * counts[jacobian.owners]
        side = jacobian
        if self.inertia is not None:
            columns = jacobian.parameters.copy()
            columns[:, self.inertia] = self.influence
            side = replace(jacobian, parameters=columns)
        return side.back(weight * residual), side.product(weight, jacobian)

    def solve(self, counts: Array) -> Array | None:
        """Return the solution with segments counted ``counts`` times; None if it diverges."""
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
