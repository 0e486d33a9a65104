"""Compares the motor constants that a fit of the predicted angle gives with the declared constants
(M51).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.prediction.coordinates import CONSTANTS
from identification.estimate.prediction.loop_fit import LoopFit, pulls
from identification.estimate.prediction.pieces import Piece
from identification.numerics.arrays import Array
from identification.numerics.spread import Spread

KM, RESISTANCE = CONSTANTS
PER_VOLT = "torque_per_volt"
"""Km i / R, N m/V: the combination of torque constant and resistance that a voltage and an angle
determine well.
"""


@dataclass(frozen=True)
class Constant:
    """A motor constant: its declared and its fitted value.

    Attributes:
        name: ``torque_constant``, ``resistance`` or ``torque_per_volt``.
        unit: SI.
        declared: Declared value.
        prior: Relative standard deviation of the declared value, or None for a derived constant.
        value: Fitted value.
        low: Lower end of the 90 % interval of the fitted value.
        high: Upper end of the 90 % interval of the fitted value.
        moved: Whether the interval excludes the declared value.
    """

    name: str
    unit: str
    declared: float
    prior: float | None
    value: float
    low: float
    high: float

    @property
    def change(self) -> float:
        """Relative change from the declared value."""
        return self.value / self.declared - 1.0

    @property
    def moved(self) -> bool:
        """Whether the interval excludes the declared value."""
        return not self.low <= self.declared <= self.high


def constants(pieces: Sequence[Piece], found: LoopFit, points: Array) -> tuple[Constant, ...]:
    """Return the motor constants of a fit in which they were free.

    The interval is the wider of two intervals: from the curvature of cost and priors at the
    minimum, and from the fits to drawn recordings.

    Args:
        pieces: The fitted pieces of recordings.
        found: The fit.
        points: Coordinates of the drawn fits, shape (r, p).
    """
    c = found.coordinates
    if not c.prior:
        return ()
    normals, _ = pulls(pieces, found)
    prior = np.array([1.0 / c.prior[n] ** 2 if n in c.prior else 0.0 for n in c.names])
    inner = (found.x > c.box.low) & (found.x < c.box.high)
    curvature = (np.sum(normals, axis=0) + np.diag(prior))[np.ix_(inner, inner)]
    covariance = np.zeros((len(c.names), len(c.names)))
    covariance[np.ix_(inner, inner)] = np.linalg.pinv(curvature, hermitian=True)
    bench = pieces[0].recording.bench
    km, r = bench.torque_constant, bench.resistance
    assert km is not None
    assert r is not None
    freedom = len({p.recording.name for p in pieces}) - 1.0
    scatter = np.zeros_like(covariance)
    if len(points) > 1:
        scatter = np.atleast_2d(np.cov(points, rowvar=False))
    both = [Spread(c.names, each, max(freedom, 1.0)) for each in (covariance, scatter)]
    at = dict(zip(c.names, found.x, strict=True))
    rows: tuple[tuple[str, str, float, float | None, dict[str, float]], ...] = (
        (KM, "N m/A", km, c.prior[KM], {KM: 1.0}),
        (RESISTANCE, "ohm", r, c.prior[RESISTANCE], {RESISTANCE: 1.0}),
        (PER_VOLT, "N m/V", km * bench.gear_ratio / r, None, {KM: 1.0, RESISTANCE: -1.0}),
    )
    made = []
    for name, unit, declared, std, weights in rows:
        ratio = sum(weight * at[n] for n, weight in weights.items())
        half = max(spread.half_width_along(weights) for spread in both)
        value, low, high = (declared * math.exp(ratio + side * half) for side in (0.0, -1.0, 1.0))
        made.append(Constant(name, unit, declared, std, value, low, high))
    return tuple(made)
