"""Instruments: the sensitivities of a stretch of motion, taken from the other stretches of its recording.

A stretch's own sensitivities hold the noise of its measured torque, and that noise is in its prediction errors too: the
drive follows it within its loops' bandwidth, in a way that nobody knows. The mean over the other stretches, as long
after their breakaway, is nearly the same curve and has none of it (Soderstrom and Stoica, Instrumental Variable
Methods for System Identification, 1983, ch. 4).
"""

from __future__ import annotations

import numpy as np

from identification.estimate import innovations as kernel
from identification.estimate.prediction_problem import Problem
from identification.estimate.stretches import Motion
from identification.recording import Array


def instruments(problem: Problem, jacobian: Array) -> Array:
    """Return the instruments of every residual.

    Args:
        problem: At its start.
        jacobian: d residuals / d x there, shape (r, p).

    Returns:
        Shape (r, p); zero where no other stretch lasts as long.
    """
    count = len(problem.free)
    both_ways = np.array([k == kernel.OFFSET for k in problem.free] + [False])
    out = np.zeros_like(jacobian)
    row, stretch = 0, 0
    tie = len(jacobian) - problem.breakaways
    for m, begins in zip(problem.motions, problem.begins, strict=True):
        lengths = (m.table[:, kernel.LAST] - m.table[:, kernel.FIRST]).astype(np.int64)
        starts = row + np.concatenate(([0], np.cumsum(lengths)))
        curves, sides = [], []
        for j, side in enumerate(m.table[:, kernel.SIDE]):
            sides.append(np.where(both_ways, 1.0, side))
            here = slice(starts[j], starts[j + 1])
            curves.append(np.column_stack([jacobian[here, :count], jacobian[here, count + stretch + j]]) * sides[j])
        ties = jacobian[tie + stretch + np.arange(len(lengths)), count + stretch + np.arange(len(lengths))]
        for j, side in enumerate(sides):
            mean = _mean_of_others(curves, _onsets(m, begins), j) * side
            out[starts[j] : starts[j + 1], :count] = mean[:, :count]
            out[starts[j] : starts[j + 1], count + stretch + j] = mean[:, count]
            out[tie + stretch + j, :count] = jacobian[tie + stretch + j, :count]
            out[tie + stretch + j, count + stretch + j] = np.mean(np.delete(ties, j))
        row = int(starts[-1])
        stretch += len(lengths)
    return out


def _onsets(m: Motion, begins: Array) -> Array:
    """Return when each stretch breaks away, in samples after its first, shape (m,)."""
    first = m.table[:, kernel.FIRST].astype(np.int64)
    return np.asarray((begins - m.time[first]) / m.recording.period)


def _mean_of_others(curves: list[Array], onsets: Array, j: int) -> Array:
    """Return the mean of all curves but the ``j``-th, shifted to its breakaway, shape of that one."""
    length = len(curves[j])
    total, seen = np.zeros_like(curves[j]), np.zeros((length, 1))
    for i, curve in enumerate(curves):
        if i == j:
            continue
        at = np.arange(length) + onsets[i] - onsets[j]
        low = np.floor(at).astype(np.int64)
        inside = (low >= 0) & (low < len(curve) - 1)
        low, share = low[inside], (at - np.floor(at))[inside][:, None]
        total[inside] += (1.0 - share) * curve[low] + share * curve[low + 1]
        seen[inside] += 1.0
    return np.asarray(total / np.maximum(seen, 1.0))
