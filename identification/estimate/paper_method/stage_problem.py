"""Formulates one stage of the paper's equation error (eq. 15, 16) as a bounded problem for any
optimiser.

All optimisers use the same samples, the same cost sqrt(sum e(k)^2), the same box and the
coordinates of the paper: x = [Mc, Ms, omega_sf, sigma_2, J] without load, x = [mu_c, mu_s,
omega_sL, mu_2] with load. The coordinates are scaled to the unit cube, so that equal steps are
equal shares of the box in all coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from identification.estimate.paper_method.paper import STAGES, StageSamples, collect, search_box
from identification.estimate.paper_method.torque_misfit import TorqueMisfit
from identification.model.friction import stribeck_shape
from identification.numerics.arrays import Array
from identification.numerics.bounded_least_squares import Design
from identification.prepare import Prepared


class StageProblem:
    """Cost and residuals of one stage over the unit cube, with a counter of evaluations.

    Args:
        stage: ``unloaded`` or ``loaded``.
        prepared: Recordings of the stage.
        known: The system parameters, which are fixed in the search of the loaded stage.
        alpha: Stribeck exponent.
    """

    def __init__(
        self, stage: str, prepared: Sequence[Prepared], known: Mapping[str, float], alpha: float
    ) -> None:
        self.stage = stage
        self.names = STAGES[stage]
        self.samples: StageSamples = collect(stage, prepared, known, alpha)
        box = search_box(self.samples, self.names)
        self.low = np.array([box[name][0] for name in self.names])
        self.high = np.array([box[name][1] for name in self.names])
        self.evaluations = 0
        self._alpha = alpha
        s = self.samples
        self._misfit = TorqueMisfit(s.torque, s.velocity, s.acceleration, s.load, alpha)
        self._dry = s.load * np.sign(s.velocity)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.names)

    def named(self, x: Array) -> dict[str, float]:
        """Return the parameters at ``x`` of the unit cube, shape (d,), by name."""
        return dict(zip(self.names, (float(v) for v in self._physical(x)), strict=True))

    def costs(self, x: Array) -> Array:
        """Return the cost of every row of ``x``, shape (p, d), N m."""
        self.evaluations += len(x)
        coulomb, static, speed, viscous, *inertia = self._physical(x).T
        return self._misfit.norms(
            coulomb, static, speed, viscous, inertia[0] if inertia else np.zeros(len(x))
        )

    def residuals(self, x: Array) -> Array:
        """Return the torque error of every sample at ``x``, shape (d,), N m."""
        self.evaluations += 1
        coulomb, static, speed, viscous, *inertia = self._physical(x)
        s = self.samples
        shape = stribeck_shape(s.velocity, speed, self._alpha)
        friction = (
            s.load * ((static - coulomb) * shape + viscous * s.velocity) + coulomb * self._dry
        )
        return np.asarray(s.torque - friction - (inertia[0] if inertia else 0.0) * s.acceleration)

    def design(self, omega_s: float) -> Design:
        """Return the linear least-squares problem at one Stribeck speed, for variable projection;
        the rise replaces the static level.
        """
        s = self.samples
        shape = s.load * stribeck_shape(s.velocity, omega_s, self._alpha)
        columns = [self._dry, shape, s.load * s.velocity]
        columns += [s.acceleration] if self.size > 4 else []
        kept = [0, 1, 3, 4][: len(columns)]
        self.evaluations += 1
        return Design(np.column_stack(columns), s.torque, np.zeros(len(columns)), self.high[kept])

    def unlinear(self, omega_s: float, coefficients: Array) -> Array:
        """Return a solution of :meth:`design` as a point of the unit cube, shape (d,)."""
        coulomb, rise, *others = coefficients
        physical = np.array([coulomb, coulomb + rise, omega_s, *others])
        return np.asarray((physical - self.low) / (self.high - self.low))

    def _physical(self, x: Array) -> Array:
        return np.asarray(self.low + x * (self.high - self.low))
