"""The estimating equations: prediction errors uncorrelated with the instruments.

Least squares of the prediction errors is biased here, and so is their likelihood. The current sensor's noise reaches
the true torque through the drive's current loop and comes back through its velocity loop, so the measured torque is
neither the true one with noise added nor the other way round; at 1 % of full scale J came out 25 to 70 % off. With
instruments that hold nothing of a stretch's own noise the errors need only have mean zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate import innovations as kernel
from identification.estimate.arrow import Arrow, equilibrated
from identification.estimate.cramer_rao import bound
from identification.estimate.instruments import Rehearsal, instruments, rehearsed_instruments
from identification.estimate.levenberg import huber_weight
from identification.estimate.leverage import doubts
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
_TURNS = 8
_PRIOR = 1.0
"""Stretches that the noise model is worth beside the scatter of the scores from stretch to stretch."""
_MOST = 3.0
"""Median stretches of its recording that one is believed as at most: where friction is regular none counts as much."""
_CHORD_SETTLED = 0.02


@dataclass(frozen=True)
class Covariances:
    """Covariance of the free parameters as estimated, and the least possible, in their own units, shape (p, p).

    Attributes:
        achieved: With the inertia where its equation is solved.
        floor: The bound.
        step: Of the free vector's parameters, to there, all else following the inertia, shape (p,).
    """

    achieved: Array
    floor: Array
    step: Array


@dataclass(frozen=True)
class _Equation:
    """The inertia's own estimating equation, all else eliminated.

    Attributes:
        influence: What a unit of each residual takes off the logarithm of the inertia, shape (r,).
        parts: What each residual takes off it, by itself and by its part in others' instruments, shape (r,).
    """

    influence: Array
    parts: Array


def solve(problem: Problem) -> Array:
    """Solve the estimating equations from the problem's start; keep the result there; return the residuals.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not pin the parameters.
    """
    for turn in range(ROUNDS):
        if turn in _LEVEL_ROUNDS:
            problem.noise = likeliest_noise(problem)
        begun = problem.origin()[: len(problem.free)]
        deviation = _round(problem)
        problem.iterations += 1
        moved = np.abs(problem.origin()[: len(problem.free)] - begun) / deviation
        if turn >= _LEVEL_ROUNDS[-1] and float(np.max(moved)) < _SETTLED:
            break
    problem.weigh()
    return problem.residuals(problem.origin())


def _round(problem: Problem) -> Array:
    """Solve for fixed instruments by chord steps; keep the result; return the parameters' standard deviations."""
    problem.weigh()
    x = problem.origin()
    residual = problem.residuals(x)
    jacobian = problem.jacobian(x, residual)
    z = instruments(problem, jacobian)
    count = len(problem.free)
    bread = np.linalg.inv(z.product(huber_weight(residual, CLIP), jacobian))
    power = z.product()
    metric = np.linalg.pinv(power, hermitian=True)
    deviation = np.sqrt(np.abs(np.diag(bread @ power @ bread.T)))[:count]
    score = z.back(residual * huber_weight(residual, CLIP))
    for _ in range(_CHORDS):
        step = -bread @ score
        logs = [abs(s) for s, k in zip(step, problem.free, strict=False) if k in LOGARITHMIC]
        share = min(1.0, _LONGEST_LOG / max([*logs, 1e-9]), _LONGEST_SHIFT / float(np.max(np.abs(step[count:]))))
        for _ in range(_HALVINGS):
            there = problem.residuals(x + share * step)
            then = z.back(there * huber_weight(there, CLIP))
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
    score = z.back(residual * huber_weight(residual, CLIP))
    return float(score @ np.linalg.pinv(z.product(), hermitian=True) @ score)


