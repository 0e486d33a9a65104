"""The estimating equations: prediction errors uncorrelated with the instruments.

Least squares of the prediction errors is biased here. The current sensor's noise reaches the true torque through the
drive's current loop and comes back through its velocity loop, so the measured torque is neither the true one with
noise added nor the other way round; at 1 % of full scale J came out 25 to 70 % off. With instruments
that hold nothing of a stretch's own noise the errors need only have mean zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate import innovations as kernel
from identification.estimate.cramer_rao import bound
from identification.estimate.instruments import instruments
from identification.estimate.noise_level import CLIP, likeliest_noise
from identification.estimate.prediction_problem import LOGARITHMIC, Problem
from identification.recording import Array

SOLVED = 3.0
"""Defect below which the estimating equations count as solved."""
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


def defect(problem: Problem) -> float:
    """Return how far the estimating equations are from solved at the problem's start: chi-squared of their sums."""
    problem.weigh()
    x = problem.origin()
    residual = problem.residuals(x)
    z = instruments(problem, problem.jacobian(x, residual))
    score = z.T @ (residual * _weight(residual))
    return float(score @ np.linalg.pinv(z.T @ z, hermitian=True) @ score)


def beside_inertia(problem: Problem, refine: Callable[[Problem, Sequence[float]], Array]) -> Array:
    """Solve for the inertia by instruments and for all else by least squares beside it; return the residuals.

    Only the inertia is badly biased by least squares. For the others they are more precise than instruments that are
    means over a few stretches, and begun where the problem starts they stay in its basin.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not pin the parameters.
    """
    free, start, begins = problem.free, problem.start, problem.begins
    residual = solve(problem)
    others = tuple(k for k in free if k != kernel.INERTIA)
    if others != free and others:
        start = start.copy()
        if defect(problem) < SOLVED:
            start[kernel.INERTIA] = problem.start[kernel.INERTIA]
        problem.start, problem.begins, problem.free = start, begins, others
        refine(problem, (1.0,))
        problem.free = free
        problem.weigh()
        residual = problem.residuals(problem.origin())
    return residual


def covariances(problem: Problem) -> Covariances:
    """Return the achieved covariance of the free parameters and its floor at the problem's start.

    The inertia has the variance of the estimating equations. The others have what least squares reach with the inertia
    known, at the floor, and what its error does to them; where the scatter of the scores from stretch to stretch (Liang
    and Zeger, Biometrika 73 (1986) 13) says more than the noise model, that much more.
    """
    x = problem.origin()
    problem.weigh()
    residual = problem.residuals(x)
    jacobian = problem.jacobian(x, residual)
    z = instruments(problem, jacobian)
    count = len(problem.free)
    floor = bound(jacobian, z, problem.siblings)[:count, :count]
    units = np.array([problem.start[k] if k in LOGARITHMIC else 1.0 for k in problem.free])
    scale = np.outer(units, units)
    achieved = _beside_inertia(problem, floor, _instrumental(z, jacobian, residual)[:count, :count])
    widen = _excess_scatter(problem, z, jacobian, residual)[:count]
    return Covariances(achieved * np.outer(widen, widen) * scale, floor * scale)


def _instrumental(z: Array, jacobian: Array, residual: Array) -> Array:
    """Return the covariance of the solution of the estimating equations, shape (p, p)."""
    bread = np.linalg.inv(z.T @ jacobian)
    return np.asarray(bread @ (z.T @ z) @ bread.T * max(float(np.mean(residual**2)), 1.0))


def _beside_inertia(problem: Problem, floor: Array, instrumental: Array) -> Array:
    """Return the covariance of least squares beside an inertia that the instruments found."""
    if kernel.INERTIA not in problem.free:
        return floor
    j = problem.free.index(kernel.INERTIA)
    others = [k for k in range(len(problem.free)) if k != j]
    known = np.ix_(others, others)
    follow = floor[others, j] / floor[j, j]
    out = np.empty_like(floor)
    out[known] = floor[known] + np.outer(follow, follow) * (instrumental[j, j] - floor[j, j])
    out[others, j] = out[j, others] = follow * instrumental[j, j]
    out[j, j] = instrumental[j, j]
    return out


def _excess_scatter(problem: Problem, z: Array, jacobian: Array, residual: Array) -> Array:
    """Return by how much scores scatter more from stretch to stretch than their noise model says, at least 1.

    Of the inertia those of the estimating equations: its least squares are not at their minimum, by their bias.
    """
    others = np.array([k != kernel.INERTIA for k in problem.free] + [True] * problem.breakaways)
    out = np.ones(len(others))
    out[others] = _scatter(problem, jacobian[:, others], jacobian[:, others], residual)
    out[~others] = _scatter(problem, z, jacobian, residual)[~others]
    return out


def _scatter(problem: Problem, z: Array, jacobian: Array, residual: Array) -> Array:
    """Return the ratio of the clustered to the plain standard deviation of each unknown, at least 1."""
    weight = _weight(residual)
    bread = np.linalg.inv(z.T @ (jacobian * weight[:, None]))
    scores = np.zeros((problem.breakaways, z.shape[1]))
    np.add.at(scores, problem.owners.astype(np.int64), z * (residual * weight)[:, None])
    plain, clustered = (bread @ (m.T @ m) @ bread.T for m in (z, scores))
    return np.asarray(np.sqrt(np.maximum(np.diag(clustered) / np.diag(plain), 1.0)))
