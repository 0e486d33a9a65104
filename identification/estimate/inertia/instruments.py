"""Instruments: the sensitivities of a stretch of motion, taken from the others of its recording that move like it.

A stretch's own sensitivities hold the noise of its measured torque, and that noise is in its prediction errors too: the
drive follows it within its loops' bandwidth, in a way that nobody knows. The mean over the others that make the same
motion, as long after their breakaway, is nearly the same curve and has none of it (Soderstrom and Stoica, Instrumental
Variable Methods for System Identification, 1983, ch. 4). So is the mean over rehearsals of the stretch itself, of which
there are as many as are simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from identification.estimate.inertia.half_cycles import Rehearsal, mean_curve, onsets_of, played
from identification.filter.likelihood import Problem
from identification.filter.segment_table import DIRECTION, FIRST, LAST
from identification.model.parameters import OFFSET
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow

_WIDENING = 0.2
_SHARP = 2.0
_WIDEST = 7
"""Standard deviation of the smoothing: a share of the time since breakaway, less these samples, at most 2^7 samples."""
_TRUNCATED = 4.0
"""Standard deviations at which a Gaussian ends."""


def instruments(problem: Problem, jacobian: BlockArrow) -> BlockArrow:
    """Return the instruments of every residual; zero where no other stretch lasts as long.

    Args:
        problem: At its start.
        jacobian: d residuals / d x there.
    """
    count = len(problem.free)
    both_ways = np.array([k == OFFSET for k in problem.free] + [False])
    parameters, own = np.zeros_like(jacobian.parameters), np.zeros_like(jacobian.own)
    row, stretch = 0, 0
    tie = len(own) - problem.breakaways
    for m, begins in zip(problem.motions, problem.begins, strict=True):
        lengths = (m.table[:, LAST] - m.table[:, FIRST]).astype(np.int64)
        starts = row + np.concatenate(([0], np.cumsum(lengths)))
        curves, sides = [], []
        for j, side in enumerate(m.table[:, DIRECTION]):
            sides.append(np.where(both_ways, 1.0, side))
            here = slice(starts[j], starts[j + 1])
            curves.append(np.column_stack([jacobian.parameters[here], jacobian.own[here]]) * sides[j])
        ties = jacobian.own[tie + stretch : tie + stretch + len(lengths)]
        onsets, alike = onsets_of(m, begins), m.alike
        for j, side in enumerate(sides):
            others = np.flatnonzero(alike[j] & (np.arange(len(curves)) != j))
            mean, _ = mean_curve([curves[i] for i in others], onsets[others].tolist(), len(curves[j]), onsets[j])
            mean = _smooth(mean, onsets[j]) * side
            parameters[starts[j] : starts[j + 1]] = mean[:, :count]
            own[starts[j] : starts[j + 1]] = mean[:, count]
            parameters[tie + stretch + j] = jacobian.parameters[tie + stretch + j]
            own[tie + stretch + j] = np.mean(np.delete(ties, j))
        row = int(starts[-1])
        stretch += len(lengths)
    return replace(jacobian, parameters=parameters, own=own)


def rehearsed_instruments(problem: Problem, plain: BlockArrow, rehearsals: Sequence[Rehearsal]) -> BlockArrow:
    """Return the instruments of every residual as rehearsals of its own stretch have them; ``plain`` where none has.

    Strokes alike are few, and each is a little another motion; a rehearsal is the same motion with another noise. Its
    mean is not smoothed: the drive answers to its command's and encoder's steps alike each time, from sample to sample,
    and at coarse counts that is what tells most of the inertia.

    Args:
        problem: At its start.
        plain: Its instruments by strokes alike.
        rehearsals: At least one.
    """
    parameters, own = plain.parameters.copy(), plain.own.copy()
    for stretch in played(problem, rehearsals):
        if not stretch.curves:
            continue
        here, doubt = stretch.rows, problem.doubt[stretch.number]
        mean, seen = stretch.mean(stretch.curves)
        alike = np.column_stack([parameters[here], own[here]])
        mean = np.where(seen > 0.0, mean / doubt, alike)
        parameters[here], own[here] = mean[:, :-1], mean[:, -1]
    return replace(plain, parameters=parameters, own=own)


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