def beside_inertia(problem: Problem, refine: Callable[[Problem, Sequence[float]], Array]) -> Array:
    """Solve for the inertia by instruments and for all else by likelihood beside it; return the residuals.

    Only the inertia is badly biased by likelihood. For the others it is more precise than instruments that are means
    over a few stretches, and begun where the problem starts it stays in its basin. In turn: the likeliest of all else,
    then the estimating equations' step of the inertia with all else eliminated, to first order untouched by the others'
    bias.

    Args:
        problem: At the end of the stages' own searches; keeps the result as its start.
        refine: Searches the free parameters but the inertia, at the noise levels that it is given over their own.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not pin the parameters.
    """
    free = problem.free
    others = tuple(k for k in free if k != kernel.INERTIA)
    low, high = (-np.inf, 0.0), (np.inf, 0.0)
    for _ in range(_TURNS):
        if others:
            problem.free = others
            problem.doubt = doubted(problem)
            refine(problem, (1.0,))
            problem.free = free
        if others == free:
            break
        problem.noise = likeliest_noise(problem)
        step, deviation = _inertia_step(problem)
        here = float(np.log(problem.start[kernel.INERTIA]))
        low, high = ((here, step), high) if step > 0.0 else (low, (here, step))
        there = here + float(np.clip(step, -_LONGEST_LOG, _LONGEST_LOG))
        if not low[0] < there < high[0]:
            there = (low[0] * high[1] - high[0] * low[1]) / (high[1] - low[1])
        problem.start = problem.start.copy()
        problem.start[kernel.INERTIA] = np.exp(there)
        problem.iterations += 1
        if abs(there - here) < _SETTLED * deviation:
            break
    # Which stretch says far more than the others hangs on the values: where the fit ends another may.
    problem.free = others
    problem.doubt = doubted(problem)
    problem.free = free
    problem.weigh()
    return problem.residuals(problem.origin())


def _inertia_step(problem: Problem) -> tuple[float, float]:
    """Return the step in the logarithm of the inertia that solves its linearised equation, and its deviation."""
    problem.weigh()
    x = problem.origin()
    residual = problem.residuals(x)
    jacobian = problem.jacobian(x, residual)
    influence = influence_on_inertia(problem, instruments(problem, jacobian), jacobian, residual)
    return -float(influence @ (residual * huber_weight(residual, CLIP))), float(np.linalg.norm(influence))


def influence_on_inertia(problem: Problem, z: Arrow, jacobian: Arrow, residual: Array) -> Array:
    """Return what a unit of each residual takes off the logarithm of the inertia, shape (r,)."""
    j = problem.free.index(kernel.INERTIA)
    alone = z.along(_mixture(z, j))
    return np.asarray(alone / float(alone @ (jacobian.parameters[:, j] * huber_weight(residual, CLIP))))


def _mixture(z: Arrow, j: int) -> Array:
    """Return the mixture of the instruments that makes the ``j``-th orthogonal to the others, shape (p,)."""
    power = z.product()
    others = np.delete(power, j, axis=0)
    taken = np.linalg.pinv(np.delete(others, j, axis=1), hermitian=True) @ others[:, j]
    return np.insert(-taken, j, 1.0)


