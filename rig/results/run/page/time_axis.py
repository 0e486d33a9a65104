"""Maps time to positions on the page, and makes tick labels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from identification.recording import Array

_NICE = (1.0, 2.0, 5.0, 10.0)


class TimeAxis:
    """Maps a time to a position on the page. Long pauses with the drive off are shortened.

    Args:
        powered: Time intervals drawn to scale, s, in order.
        clock: Name of the clock of these times; empty for no name on the axis.

    Attributes:
        clock: Name of the clock.
    """

    _PAUSE = 0.02
    """Width of a shortened pause."""

    def __init__(self, powered: Sequence[tuple[float, float]], clock: str = "") -> None:
        self.clock = clock
        joined = [powered[0]]
        longest = 0.02 * sum(stop - start for start, stop in powered)
        for start, stop in powered[1:]:
            if start - joined[-1][1] > longest:
                joined.append((start, stop))
            else:
                joined[-1] = (joined[-1][0], stop)
        self.pauses = [(before[1], after[0]) for before, after in pairwise(joined)]
        pause = min(self._PAUSE, 0.2 / max(len(self.pauses), 1))
        total = max(sum(stop - start for start, stop in joined), 1e-9)
        scale = (1.0 - pause * len(self.pauses)) / total
        times, places, at = [], [], 0.0
        for start, stop in joined:
            times += [start, stop]
            places += [at, at + scale * (stop - start)]
            at = places[-1] + pause
        self._times, self._places, self._joined, self._total = times, places, joined, total

    @property
    def ends(self) -> tuple[float, float]:
        """First and last time, s."""
        return self._times[0], self._times[-1]

    def place(self, time: Array) -> Array:
        """Return the positions of times, 0 at the left edge and 1 at the right."""
        return np.asarray(np.interp(time, self._times, self._places))

    def at(self, time: float) -> float:
        """Return the position of one time."""
        return float(self.place(np.array([time]))[0])

    def ticks(self) -> Iterator[tuple[float, str]]:
        """Yield positions and labels of the ticks, spaced widely enough for a telephone."""
        step = nice(self._total / 5.0)
        last = -1.0
        for start, stop in self._joined:
            for k in range(math.ceil(start / step - 1e-9), math.floor(stop / step + 1e-9) + 1):
                place = self.at(k * step)
                if place - last >= 0.12:
                    yield place, tick_label(k * step, step)
                    last = place


def nice(rough: float) -> float:
    """Return the next number that is 1, 2 or 5 times a power of ten."""
    if not rough > 0.0 or not math.isfinite(rough):
        return 1.0
    power = 10.0 ** math.floor(math.log10(rough))
    return next(power * nice for nice in _NICE if power * nice >= rough * (1.0 - 1e-9))


def tick_label(value: float, step: float) -> str:
    """Return the label of a tick, with the digits needed for the tick spacing."""
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value:z.{digits}f}" if digits < 7 and abs(value) < 1e7 else f"{value:.3g}"
