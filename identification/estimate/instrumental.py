"""The estimating equations: prediction errors uncorrelated with the instruments.

Least squares of the prediction errors is biased here. The current sensor's noise reaches the true torque through the
drive's current loop and comes back through its velocity loop, so the measured torque is neither the true one with
noise added nor the other way round; at 1 % of full scale J came out 25 to 70 % off. With instruments
that hold nothing of a stretch's own noise the errors need only have mean zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.estimate.cramer_rao import bound
from identification.estimate.instruments import instruments
from identification.estimate.noise_level import CLIP, likeliest_noise
from identification.estimate.prediction_problem import LOGARITHMIC, Problem
from identification.recording import Array

ROUNDS = 6
"""Times that instruments, weights and derivatives are renewed at most."""
_LEVEL_ROUNDS = (0, 2)
_CHORDS = 8
_HALVINGS = 5
_LONGEST_LOG = 0.4
_LONGEST_SHIFT = 2.0
_SETTLED = 0.05
_CHORD_SETTLED = 0.02


@dataclass(frozen=True)
class Covariances:
    """Covariance of the free parameters as estimated, and the least possible, in their own units, shape (p, p)."""

    achieved: Array
    floor: Array


def solve(problem: Problem) -> Array:
    """Solve the estimating equations from the problem's start; keep the result there; return the residuals.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not pin the parameters.
    """
    for turn in range(ROUNDS):
        if turn in _LEVEL_ROUNDS:
            problem.noise, problem.angle_noise = likeliest_noise(problem, problem.noise)
        begun = problem.origin()[: len(problem.free)]
        deviation = _round(problem)
        problem.iterations += 1
        moved = np.abs(problem.origin()[: len(problem.free)] - begun) / deviation
        if turn >= _LEVEL_ROUNDS[-1] and float(np.max(moved)) < _SETTLED:
            break
    problem.weigh()
    return problem.residuals(problem.origin())


def _weight(residual: Array) -> Array:
    """Return Huber's weights (Ann. Math. Statist. 35 (1964) 73)."""
    return np.asarray(np.minimum(1.0, CLIP / np.maximum(np.abs(residual), 1e-300)))


def _round(problem: Problem) -> Array:
    """Solve for fixed instruments by chord steps; keep the result; return the parameters' standard deviations."""
    problem.weigh()
    x = problem.origin()
    residual = problem.residuals(x)
    jacobian = problem.jacobian(x, residual)
    z = instruments(problem, jacobian)
    count = len(problem.free)
    bread = np.linalg.inv(z.T @ (jacobian * _weight(residual)[:, None]))
    metric = np.linalg.pinv(z.T @ z, hermitian=True)
    deviation = np.sqrt(np.diag(bread @ (z.T @ z) @ bread.T))[:count]
    score = z.T @ (residual * _weight(residual))
    for _ in range(_CHORDS):
        step = -bread @ score
        logs = [abs(s) for s, k in zip(step, problem.free, strict=False) if k in LOGARITHMIC]
        share = min(1.0, _LONGEST_LOG / max([*logs, 1e-9]), _LONGEST_SHIFT / float(np.max(np.abs(step[count:]))))
        for _ in range(_HALVINGS):
            there = problem.residuals(x + share * step)
            then = z.T @ (there * _weight(there))
            if then @ metric @ then < score @ metric @ score:
                break
            share *= 0.5
        else:
            break
        x, score = x + share * step, then
        if float(np.max(np.abs(step[:count]) / deviation)) < _CHORD_SETTLED:
            break
    problem.keep(x)
    return np.asarray(deviation)


def covariances(problem: Problem) -> Covariances:
    """Return the achieved covariance of the free parameters and its floor at the problem's start.

    The larger, parameter by parameter, of what the noise model says and of the sandwich clustered by stretch (Liang and
    Zeger, Biometrika 73 (1986) 13), so that what the noise model misses from stretch to stretch widens the interval.
    """
    x = problem.origin()
    problem.weigh()
    residual = problem.residuals(x)
    jacobian = problem.jacobian(x, residual)
    z = instruments(problem, jacobian)
    count = len(problem.free)
    bread = np.linalg.inv(z.T @ jacobian)
    plain = (bread @ (z.T @ z) @ bread.T * max(float(np.mean(residual**2)), 1.0))[:count, :count]
    scores = np.zeros((problem.breakaways, len(x)))
    np.add.at(scores, problem.owners.astype(np.int64), z * (residual * _weight(residual))[:, None])
    share = problem.breakaways / max(problem.breakaways - count, 1)
    sandwich = (bread @ (scores.T @ scores) @ bread.T * share)[:count, :count]
    widen = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(plain), 1.0))
    units = np.array([problem.start[k] if k in LOGARITHMIC else 1.0 for k in problem.free])
    scale = np.outer(units, units)
    floor = bound(jacobian, z, problem.siblings)[:count, :count]
    return Covariances(plain * np.outer(widen, widen) * scale, floor * scale)
