"""Computes the instruments of motion segments: sensitivities without the segment's own noise (M28).

Both the sensitivities and the prediction errors of a segment contain the noise of the segment's
measured torque, because the drive follows this noise within its bandwidth. The mean of the
sensitivities of the matching half cycles, as a function of the time since breakaway, is nearly
equal to the segment's sensitivities without the noise (Soderstrom and Stoica, Instrumental Variable
Methods for System Identification, 1983, ch. 4). The mean over simulated replicates of the segment
is free of the noise too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from identification.estimate.inertia.half_cycles import (
    Replicate,
    mean_curve,
    onsets_of,
    replicated_segments,
)
from identification.filter.likelihood import Point
from identification.filter.segment_table import DIRECTION, FIRST, LAST
from identification.model.parameters import OFFSET
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow

_WIDENING = 0.2
_SHARP = 2.0
_WIDEST = 7
"""Width of the smoothing, as the standard deviation of a Gaussian in samples: a share of the time
since breakaway, less a constant, and at most 2^7.
"""
_TRUNCATED = 4.0
"""Number of standard deviations at which the smoothing Gaussian is truncated."""


def instruments(point: Point, jacobian: BlockArrow) -> BlockArrow:
    """Return the instruments of every residual; zero at samples that lie in no other matching
    segment.

    Args:
        point: Point at which the sensitivities are computed.
        jacobian: d residuals / d x at the point.
    """
    count = len(point.free)
    both_ways = np.array([k == OFFSET for k in point.free] + [False])
    parameters, own = np.zeros_like(jacobian.parameters), np.zeros_like(jacobian.own)
    row, segment = 0, 0
    tie = len(own) - point.breakaways
    for m, begins in zip(point.motions, point.breakaway_times, strict=True):
        lengths = (m.table[:, LAST] - m.table[:, FIRST]).astype(np.int64)
        starts = row + np.concatenate(([0], np.cumsum(lengths)))
        curves, sides = [], []
        for j, side in enumerate(m.table[:, DIRECTION]):
            sides.append(np.where(both_ways, 1.0, side))
            here = slice(starts[j], starts[j + 1])
            curves.append(
                np.column_stack([jacobian.parameters[here], jacobian.own[here]]) * sides[j]
            )
        ties = jacobian.own[tie + segment : tie + segment + len(lengths)]
        onsets, matching = onsets_of(m, begins), m.matching
        for j, side in enumerate(sides):
            others = np.flatnonzero(matching[j] & (np.arange(len(curves)) != j))
            mean, _ = mean_curve(
                [curves[i] for i in others], onsets[others].tolist(), len(curves[j]), onsets[j]
            )
            mean = _smooth(mean, onsets[j]) * side
            parameters[starts[j] : starts[j + 1]] = mean[:, :count]
            own[starts[j] : starts[j + 1]] = mean[:, count]
            parameters[tie + segment + j] = jacobian.parameters[tie + segment + j]
            own[tie + segment + j] = np.mean(np.delete(ties, j))
        row = int(starts[-1])
        segment += len(lengths)
    return replace(jacobian, parameters=parameters, own=own)


def replicate_instruments(
    point: Point, plain: BlockArrow, replicates: Sequence[Replicate]
) -> BlockArrow:
    """Return the instruments of every residual from replicates; a residual without a counterpart in
    any replicate has its instrument from ``plain``.

    Matching half cycles are few and differ slightly; a replicate is a simulation of the same motion
    with other noise. The mean over replicates is not smoothed, because the drive's response to
    steps of command and encoder is the same in all replicates, and with a coarse encoder the
    samples of these responses contain most information on the inertia.

    Args:
        point: Point at which the sensitivities are computed.
        plain: Instruments from matching half cycles.
        replicates: One or more replicates.
    """
    parameters, own = plain.parameters.copy(), plain.own.copy()
    for segment in replicated_segments(point, replicates):
        if not segment.curves:
            continue
        here, inflation = segment.rows, point.inflation[segment.number]
        mean, seen = segment.mean(segment.curves)
        matching = np.column_stack([parameters[here], own[here]])
        mean = np.where(seen > 0.0, mean / inflation, matching)
        parameters[here], own[here] = mean[:, :-1], mean[:, -1]
    return replace(plain, parameters=parameters, own=own)


def _smooth(curve: Array, onset: float) -> Array:
    """Return a curve smoothed with a width that grows with the time since ``onset`` (samples),
    shape (n, p).

    Sensitivities change fast after a breakaway and slowly later.
    """
    width = np.clip(_WIDENING * (np.arange(len(curve)) - onset) - _SHARP, 2.0**-1, 2.0**_WIDEST)
    level = np.log2(width) + 1.0
    low = np.minimum(np.floor(level).astype(np.int64), _WIDEST)
    share = (level - low)[:, None]
    bank, row = _smoothed(curve), np.arange(len(curve))
    return np.asarray((1.0 - share) * bank[low, row] + share * bank[low + 1, row])


def _smoothed(curve: Array) -> Array:
    """Return the original curve and the curve smoothed by Gaussians of 2^0 to 2^7 samples, shape
    (9, n, p).

    All these curves are computed by Fourier transform, because the widest Gaussian has a thousand
    taps.
    """
    reach = round(_TRUNCATED * 2.0**_WIDEST)
    length = fft.next_fast_len(len(curve) + 2 * reach, real=True)
    held = np.concatenate(
        [np.repeat(curve[:1], reach, axis=0), curve, np.repeat(curve[-1:], reach, axis=0)]
    )
    wave = fft.rfft(held, length, axis=0)
    smoothed = fft.irfft(wave * _responses(length)[:, :, None], length, axis=1)
    return np.concatenate([curve[None], smoothed[:, reach : reach + len(curve)]])


@lru_cache(maxsize=64)
def _responses(length: int) -> NDArray[np.complex128]:
    """Return the frequency responses of the Gaussians for a circular convolution of ``length``
    samples, shape (8, length // 2 + 1).
    """
    place = np.arange(length)
    distance = np.minimum(place, length - place)
    sigma = 2.0 ** np.arange(_WIDEST + 1)[:, None]
    taps = np.exp(-0.5 * (distance / sigma) ** 2) * (distance <= np.round(_TRUNCATED * sigma))
    return np.asarray(fft.rfft(taps / taps.sum(axis=1, keepdims=True), axis=1))
