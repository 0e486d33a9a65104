"""Computes minimum and maximum of every channel over intervals of 2^k cycles as samples arrive.

A chart draws one or two intervals per pixel, so that a peak remains visible for any number of
samples per pixel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array

KEPT = 4096  # number of intervals that are kept of each length
_ROOM = 2 * KEPT


class Slice(NamedTuple):
    """Consecutive intervals of one length."""

    level: int  # exponent of the length: an interval has 2^level cycles
    first: int  # number of the first interval, which begins at `first` times its length
    low: Array  # minima, shape (channels, n); NaN for an interval without samples
    high: Array  # maxima, in the form of `low`


class Decimation:
    """Minima and maxima over intervals of every length."""

    def __init__(self, channels: int, cycle_s: float) -> None:
        self._channels = channels
        self._cycle_s = cycle_s
        self._levels: list[_Level] = []
        self.latest_s = 0.0

    def interval_s(self, level: int) -> float:
        """Return the length of an interval, s."""
        return self._cycle_s * 2.0**level

    def level(self, window_s: float, pixels: int) -> int:
        """Return the level with at least one and at most two intervals per pixel."""
        pixels = min(max(pixels, 1), KEPT // 2)
        return max(0, math.floor(math.log2(max(window_s / pixels / self._cycle_s, 1.0))))

    def add(self, times: Array, values: Array) -> None:
        """Add samples.

        Args:
            times: Times, s, not decreasing, shape (n,).
            values: Channels, shape (channels, n).
        """
        if not len(times):
            return
        self.latest_s = float(times[-1])
        numbers = np.floor(times / self._cycle_s + 1e-6).astype(np.int64)
        while not self._levels or int(numbers[-1]) >> (len(self._levels) - 1) > 1:
            self._grow()
        low = high = values
        for level in self._levels:
            numbers, low, high = level.add(numbers, low, high)
            numbers = numbers >> 1

    def since(self, level: int, first: int) -> Slice:
        """Return the kept intervals of a level from number ``first`` on."""
        if level >= len(self._levels):
            empty = np.empty((self._channels, 0))
            return Slice(level, first, empty, empty)
        return self._levels[level].since(level, first)

    def _grow(self) -> None:
        """Add a level with intervals of twice the length, computed from the last level."""
        grown = _Level(self._channels)
        if self._levels:
            _, first, low, high = self._levels[-1].since(0, 0)
            if low.shape[1]:
                grown.add((first + np.arange(low.shape[1])) >> 1, low, high)
        self._levels.append(grown)


class _Level:
    """Stores the intervals of one length; drops the oldest intervals."""

    def __init__(self, channels: int) -> None:
        self._first = 0
        self._count = 0
        self._low = np.full((channels, _ROOM), np.nan)
        self._high = np.full((channels, _ROOM), np.nan)

    def add(
        self, numbers: NDArray[np.int64], low: Array, high: Array
    ) -> tuple[NDArray[np.int64], Array, Array]:
        """Merge shorter intervals or samples into the intervals of this level.

        Args:
            numbers: Number of the interval of each column, not decreasing.
            low: Minima, shape (channels, n).
            high: Maxima, shape (channels, n).

        Returns:
            The arguments, merged to one column an interval.
        """
        starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
        held = numbers[starts]
        if len(starts) < len(numbers):
            low = np.fmin.reduceat(low, starts, axis=1)
            high = np.fmax.reduceat(high, starts, axis=1)
        self._make_room(int(held[0]), int(held[-1]))
        # Numbers without a gap are stored as a slice, which is faster than by index.
        out = int(np.searchsorted(held, self._first))
        places: NDArray[np.int64] | slice = held[out:] - self._first
        if out < len(held):
            begin, end = int(held[out]) - self._first, int(held[-1]) - self._first + 1
            if end - begin == len(held) - out:
                places = slice(begin, end)
            self._low[:, places] = np.fmin(self._low[:, places], low[:, out:])
            self._high[:, places] = np.fmax(self._high[:, places], high[:, out:])
            self._count = max(self._count, end)
        return held, low, high

    def since(self, level: int, first: int) -> Slice:
        """Return the intervals from number ``first`` on, the newest :data:`KEPT` at most."""
        start = max(first - self._first, self._count - KEPT, 0)
        kept = slice(start, self._count)
        return Slice(level, self._first + start, self._low[:, kept], self._high[:, kept])

    def _make_room(self, first: int, last: int) -> None:
        """Drop the oldest intervals so that number ``last`` fits."""
        if not self._count:
            self._first = max(first, last - KEPT + 1)
        surplus = last - self._first + 1 - _ROOM
        if surplus <= 0:
            return
        drop = min(surplus + KEPT, self._count)
        for array in (self._low, self._high):
            array[:, : self._count - drop] = array[:, drop : self._count]
            array[:, self._count - drop :] = np.nan
        self._first += drop
        self._count -= drop
        if last - self._first + 1 > _ROOM:
            self._first, self._count = last - KEPT + 1, 0
