"""Breakaway times: optimised with the parameters held, or eliminated from a problem's normal
equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.filter.likelihood import Problem
from identification.numerics.arrays import Array
from identification.numerics.levenberg_marquardt import huber, huber_weight

ROUNDS = 4
"""Steps of a breakaway time."""
LONGEST_STEP_MS = 2.0


@dataclass(frozen=True)
class Reduced:
    """Normal equations of some recordings, breakaway times eliminated; p parameters, m segments.

    Attributes:
        normal: Fisher information of the residuals (unit variance), shape (p, p).
        scores: Each segment's gradient of half the sum of squares, shape (m, p).
        squares: Sum of squared residuals.
        neighbours: Sum of products of neighbouring residuals.
        count: Number of residuals.
    """

    normal: Array
    scores: Array
    squares: float
    neighbours: float
    count: int


def optimise_breakaway_times(
    problem: Problem, threshold: float = np.inf, rounds: int = ROUNDS
) -> None:
    """Minimise the Huber cost of each segment over its breakaway time, the parameters held.

    By Gauss-Newton with one step length per segment: a step that raises its segment's cost is
    undone and shortened.
    """
    count, m = len(problem.free), problem.breakaways
    owners = problem.owners
    problem.hold_weights()
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
    problem.breakaway_times = problem.times(x)


def search_breakaway_times(problem: Problem, threshold: float) -> None:
    """Find the best of the minima of each breakaway time, the parameters held."""
    optimise_breakaway_times(problem, threshold)
    problem.hold_weights()
    if problem.move_breakaways(threshold):
        optimise_breakaway_times(problem, threshold)


def reduce(problem: Problem, threshold: float = np.inf) -> Reduced:
    """Return the normal equations at a problem's start, breakaway times eliminated (M12).

    Args:
        problem: Recordings, free parameters, breakaway times and noise.
        threshold: Residual size beyond which Huber's weight is below one.
    """
    problem.hold_weights()
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
