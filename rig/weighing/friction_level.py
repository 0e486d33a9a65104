"""Computes the friction of a motion by speed: work over distance.

Work is used instead of instantaneous torque: current noise averages out, no acceleration is needed,
and the inertia's work in acceleration and deceleration cancels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig.config.sequence import Array

EDGES = np.geomspace(2e-3, 4.0, 67)
"""Edges of the speed bins, rad/s; all motions have these bins, so that levels can be compared bin
by bin.
"""
SPEED_WINDOW_S = 0.006
"""Time over which the speed is computed, s: shorter than the slips of a loaded joint (about 20
ms).
"""
SLOWEST_SHARE = 0.2
"""Least speed that is used, as a share of the greatest speed; at lower speeds friction changes
steeply with speed, and the encoder quantisation is large.
"""
FEWEST_SAMPLES = 100


@dataclass(frozen=True)
class FrictionLevel:
    """Measured friction against speed.

    Attributes:
        speed: Mean speed in each bin, rad/s, shape (66,); 0 in empty bins.
        torque: Mean friction torque in each bin, N m, shape (66,).
        path: Distance moved in each bin, rad, shape (66,), which is the weight of the bin.
    """

    speed: Array
    torque: Array
    path: Array


def friction_level(angle: Array, torque: Array, period_s: float) -> FrictionLevel | None:
    """Measure the friction of a motion.

    Args:
        angle: Joint angle at evenly spaced instants, rad, shape (n,).
        torque: Mean torque at the joint over the period that ends at each instant, N m, shape (n,).
        period_s: Sampling period, s.

    Returns:
        The level, or None if there is too little motion.
    """
    half = max(1, round(0.5 * SPEED_WINDOW_S / period_s))
    if len(angle) < 2 * half + FEWEST_SAMPLES:
        return None
    speed = (angle[2 * half :] - angle[: -2 * half]) / (2 * half * period_s)
    middle = slice(half, len(angle) - half)
    step = np.diff(angle, prepend=angle[0])[middle]
    power_sign = np.sign(speed)
    magnitude = np.abs(speed)
    used = magnitude >= max(SLOWEST_SHARE * float(magnitude.max()), EDGES[0])
    if np.count_nonzero(used) < FEWEST_SAMPLES:
        return None
    way = (power_sign * step)[used]
    bins = np.clip(np.digitize(magnitude[used], EDGES) - 1, 0, len(EDGES) - 2)

    def summed(values: Array) -> Array:
        return np.asarray(np.bincount(bins, values, minlength=len(EDGES) - 1))

    path = summed(way)
    seen = path > 0.0
    safe = np.where(seen, path, 1.0)
    return FrictionLevel(
        speed=np.where(seen, summed(way * magnitude[used]) / safe, 0.0),
        torque=np.where(seen, summed(torque[middle][used] * step[used]) / safe, 0.0),
        path=np.where(seen, path, 0.0),
    )