def covariances(problem: Problem, rehearsals: Sequence[Rehearsal] = ()) -> Covariances:
    """Return the achieved covariance of the free parameters and its floor at the problem's start.

    The inertia has the variance of the estimating equation. The others have what least squares reach with the inertia
    known, at the floor, as their scores scatter from stretch to stretch (Liang and Zeger, Biometrika 73 (1986) 13), and
    what its error does to them. The inertia's variance is not lowered by its scores' scatter.

    Args:
        problem: At the estimate.
        rehearsals: Of its experiment there, for instruments of the inertia beside those of strokes alike.
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
    step = np.zeros(count)
    if kernel.INERTIA not in problem.free:
        spread, achieved = _scatter(jacobian, residual), floor
    else:
        j = problem.free.index(kernel.INERTIA)
        equation = _equation_of_strokes(problem, z, jacobian, residual)
        if rehearsals:
            other = rehearsed_instruments(problem, z, rehearsals)
            equation = _best(equation, _equation(problem, other, jacobian, residual))
        influence, weighted = equation.influence, residual * huber_weight(residual, CLIP)
        step = -float(influence @ weighted) * floor[:, j] / floor[j, j]
        variance = float(influence @ influence) * max(float(np.mean(residual**2)), 1.0)
        achieved = _beside_inertia(floor, j, variance)
        others = jacobian.without(j)
        spread = _scatter(others, residual)
        scatter = np.linalg.norm(np.bincount(problem.owners, equation.parts)) / np.linalg.norm(influence * weighted)
        spread = np.insert(spread, j, max(float(scatter), 1.0))
    return Covariances(achieved * np.outer(spread, spread) * scale, floor * scale, step)


def _beside_inertia(floor: Array, j: int, variance: float) -> Array:
    """Return the covariance of least squares beside the ``j``-th, an inertia found with this variance."""
    others = [k for k in range(len(floor)) if k != j]
    known = np.ix_(others, others)
    follow = floor[others, j] / floor[j, j]
    out = np.empty_like(floor)
    out[known] = floor[known] + np.outer(follow, follow) * (variance - floor[j, j])
    out[others, j] = out[j, others] = follow * variance
    out[j, j] = variance
    return out


def _scatter(jacobian: Arrow, residual: Array) -> Array:
    """Return by how much the scores scatter more from stretch to stretch than their noise model says, shape (p,).

    Ratio of the clustered to the plain standard deviation of each parameter of least squares, drawn toward one as by
    :data:`_PRIOR` stretch that scatters as it should. It may be below one: the drive's loop takes a part of the
    current's noise out again, and what errs at the beginning of a stretch is made good by its end.
    """
    weight = huber_weight(residual, CLIP)
    normal, scale = equilibrated(jacobian.product(weight))
    # A stretch may say nothing of its own breakaway time.
    inverse = np.linalg.pinv(normal, hermitian=True) / scale[:, None]
    influence = jacobian.along(inverse[:, : jacobian.parameters.shape[1]])
    plain, sums = np.zeros((2, jacobian.stretches, influence.shape[1]))
    np.add.at(plain, jacobian.owners, influence**2)
    np.add.at(sums, jacobian.owners, influence * (residual * weight)[:, None])
    total = np.maximum(np.sum(plain, axis=0), 1e-300)
    stretches = total**2 / np.maximum(np.sum(plain**2, axis=0), 1e-300)
    squared = np.sum(sums**2, axis=0) / total * stretches / np.maximum(stretches - 1.0, 1.0)
    return np.asarray(np.sqrt((_PRIOR + stretches * squared) / (_PRIOR + stretches)))


def doubted(problem: Problem) -> Array:
    """Return by how much each stretch's noise is taken to be larger, so that no single one carries the estimate.

    Judged as if nothing were doubted yet: what the problem holds of doubt is taken back.
    """
    problem.doubt = np.ones(problem.breakaways)
    problem.weigh()
    x = problem.origin()
    told = problem.jacobian(x, problem.residuals(x)).told()
    numbers = np.arange(len(problem.motions), dtype=np.int64)
    recordings = np.repeat(numbers, [len(m.table) for m in problem.motions])
    return doubts(told, problem.lengths, recordings, _MOST)


def _equation(problem: Problem, z: Arrow, jacobian: Arrow, residual: Array) -> _Equation:
    """Return the inertia's equation by instruments that nothing of the residuals is in."""
    influence = influence_on_inertia(problem, z, jacobian, residual)
    return _Equation(influence, influence * residual * huber_weight(residual, CLIP))


def _equation_of_strokes(problem: Problem, z: Arrow, jacobian: Arrow, residual: Array) -> _Equation:
    """Return the inertia's equation by instruments of strokes alike, whose sum is one over pairs of stretches.

    A stretch enters twice: by its residuals, and by its sensitivities, which are in the others' instruments (Hoeffding,
    Ann. Math. Statist. 19 (1948) 293).
    """
    j = problem.free.index(kernel.INERTIA)
    first = _equation(problem, z, jacobian, residual)
    weighted = residual * huber_weight(residual, CLIP)
    mixed = _mixture(z, j)
    alone = z.along(mixed)
    slope = float(alone @ (jacobian.parameters[:, j] * huber_weight(residual, CLIP)))
    columns = np.zeros_like(jacobian.parameters)
    columns[:, j] = weighted
    carrier = replace(jacobian, parameters=columns, own=np.zeros_like(weighted))
    second = jacobian.along(mixed) * instruments(problem, carrier).parameters[:, j]
    second[len(second) - problem.breakaways :] = 0.0
    return replace(first, parts=first.parts + second / slope)


def _best(one: _Equation, other: _Equation) -> _Equation:
    """Return the mean of two equations for one unknown that has the least variance, neither counted against."""
    a, b = one.influence, other.influence
    away = a - b
    share = float(np.clip(-(b @ away) / max(float(away @ away), 1e-300), 0.0, 1.0))
    return _Equation(b + share * away, other.parts + share * (one.parts - other.parts))
