"""Reduces a stream of samples to bins with their minimum and maximum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array

Flags = NDArray[np.bool_]
MOST_BINS = 8192
"""Smallest number of bins after a reduction, which exceeds the number of columns of a screen."""


class Bins(NamedTuple):
    """Groups of neighbouring samples.

    Attributes:
        start: Time of each bin's first sample, s, shape (n,).
        stop: Time of each bin's last sample, s, shape (n,).
        low: Least value of each channel, shape (n, channels); NaN without a value.
        high: Greatest value of each channel, shape (n, channels).
        broken: Whether samples are missing before the bin, so that no line joins it to the bin
            before it.
    """

    start: Array
    stop: Array
    low: Array
    high: Array
    broken: Flags

    def part(self, first: float, last: float) -> Bins:
        """Return the bins between two times, s."""
        keep = (self.stop >= first) & (self.start <= last)
        return Bins(
            self.start[keep], self.stop[keep], self.low[keep], self.high[keep], self.broken[keep]
        )


def of_samples(time: Array, values: Array, broken: Flags) -> Bins:
    """Return samples as bins of one sample each. ``values`` has shape (n, channels)."""
    return Bins(time, time, values, values, broken)


def joined(parts: Sequence[Bins]) -> Bins:
    """Return consecutive sets of bins as one."""
    return Bins(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))


def merged(bins: Bins, starts: NDArray[np.intp]) -> Bins:
    """Return the bins merged into groups that begin at the indices ``starts``, the first of which
    is 0.
    """
    if not len(bins.start):
        return bins
    ends = np.append(starts[1:], len(bins.start)) - 1
    return Bins(
        bins.start[starts],
        bins.stop[ends],
        np.fmin.reduceat(bins.low, starts, axis=0),
        np.fmax.reduceat(bins.high, starts, axis=0),
        bins.broken[starts],
    )


def in_columns(bins: Bins, position: Array, columns: int) -> Bins:
    """Return the bins after merging those in the same column of a drawing.

    Args:
        bins: The bins to draw.
        position: Where each bin begins, 0 at the left edge and 1 at the right, not falling, shape
            (n,).
        columns: Number of columns of the drawing.
    """
    if not len(bins.start):
        return bins
    column = np.floor(position * columns)
    begins = np.append(True, np.diff(column) > 0.0) | bins.broken
    return merged(bins, np.flatnonzero(begins))


class Envelope:
    """Reduces samples in order to a limited number of bins of about the same width.

    Bins begin at multiples of the width, counted in samples. A recording with more gaps than bins
    keeps one bin for the samples between two gaps.

    Args:
        most: Half of the largest number of bins.
    """

    def __init__(self, most: int = MOST_BINS) -> None:
        self._most = most
        self._width = 1
        self._seen = 0
        self._parts: list[tuple[Bins, NDArray[np.intp]]] = []
        self._count = 0

    def add(self, bins: Bins) -> None:
        """Add the next samples, as bins of one sample each."""
        index = np.arange(self._seen, self._seen + len(bins.start))
        self._seen += len(index)
        self._parts.append(self._reduced(bins, index))
        self._count += len(self._parts[-1][1])
        while self._count > 2 * self._most:
            before = self._count
            self._width *= 2
            self._join()
            if self._count == before:
                self._most *= 2

    def bins(self) -> Bins | None:
        """Return the reduced samples, or None if no samples were added."""
        if not self._count:
            return None
        self._join()
        return self._parts[0][0]

    def _join(self) -> None:
        bins = joined([part for part, _ in self._parts])
        reduced = self._reduced(bins, np.concatenate([index for _, index in self._parts]))
        self._parts, self._count = [reduced], len(reduced[1])

    def _reduced(self, bins: Bins, index: NDArray[np.intp]) -> tuple[Bins, NDArray[np.intp]]:
        """Return the bins merged to the present width; ``index`` is the number of the first sample
        of each bin.
        """
        begins = np.diff(index // self._width, prepend=-1) > 0
        starts = np.flatnonzero(begins | bins.broken)
        return merged(bins, starts), index[starts]
