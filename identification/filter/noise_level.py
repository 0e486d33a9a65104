"""Estimates the noise levels of torque and angle from recordings by least deviance (M24-M26)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import optimize

from identification.filter.kalman import DIRECTION, FIRST, LAST
from identification.filter.likelihood import Point
from identification.filter.segments import Motion, Noise
from identification.numerics.arrays import Array

HUBER_THRESHOLD = 4.0
"""Size of an innovation, in standard deviations, above which it counts as an outlier."""
_FARTHEST_LOG = 4.0
_SIMPLEX, _MOST = ((0.0, -1.0), (0.5, -1.0), (0.0, 0.5)), 30
_SIMPLEX_CORRELATED = (
    (0.0, -1.0, 0.0, 0.0),
    (0.5, -1.0, 0.0, 0.0),
    (0.0, 0.5, 0.0, 0.0),
    (0.0, -1.0, 0.5, 0.0),
    (0.0, -1.0, 0.0, 0.5),
)
_MOST_CORRELATED = 90
"""Initial simplex of the search for the noise levels, as logarithms of the ratio of each noise
level to its start value, and greatest number of filter runs.
"""
_SHARES, _PERIODS = (0.5, 1.5), (3.0, 10.0, 30.0, 100.0)
"""Start values that are tried for correlated noise: ratio of its standard deviation to the standard
deviation of the white noise, and correlation time in sample periods.
"""


def torque_noise(motions: Sequence[Motion]) -> float:
    """Return the torque scatter, N m rms, from the median absolute third difference inside
    segments.
    """
    differences = [np.diff(m.torque, n=3)[m.inside[3:]] for m in motions]
    spread = np.median(np.abs(np.concatenate(differences)))
    return float(1.4826 * spread / np.sqrt(20.0))


def likeliest_noise(point: Point) -> Noise:
    """Return the noise levels of least deviance at a point, with a correlated part if the noise of
    the point has one.

    Args:
        point: Parameters and breakaway times, which stay fixed; the search starts from the noise of
            this point.
    """
    first = point.noise
    unit = np.array([first.torque, math.sqrt(max(m.angle_variance for m in point.motions))])
    simplex, most = np.array(_SIMPLEX), _MOST
    if first.correlated > 0.0:
        unit = np.append(unit, [first.correlated, first.correlation_s])
        simplex, most = np.array(_SIMPLEX_CORRELATED), _MOST_CORRELATED

    def levels(x: Array) -> Noise:
        return Noise(*(np.exp(np.clip(x, -_FARTHEST_LOG, _FARTHEST_LOG)) * unit).tolist())

    def cost(x: Array) -> float:
        return deviance(*point.run(levels(x)))

    found = optimize.minimize(
        cost,
        simplex[0],
        method="Nelder-Mead",
        options={"xatol": 0.03, "fatol": 2.0, "maxfev": most, "initial_simplex": simplex},
    )
    return levels(found.x)


def first_correlated_noise(point: Point) -> Noise:
    """Return the start value of the search for noise with a correlated part: the noise of least
    deviance among a few candidates.
    """
    period = max(m.recording.period for m in point.motions)
    tried = [
        replace(point.noise, correlated=share * point.noise.torque, correlation_s=periods * period)
        for share in _SHARES
        for periods in _PERIODS
    ]
    return min(tried, key=lambda noise: deviance(*point.run(noise)))


def repeating_share(point: Point) -> float:
    """Return the share of the filtered correlated noise that matching half cycles have in common
    (M26).

    Noise does not repeat in matching half cycles, but the effect of unmodelled physics does. The
    share is one if a recording has no two matching half cycles in the same direction.
    """
    common, power = 0.0, 0.0
    filtered = point.filter.correlated_torque(point.vector, point.breakaway_times, point.noise)
    cuts = np.cumsum([int(np.sum(m.inside)) for m in point.motions])[:-1]
    for m, hidden in zip(point.motions, np.split(filtered, cuts), strict=True):
        lengths = (m.table[:, LAST] - m.table[:, FIRST]).astype(np.int64)
        last = np.cumsum(lengths)
        first = last - lengths
        same = (
            m.matching & m.matching.T & np.equal.outer(m.table[:, DIRECTION], m.table[:, DIRECTION])
        )
        pairs = np.argwhere(np.triu(same, 1))
        if len(pairs) == 0:
            return 1.0
        for i, j in pairs:
            length = min(last[i] - first[i], last[j] - first[j])
            one, other = hidden[first[i] : first[i] + length], hidden[first[j] : first[j] + length]
            common += float(one @ other)
            power += 0.5 * float(one @ one + other @ other)
    return common / power if power > 0.0 else 1.0


def deviance(errors: Array, deviations: Array, clip: float = HUBER_THRESHOLD) -> float:
    """Return -2 log likelihood of innovations with these standard deviations, with outliers clipped
    (M24).
    """
    return float(np.sum(2.0 * np.log(deviations) + np.minimum((errors / deviations) ** 2, clip**2)))
