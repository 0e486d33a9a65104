"""The noise of torque and encoder, from the data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import optimize

from identification.filter.likelihood import Problem
from identification.filter.noise import Noise
from identification.filter.segment_table import DIRECTION, FIRST, LAST
from identification.filter.segments import Motion
from identification.numerics.arrays import Array

CLIP = 4.0
"""Prediction errors beyond this many deviations count as outliers."""
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
"""Where the search for the noise begins, in logarithms over its start, and runs of the filter that it takes at most."""
_SHARES, _PERIODS = (0.5, 1.5), (3.0, 10.0, 30.0, 100.0)
"""Correlated parts that are tried first: over the white part, and for how many periods they are correlated."""


def torque_noise(motions: Sequence[Motion]) -> float:
    """Estimate the torque noise from third differences inside stretches (median absolute deviation), N m rms."""
    differences = [np.diff(m.torque, n=3)[m.inside[3:]] for m in motions]
    spread = np.median(np.abs(np.concatenate(differences)))
    return float(1.4826 * spread / np.sqrt(20.0))


def likeliest_noise(problem: Problem) -> Noise:
    """Return the likeliest noise at a problem's start, with a correlated part where its own has one.

    Args:
        problem: Its parameters and breakaway times are held; its noise is what the search starts from.
    """
    first = problem.noise
    unit = np.array([first.torque, math.sqrt(max(m.angle_variance for m in problem.motions))])
    simplex, most = np.array(_SIMPLEX), _MOST
    if first.correlated > 0.0:
        unit = np.append(unit, [first.correlated, first.correlation_s])
        simplex, most = np.array(_SIMPLEX_CORRELATED), _MOST_CORRELATED

    def levels(x: Array) -> Noise:
        return Noise(*(np.exp(np.clip(x, -_FARTHEST_LOG, _FARTHEST_LOG)) * unit).tolist())

    def cost(x: Array) -> float:
        return deviance(*problem.run(problem.start, problem.begins, levels(x)))

    found = optimize.minimize(
        cost,
        simplex[0],
        method="Nelder-Mead",
        options={"xatol": 0.03, "fatol": 2.0, "maxfev": most, "initial_simplex": simplex},
    )
    return levels(found.x)


def with_correlated(problem: Problem) -> Noise:
    """Return the likeliest of a few noises with a correlated part, to start the search for it from."""
    period = max(m.recording.period for m in problem.motions)
    tried = [
        replace(problem.noise, correlated=share * problem.noise.torque, correlation_s=periods * period)
        for share in _SHARES
        for periods in _PERIODS
    ]
    return min(tried, key=lambda noise: deviance(*problem.run(problem.start, problem.begins, noise)))


def repeated(problem: Problem) -> float:
    """Return the share of what correlated noise hides at the problem's start that comes again in strokes alike.

    Noise does not come again, and physics that the model lacks does: at each time since breakaway in strokes the same
    way. One where a recording has no such strokes, so that nothing tells the two apart.
    """
    problem.run(problem.start, problem.begins, problem.noise)
    common, power = 0.0, 0.0
    for m, hidden in zip(problem.motions, problem.hidden, strict=True):
        first, last = m.table[:, [FIRST, LAST]].astype(np.int64).T
        same = m.alike & m.alike.T & np.equal.outer(m.table[:, DIRECTION], m.table[:, DIRECTION])
        pairs = np.argwhere(np.triu(same, 1))
        if len(pairs) == 0:
            return 1.0
        for i, j in pairs:
            length = min(last[i] - first[i], last[j] - first[j])
            one, other = hidden[first[i] : first[i] + length], hidden[first[j] : first[j] + length]
            common += float(one @ other)
            power += 0.5 * float(one @ one + other @ other)
    return common / power if power > 0.0 else 1.0


def deviance(errors: Array, deviations: Array, clip: float = CLIP) -> float:
    """Return -2 log likelihood of prediction errors with these standard deviations, outliers clipped."""
    return float(np.sum(2.0 * np.log(deviations) + np.minimum((errors / deviations) ** 2, clip**2)))
