"""Where a recording rests, turns, breaks away and moves unsteadily, and for how long it has."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from identification.recording import Array
from identification.signals import BoolArray, quantum

RISE_SAMPLES = 5
"""Samples before a breakaway over which the torque's rise is taken."""
STEADY_SHARE = 0.7
"""Swing of the speed about a sample, over that speed, from which on it does not count as steady."""
HUNTING_SHARE = 0.09
"""Effective value of what the filtered speed does not show, over that speed, from which on it is
not steady either.
"""
QUICK_SAMPLES = 2
"""To either side of a sample, over which its speed is taken to see whether it is steady."""
BEYOND_FILTER = 3.0
"""Frequency that the speed over these samples reaches, over that of the filter, from which on it
tells hunting from what the filter just cuts off.
"""
THIRD_DIFFERENCE = math.sqrt(20.0)
"""Standard deviation of third differences of white noise over its own."""
LEAST_REST_S = 0.02
"""Rests shorter than this are not told from a slow passage through zero."""


def breakaways(still: BoolArray, rest: Array, torque: Array, sense: Array) -> NDArray[np.int64]:
    """Return the samples at which rests end in breakaways, shape (e,)."""
    ends = np.flatnonzero(still[:-1] & ~still[1:]) + 1
    # What moves against the torque as a rest ends has not broken away: a count flickers, or the
    # shaft springs back.
    pushed = np.sign(torque)
    kept = [
        k
        for k in ends
        if rest[k - 1] >= LEAST_REST_S and k > RISE_SAMPLES + 1 and pushed[k - 1] == sense[k]
    ]
    return np.array(kept, dtype=np.int64)


class Quick(NamedTuple):
    """The speed within a few samples, hardly filtered, and its noise, rad/s."""

    velocity: Array
    noise: float


def quick(series: Array, rate: float) -> Quick:
    """Return the speed over :data:`QUICK_SAMPLES` to either side of each sample of a measured
    position.
    """
    span = 2 * QUICK_SAMPLES / rate
    padded = np.pad(series, QUICK_SAMPLES, mode="edge")
    rough = 1.4826 * float(np.median(np.abs(np.diff(series, n=3)))) / THIRD_DIFFERENCE
    scatter = max(rough, quantum(series) / math.sqrt(12.0))
    return Quick(
        (padded[2 * QUICK_SAMPLES :] - padded[: -2 * QUICK_SAMPLES]) / span,
        math.sqrt(2.0) * scatter / span,
    )


def unsteady(velocity: Array, quick: Quick, rate: float, cutoff: float) -> BoolArray:
    """Mark samples in motion whose friction is no function of the filtered speed.

    Where the speed changes by more than its own size: the shaft slips and nearly sticks within the
    filter. And where it changes faster than that speed shows, as a drive does that hunts on falling
    friction at up to 100 Hz: mean friction is not friction at the mean speed.

    Args:
        velocity: Filtered to ``cutoff``, rad/s.
        quick: The same, hardly filtered.
        rate: Hz.
        cutoff: Hz.
    """
    reach = round(0.5 * rate / cutoff)
    found = _swing(velocity, reach) >= STEADY_SHARE * np.abs(velocity)
    if rate >= 2 * QUICK_SAMPLES * BEYOND_FILTER * cutoff:
        hidden = ndimage.uniform_filter1d((quick.velocity - velocity) ** 2, 2 * reach + 1)
        found |= hidden - quick.noise**2 >= (HUNTING_SHARE * velocity) ** 2
    return np.asarray(found)


def sense(velocity: Array, torque: Array, still: BoolArray) -> Array:
    """Return the direction in which friction acts: that of motion, at rest that of the torque."""
    here = np.where(still, np.sign(torque), np.sign(velocity))
    known = np.maximum.accumulate(np.where(here != 0.0, np.arange(len(here)), 0))
    return np.asarray(here[known])


def _swing(series: Array, reach: int) -> Array:
    """Return greatest less least value about each sample."""
    size = 2 * reach + 1
    return np.asarray(
        ndimage.maximum_filter1d(series, size) - ndimage.minimum_filter1d(series, size)
    )


def turned(sense: Array) -> BoolArray:
    """Mark samples whose direction differs from that of the one before."""
    return np.concatenate(([False], sense[1:] != sense[:-1]))


def since(time: Array, marks: BoolArray) -> Array:
    """Return the time since the last marked sample; since the start before there is one."""
    last = np.maximum.accumulate(np.where(marks, np.arange(len(time)), 0))
    return np.asarray(time - time[last])


def held(rest: Array, still: BoolArray) -> Array:
    """Keep the length of the last rest until the next one begins."""
    last = np.maximum.accumulate(np.where(still, np.arange(len(rest)), 0))
    return np.asarray(rest[last])


def travel(angle: Array, turned: BoolArray) -> Array:
    """Return the travel since the last turn, as far as that was; since the start before there is
    one.
    """
    last = np.maximum.accumulate(np.where(turned, np.arange(len(angle)), 0))
    return np.asarray(np.abs(angle - angle[last]))
