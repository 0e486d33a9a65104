"""Marks rest, reversal, breakaway and unsteady motion in a recording, and computes time and travel
since the last mark.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from identification.recording import Array
from identification.signals import BoolArray, quantum

RISE_SAMPLES = 5
"""Number of samples before a breakaway over which the torque's rate of rise is averaged."""
STEADY_SHARE = 0.7
"""Ratio of the peak-to-peak variation of the speed around a sample to the speed, from which motion
counts as unsteady.
"""
HUNTING_SHARE = 0.09
"""Ratio of the rms of the part of the speed that the filter removes to the filtered speed, from
which motion counts as unsteady too.
"""
QUICK_SAMPLES = 2
"""Number of samples before and after a sample over which the unfiltered speed is computed."""
BEYOND_FILTER = 3.0
"""Ratio of the bandwidth of the unfiltered speed to the cut-off of the filter, from which an
oscillation of the drive can be distinguished from motion just above the cut-off.
"""
THIRD_DIFFERENCE = math.sqrt(20.0)
"""Standard deviation of the third differences of white noise of unit variance."""
LEAST_REST_S = 0.02
"""Least duration of a rest, s; a shorter rest is not distinguished from slow passage through zero
speed.
"""


def breakaways(still: BoolArray, rest: Array, torque: Array, sense: Array) -> NDArray[np.int64]:
    """Return the samples at which rests end in breakaways, shape (e,)."""
    ends = np.flatnonzero(still[:-1] & ~still[1:]) + 1
    # Motion against the torque at the end of a rest is not a breakaway: a reading of the encoder
    # changes by noise, or the shaft springs back.
    pushed = np.sign(torque)
    kept = [
        k
        for k in ends
        if rest[k - 1] >= LEAST_REST_S and k > RISE_SAMPLES + 1 and pushed[k - 1] == sense[k]
    ]
    return np.array(kept, dtype=np.int64)


class Quick(NamedTuple):
    """The speed, computed by differences over few samples, and the noise of this speed, rad/s."""

    velocity: Array
    noise: float


def quick_speed(series: Array, rate: float) -> Quick:
    """Return the speed by differences over :data:`QUICK_SAMPLES` on either side of each sample of a
    measured position.
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
    """Mark moving samples whose friction is not a function of the filtered speed.

    A sample is unsteady if the speed around it varies by more than a share of the speed, because
    the shaft slips and nearly sticks within the filter's window. A sample is also unsteady if the
    speed varies faster than the filter resolves, as with a drive that oscillates at up to 100 Hz on
    the falling branch of friction. In both cases the mean of friction is not the friction at the
    mean speed.

    Args:
        velocity: Speed filtered to ``cutoff``, rad/s.
        quick: Speed by differences over few samples.
        rate: Sample rate, Hz.
        cutoff: Cut-off of the filter, Hz.
    """
    reach = round(0.5 * rate / cutoff)
    found = _swing(velocity, reach) >= STEADY_SHARE * np.abs(velocity)
    if rate >= 2 * QUICK_SAMPLES * BEYOND_FILTER * cutoff:
        hidden = ndimage.uniform_filter1d((quick.velocity - velocity) ** 2, 2 * reach + 1)
        found |= hidden - quick.noise**2 >= (HUNTING_SHARE * velocity) ** 2
    return np.asarray(found)


def sense(velocity: Array, torque: Array, still: BoolArray) -> Array:
    """Return the sign of friction: the direction of motion, or at rest the sign of the torque."""
    here = np.where(still, np.sign(torque), np.sign(velocity))
    known = np.maximum.accumulate(np.where(here != 0.0, np.arange(len(here)), 0))
    return np.asarray(here[known])


def _swing(series: Array, reach: int) -> Array:
    """Return the difference of the greatest and the least value within ``reach`` samples of each
    sample.
    """
    size = 2 * reach + 1
    return np.asarray(
        ndimage.maximum_filter1d(series, size) - ndimage.minimum_filter1d(series, size)
    )


def reversals(sense: Array) -> BoolArray:
    """Mark samples whose direction differs from that of the previous sample."""
    return np.concatenate(([False], sense[1:] != sense[:-1]))


def time_since(time: Array, marks: BoolArray) -> Array:
    """Return the time since the last marked sample, or since the first sample if none is marked
    before.
    """
    last = np.maximum.accumulate(np.where(marks, np.arange(len(time)), 0))
    return np.asarray(time - time[last])


def last_rest_duration(rest: Array, still: BoolArray) -> Array:
    """Return the duration of the last rest at each sample; the value is held until the next rest
    begins.
    """
    last = np.maximum.accumulate(np.where(still, np.arange(len(rest)), 0))
    return np.asarray(rest[last])


def travel(angle: Array, turned: BoolArray) -> Array:
    """Return the distance of the angle from its value at the last reversal, or at the first
    sample.
    """
    last = np.maximum.accumulate(np.where(turned, np.arange(len(angle)), 0))
    return np.asarray(np.abs(angle - angle[last]))
