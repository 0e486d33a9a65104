"""One piece of a recording: its breakaway times settled, then eliminated from what it says about the parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.filter.likelihood import Problem
from identification.numerics.arrays import Array
from identification.numerics.levenberg_marquardt import huber, huber_weight

SETTLING = 4
"""Steps that a breakaway time gets."""
LONGEST_STEP_MS = 2.0


@dataclass(frozen=True)
class Reduced:
    """One piece with its breakaway times eliminated; p parameters, m stretches.

    Attributes:
        normal: Fisher information of the residuals (unit variance), shape (p, p).
        scores: Each stretch's gradient of half the squared residuals, shape (m, p).
        squares: Sum of squared residuals.
        neighbours: Sum of products of neighbouring residuals.
        count: Residuals.
    """

    normal: Array
    scores: Array
    squares: float
    neighbours: float
    count: int


def settle(problem: Problem, threshold: float = np.inf, rounds: int = SETTLING) -> None:
    """Move each breakaway time of a problem to where its own stretch fits best, the parameters held.

    Gauss-Newton with one step length per stretch: a step that makes its stretch worse is undone and shortened.
    """
    count, m = len(problem.free), problem.breakaways
    owners = problem.owners
    problem.weigh()
    x = problem.origin()
    residual = problem.residuals(x)
    cost = np.bincount(owners, huber(residual, threshold), m)
    length = np.ones(m)
    for _ in range(rounds):
        there = x.copy()
        there[count:] += 1e-3
        along = (problem.residuals(there) - residual) / 1e-3
        weight = huber_weight(residual, threshold)
        own = np.bincount(owners, weight * along * along, m)
        step = -np.bincount(owners, weight * along * residual, m) / np.where(own > 0.0, own, np.inf)
        trial = x.copy()
        trial[count:] += length * np.clip(step, -LONGEST_STEP_MS, LONGEST_STEP_MS)
        tried = problem.residuals(trial)
        tried_cost = np.bincount(owners, huber(tried, threshold), m)
        better = tried_cost < cost
        x[count:] = np.where(better, trial[count:], x[count:])
        length = np.where(better, 1.0, 0.25 * length)
        residual = np.where(better[owners], tried, residual)
        cost = np.where(better, tried_cost, cost)
    problem.begins = problem.times(x)


def settle_anywhere(problem: Problem, threshold: float) -> None:
    """Settle each breakaway time of a problem in the likeliest of its minima, the parameters held."""
    settle(problem, threshold)
    problem.weigh()
    if problem.seek_breakaways(threshold):
        settle(problem, threshold)


def reduce(problem: Problem, threshold: float = np.inf) -> Reduced:
    """Return the reduced normal equations at a problem's start.

    Args:
        problem: Recordings, free parameters, breakaway times and noise.
        threshold: Residual size beyond which a residual counts by Huber's weight.
    """
    problem.weigh()
    x = problem.origin()
    residual = problem.residuals(x)
    found = problem.jacobian(x, residual).eliminated(residual, huber_weight(residual, threshold))
    inside = residual[: len(residual) - problem.breakaways]
    return Reduced(
        normal=found.matrix,
        scores=found.scores,
        squares=float(inside @ inside),
        neighbours=float(inside[1:] @ inside[:-1]),
        count=len(inside),
    )
