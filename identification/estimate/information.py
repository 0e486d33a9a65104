"""What recordings say about the parameters once every breakaway time has been eliminated: the reduced normal equations.

No stretch of motion sees another's breakaway time, so the normal matrix is an arrow: parameters, and beside them one
row and column per stretch. Its Schur complement costs one pass over the residuals and holds p numbers squared, whatever
the length of the recording; sums of it over pieces of a recording are that of the whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.estimate.levenberg import huber
from identification.estimate.prediction_problem import Problem
from identification.recording import Array

SETTLING = 4
"""Steps that a breakaway time gets."""
LONGEST_STEP_MS = 2.0


@dataclass(frozen=True)
class Reduced:
    """Breakaway times eliminated, stretch by stretch; p parameters, m stretches.

    Attributes:
        normals: Each stretch's Fisher information of the residuals (unit variance), shape (m, p, p).
        scores: Each one's gradient of half the squared residuals, shape (m, p).
        squares: Sum of squared residuals.
        neighbours: Sum of products of neighbouring residuals.
        count: Residuals.
        peak: Greatest residual.
    """

    normals: Array
    scores: Array
    squares: float
    neighbours: float
    count: int
    peak: float

    @property
    def rms(self) -> float:
        """Of the residuals."""
        return float(np.sqrt(self.squares / self.count))


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
        weight = np.minimum(1.0, threshold / np.maximum(np.abs(residual), 1e-300))
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


def reduce(problem: Problem, threshold: float = np.inf) -> Reduced:
    """Return the reduced normal equations at a problem's start.

    Args:
        problem: Recordings, free parameters, breakaway times and noise.
        threshold: Residual size beyond which a residual counts by Huber's weight.
    """
    problem.weigh()
    x = problem.origin()
    residual = problem.residuals(x)
    slope, along = problem.slopes(x, residual)
    weight = np.minimum(1.0, threshold / np.maximum(np.abs(residual), 1e-300))
    owners, m, p = problem.owners, problem.breakaways, slope.shape[1]
    weighted = slope * weight[:, None]
    cross = np.column_stack([np.bincount(owners, column * along, m) for column in weighted.T])
    own = np.bincount(owners, weight * along * along, m)
    pull = np.bincount(owners, weight * along * residual, m)
    score = np.column_stack([np.bincount(owners, column * residual, m) for column in weighted.T])
    held = np.where(own > 0.0, own, np.inf)
    normals = np.empty((m, p, p))
    for k in range(p):
        for j in range(k, p):
            share = np.bincount(owners, weighted[:, k] * slope[:, j], m)
            normals[:, k, j] = normals[:, j, k] = share - cross[:, k] * cross[:, j] / held
    inside = residual[: len(residual) - m]
    return Reduced(
        normals=normals,
        scores=score - cross * (pull / held)[:, None],
        squares=float(inside @ inside),
        neighbours=float(inside[1:] @ inside[:-1]),
        count=len(inside),
        peak=float(np.max(np.abs(inside))),
    )
