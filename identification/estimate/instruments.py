"""Instruments: the sensitivities of a stretch of motion, taken from the others of its recording that move like it.

A stretch's own sensitivities hold the noise of its measured torque, and that noise is in its prediction errors too: the
drive follows it within its loops' bandwidth, in a way that nobody knows. The mean over the others that make the same
motion, as long after their breakaway, is nearly the same curve and has none of it (Soderstrom and Stoica, Instrumental
Variable Methods for System Identification, 1983, ch. 4).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from identification.estimate import innovations as kernel
from identification.estimate.arrow import Arrow
from identification.estimate.prediction_problem import Problem
from identification.estimate.stretches import Motion
from identification.recording import Array
from identification.signals import BoolArray

_WIDENING = 0.2
_SHARP = 2.0
_WIDEST = 7
"""Standard deviation of the smoothing: a share of the time since breakaway, less these samples, at most 2^7 samples."""
_TRUNCATED = 4.0
"""Standard deviations at which a Gaussian ends."""


def instruments(problem: Problem, jacobian: Arrow) -> Arrow:
    """Return the instruments of every residual; zero where no other stretch lasts as long.

    Args:
        problem: At its start.
        jacobian: d residuals / d x there.
    """
    count = len(problem.free)
    both_ways = np.array([k == kernel.OFFSET for k in problem.free] + [False])
    parameters, own = np.zeros_like(jacobian.parameters), np.zeros_like(jacobian.own)
    row, stretch = 0, 0
    tie = len(own) - problem.breakaways
    for m, begins in zip(problem.motions, problem.begins, strict=True):
        lengths = (m.table[:, kernel.LAST] - m.table[:, kernel.FIRST]).astype(np.int64)
        starts = row + np.concatenate(([0], np.cumsum(lengths)))
        curves, sides = [], []
        for j, side in enumerate(m.table[:, kernel.SIDE]):
            sides.append(np.where(both_ways, 1.0, side))
            here = slice(starts[j], starts[j + 1])
            curves.append(np.column_stack([jacobian.parameters[here], jacobian.own[here]]) * sides[j])
        ties = jacobian.own[tie + stretch : tie + stretch + len(lengths)]
        onsets, alike = _onsets(m, begins), m.alike
        for j, side in enumerate(sides):
            mean = _smooth(_mean_of_others(curves, onsets, j, alike[j]), onsets[j]) * side
            parameters[starts[j] : starts[j + 1]] = mean[:, :count]
            own[starts[j] : starts[j + 1]] = mean[:, count]
            parameters[tie + stretch + j] = jacobian.parameters[tie + stretch + j]
            own[tie + stretch + j] = np.mean(np.delete(ties, j))
        row = int(starts[-1])
        stretch += len(lengths)
    return replace(jacobian, parameters=parameters, own=own)


def _onsets(m: Motion, begins: Array) -> Array:
    """Return when each stretch breaks away, in samples after its first, shape (m,)."""
    first = m.table[:, kernel.FIRST].astype(np.int64)
    return np.asarray((begins - m.time[first]) / m.recording.period)


def _mean_of_others(curves: list[Array], onsets: Array, j: int, alike: BoolArray) -> Array:
    """Return the mean of the curves that are ``alike``, less the ``j``-th, shifted to its breakaway, shape of that."""
    length = len(curves[j])
    total, seen = np.zeros_like(curves[j]), np.zeros((length, 1))
    for i, curve in enumerate(curves):
        if i == j or not alike[i]:
            continue
        at = np.arange(length) + onsets[i] - onsets[j]
        low = np.floor(at).astype(np.int64)
        inside = (low >= 0) & (low < len(curve) - 1)
        low, share = low[inside], (at - np.floor(at))[inside][:, None]
        total[inside] += (1.0 - share) * curve[low] + share * curve[low + 1]
        seen[inside] += 1.0
    return np.asarray(total / np.maximum(seen, 1.0))


def _smooth(curve: Array, onset: float) -> Array:
    """Return a curve smoothed over a time that grows with the time since ``onset`` (samples), shape (n, p).

    Sensitivities change fast after a breakaway and slowly later; the noise left in their mean does not.
    """
    width = np.clip(_WIDENING * (np.arange(len(curve)) - onset) - _SHARP, 2.0**-1, 2.0**_WIDEST)
    level = np.log2(width) + 1.0
    low = np.minimum(np.floor(level).astype(np.int64), _WIDEST)
    share = (level - low)[:, None]
    bank, row = _smoothed(curve), np.arange(len(curve))
    return np.asarray((1.0 - share) * bank[low, row] + share * bank[low + 1, row])


def _smoothed(curve: Array) -> Array:
    """Return a curve as it is, then by Gaussians of 2^0 to 2^7 samples, its ends held, shape (9, n, p).

    One transform serves all of them: the widest has a thousand taps.
    """
    reach = round(_TRUNCATED * 2.0**_WIDEST)
    length = fft.next_fast_len(len(curve) + 2 * reach, real=True)
    held = np.concatenate([np.repeat(curve[:1], reach, axis=0), curve, np.repeat(curve[-1:], reach, axis=0)])
    wave = fft.rfft(held, length, axis=0)
    smoothed = fft.irfft(wave * _responses(length)[:, :, None], length, axis=1)
    return np.concatenate([curve[None], smoothed[:, reach : reach + len(curve)]])


@lru_cache(maxsize=64)
def _responses(length: int) -> NDArray[np.complex128]:
    """Return the frequency responses of the Gaussians over a circle of so many samples, shape (8, length // 2 + 1)."""
    place = np.arange(length)
    distance = np.minimum(place, length - place)
    sigma = 2.0 ** np.arange(_WIDEST + 1)[:, None]
    taps = np.exp(-0.5 * (distance / sigma) ** 2) * (distance <= np.round(_TRUNCATED * sigma))
    return np.asarray(fft.rfft(taps / taps.sum(axis=1, keepdims=True), axis=1))
