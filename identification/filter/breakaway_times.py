"""Optimises the breakaway times with fixed parameters, or eliminates them from normal equations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.filter.likelihood import Point
from identification.numerics.arrays import Array
from identification.numerics.levenberg_marquardt import huber_weight

ROUNDS = 4
"""Greatest number of Gauss-Newton steps for a breakaway time."""
LONGEST_STEP_MS = 2.0


@dataclass(frozen=True)
class Reduced:
    """Normal equations of some recordings with the breakaway times eliminated; p parameters, m
    segments.

    Attributes:
        normal: Fisher information of the residuals (unit variance), shape (p, p).
        scores: Gradient of half the sum of squares of each segment's residuals, shape (m, p).
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
    point: Point, threshold: float = np.inf, rounds: int = ROUNDS
) -> Point:
    """Return the point at which each breakaway time minimises its segment's Huber cost; the
    parameters stay fixed.

    The method is Gauss-Newton with one step length per segment: a step that raises the Huber cost
    of its segment is undone and shortened.
    """
    count = len(point.free)
    held = point.weighted()
    x = point.origin()
    near = held.near_breakaways(x, held.residuals(x))
    residual = near.here
    cost = near.costs(residual, threshold)
    length = np.ones(point.breakaways)
    for _ in range(rounds):
        there = x.copy()
        there[count:] += 1e-3
        along = (near.residuals(there) - residual) / 1e-3
        weight = huber_weight(residual, threshold)
        own = near.by_segment(weight * along * along)
        step = -near.by_segment(weight * along * residual) / np.where(own > 0.0, own, np.inf)
        trial = x.copy()
        trial[count:] += length * np.clip(step, -LONGEST_STEP_MS, LONGEST_STEP_MS)
        tried = near.residuals(trial)
        tried_cost = near.costs(tried, threshold)
        better = tried_cost < cost
        x[count:] = np.where(better, trial[count:], x[count:])
        length = np.where(better, 1.0, 0.25 * length)
        residual = np.where(better[near.owners], tried, residual)
        cost = np.where(better, tried_cost, cost)
    return replace(point, breakaway_times=point.times(x))


def search_breakaway_times(point: Point, threshold: float) -> Point:
    """Return the point at which the Huber cost of each segment has the least of its local minima
    over the breakaway time, with fixed parameters.
    """
    there, moved = (
        optimise_breakaway_times(point, threshold).weighted().with_best_breakaways(threshold)
    )
    return optimise_breakaway_times(there, threshold) if moved else there


def reduce(point: Point, threshold: float = np.inf) -> Reduced:
    """Return the normal equations at a point, with the breakaway times eliminated (M12).

    Args:
        point: Recordings, free parameters, breakaway times and noise.
        threshold: Residual size beyond which Huber's weight is below one.
    """
    held = point.weighted()
    x = point.origin()
    residual = held.residuals(x)
    found = held.jacobian(x, residual).eliminated(residual, huber_weight(residual, threshold))
    inside = residual[: len(residual) - point.breakaways]
    return Reduced(
        normal=found.matrix,
        scores=found.scores,
        squares=float(inside @ inside),
        neighbours=float(inside[1:] @ inside[:-1]),
        count=len(inside),
    )
