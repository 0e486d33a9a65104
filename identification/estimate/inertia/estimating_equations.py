"""The estimating equations: prediction errors uncorrelated with the instruments (M27, M29).

Least squares and likelihood of the prediction errors are biased in the inertia. Noise of the
current sensor reaches the true torque through the drive's current loop and returns through its
velocity loop, so that the measured torque is neither the true one plus noise nor the reverse. With
instruments free of a segment's own noise the errors need only have zero mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from identification.estimate.inertia.inertia_equation import influence_on_inertia
from identification.estimate.inertia.instruments import instruments
from identification.estimate.inertia.variance_inflation import inflation_factors
from identification.filter.likelihood import Problem
from identification.filter.noise_level import HUBER_THRESHOLD, likeliest_noise
from identification.model.parameters import INERTIA, LOGARITHMIC
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.levenberg_marquardt import huber_weight

SOLVED = 3.0
"""Chi-square below which the estimating equations count as solved (M29)."""
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
"""Information of a segment, in median segments of its recording, above which its variance is
inflated (M13).
"""
_CHORD_SETTLED = 0.02


def solve(problem: Problem) -> Array:
    """Solve the estimating equations from the problem's start; make the solution its start; return
    the residuals.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not determine the parameters.
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
    problem.hold_weights()
    return problem.residuals(problem.origin())


def _round(problem: Problem) -> Array:
    """Solve for fixed instruments by chord steps; return the standard deviations of the
    parameters.
    """
    problem.hold_weights()
    x = problem.origin()
    residual = problem.residuals(x)
    jacobian = problem.jacobian(x, residual)
    z = instruments(problem, jacobian)
    count = len(problem.free)
    bread = np.linalg.inv(z.product(huber_weight(residual, HUBER_THRESHOLD), jacobian))
    power = z.product()
    metric = np.linalg.pinv(power, hermitian=True)
    deviation = np.sqrt(np.abs(np.diag(bread @ power @ bread.T)))[:count]
    score = z.back(residual * huber_weight(residual, HUBER_THRESHOLD))
    for _ in range(_CHORDS):
        step = -bread @ score
        logs = [abs(s) for s, k in zip(step, problem.free, strict=False) if k in LOGARITHMIC]
        share = min(
            1.0,
            _LONGEST_LOG / max([*logs, 1e-9]),
            _LONGEST_SHIFT / float(np.max(np.abs(step[count:]))),
        )
        for _ in range(_HALVINGS):
            there = problem.residuals(x + share * step)
            then = z.back(there * huber_weight(there, HUBER_THRESHOLD))
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


def equations_chi2(problem: Problem) -> float:
    """Return the chi-square of the estimating equations at the problem's start (M29)."""
    problem.hold_weights()
    x = problem.origin()
    residual = problem.residuals(x)
    z = instruments(problem, problem.jacobian(x, residual))
    score = z.back(residual * huber_weight(residual, HUBER_THRESHOLD))
    return float(score @ np.linalg.pinv(z.product(), hermitian=True) @ score)


def fit_beside_inertia(
    problem: Problem, refine: Callable[[Problem, Sequence[float]], Array]
) -> Array:
    """Fit the inertia by its estimating equation and all else by likelihood, in turn; return the
    residuals.

    Likelihood is badly biased in the inertia only. For the other parameters it is more precise than
    instruments that are means over a few segments, and it stays in its basin. The step of the
    inertia has all else eliminated, so that errors of the others enter in second order (M30, M31).

    Args:
        problem: At the end of the unloaded and loaded fits; its start becomes the result.
        refine: Searches the free parameters but the inertia, at the given multiples of the noise
            levels.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not determine the parameters.
    """
    free = problem.free
    others = tuple(k for k in free if k != INERTIA)
    low, high = (-np.inf, 0.0), (np.inf, 0.0)
    for _ in range(_TURNS):
        if others:
            problem.free = others
            problem.inflation = segment_inflation(problem)
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
    # Inflation depends on the values: it is renewed where the fit ends.
    problem.free = others
    problem.inflation = segment_inflation(problem)
    problem.free = free
    problem.hold_weights()
    return problem.residuals(problem.origin())


def _inertia_step(problem: Problem) -> tuple[float, float]:
    """Return the step in the logarithm of the inertia that solves its linearised equation, and its
    deviation.
    """
    problem.hold_weights()
    x = problem.origin()
    residual = problem.residuals(x)
    jacobian = problem.jacobian(x, residual)
    influence = influence_on_inertia(problem, instruments(problem, jacobian), jacobian, residual)
    return -float(influence @ (residual * huber_weight(residual, HUBER_THRESHOLD))), float(
        np.linalg.norm(influence)
    )


def segment_inflation(problem: Problem) -> Array:
    """Return the variance inflation of each segment at the problem's start, shape (m,) (M13).

    Resets the problem's own inflation first.
    """
    problem.inflation = np.ones(problem.breakaways)
    problem.hold_weights()
    x = problem.origin()
    return inflation_by(problem, problem.jacobian(x, problem.residuals(x)))


def inflation_by(problem: Problem, jacobian: BlockArrow) -> Array:
    """Return the variance inflation from sensitivities of the prediction errors without inflation,
    shape (m,).
    """
    information = jacobian.information_by_block()
    numbers = np.arange(len(problem.motions), dtype=np.int64)
    recordings = np.repeat(numbers, [len(m.table) for m in problem.motions])
    return inflation_factors(information, problem.lengths, recordings, _MOST)
