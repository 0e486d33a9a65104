"""The noise of torque and encoder, from the data."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import optimize

from identification.estimate.prediction_problem import Problem
from identification.estimate.stretches import Motion
from identification.recording import Array

CLIP = 4.0
"""Prediction errors beyond this many deviations count as outliers."""
_FARTHEST_LOG = 4.0
_SIMPLEX = [[0.0, -1.0], [0.5, -1.0], [0.0, 0.5]]


def torque_noise(motions: Sequence[Motion]) -> float:
    """Estimate the torque noise from third differences inside stretches (median absolute deviation), N m rms."""
    differences = [np.diff(m.torque, n=3)[m.inside[3:]] for m in motions]
    spread = np.median(np.abs(np.concatenate(differences)))
    return float(1.4826 * spread / np.sqrt(20.0))


def likeliest_noise(problem: Problem, first: float) -> tuple[float, float]:
    """Return the noise levels of the greatest likelihood at the problem's start.

    Args:
        problem: Its parameters and breakaway times are held.
        first: Torque noise to start from, N m rms.

    Returns:
        Torque noise, N m rms, and angle noise beyond the encoder's quantisation, rad rms.
    """
    unit = np.array([first, math.sqrt(max(m.angle_variance for m in problem.motions))])

    def levels(x: Array) -> Array:
        return np.asarray(np.exp(np.clip(x, -_FARTHEST_LOG, _FARTHEST_LOG)) * unit)

    def cost(x: Array) -> float:
        torque, angle = levels(x)
        return deviance(*problem.run(problem.start, problem.begins, float(torque), float(angle)))

    found = optimize.minimize(
        cost,
        _SIMPLEX[0],
        method="Nelder-Mead",
        options={"xatol": 0.03, "fatol": 2.0, "maxfev": 30, "initial_simplex": _SIMPLEX},
    )
    torque, angle = levels(found.x)
    return float(torque), float(angle)


def deviance(errors: Array, deviations: Array, clip: float = CLIP) -> float:
    """Return -2 log likelihood of prediction errors with these standard deviations, outliers clipped."""
    return float(np.sum(2.0 * np.log(deviations) + np.minimum((errors / deviations) ** 2, clip**2)))
