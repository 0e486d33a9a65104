"""The estimating equations: prediction errors uncorrelated with the instruments.

Least squares of the prediction errors is biased here, and so is their likelihood. The current sensor's noise reaches
the true torque through the drive's current loop and comes back through its velocity loop, so the measured torque is
neither the true one with noise added nor the other way round; at 1 % of full scale J came out 25 to 70 % off. With
instruments that hold nothing of a stretch's own noise the errors need only have mean zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from identification.estimate.inertia.inertia_equation import influence_on_inertia
from identification.estimate.inertia.instruments import instruments
from identification.estimate.inertia.variance_inflation import doubts
from identification.filter.likelihood import Problem
from identification.filter.noise_level import CLIP, likeliest_noise
from identification.model.parameters import INERTIA, LOGARITHMIC
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.levenberg_marquardt import huber_weight

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
_MOST = 3.0
"""Median stretches of its recording that one is believed as at most: where friction is regular none counts as much."""
_CHORD_SETTLED = 0.02


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
    others = tuple(k for k in free if k != INERTIA)
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
        here = float(np.log(problem.start[INERTIA]))
        low, high = ((here, step), high) if step > 0.0 else (low, (here, step))
        there = here + float(np.clip(step, -_LONGEST_LOG, _LONGEST_LOG))
        if not low[0] < there < high[0]:
            there = (low[0] * high[1] - high[0] * low[1]) / (high[1] - low[1])
        problem.start = problem.start.copy()
        problem.start[INERTIA] = np.exp(there)
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


def doubted(problem: Problem) -> Array:
    """Return by how much each stretch's noise is taken to be larger, so that no single one carries the estimate.

    Judged as if nothing were doubted yet: what the problem holds of doubt is taken back.
    """
    problem.doubt = np.ones(problem.breakaways)
    problem.weigh()
    x = problem.origin()
    return doubts_by(problem, problem.jacobian(x, problem.residuals(x)))


def doubts_by(problem: Problem, jacobian: BlockArrow) -> Array:
    """Return the same from sensitivities of the prediction errors with nothing doubted."""
    told = jacobian.information_by_block()
    numbers = np.arange(len(problem.motions), dtype=np.int64)
    recordings = np.repeat(numbers, [len(m.table) for m in problem.motions])
    return doubts(told, problem.lengths, recordings, _MOST)
