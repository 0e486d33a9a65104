"""Even sampling: missing or late samples of a recording are interpolated and marked.

The Kalman filter runs from sample to sample with one period. On a bench without faults few samples
are lost or late, and gaps are short; torque and angle are nearly linear across a short gap. The
callers of this module omit the samples in longer gaps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.numerics.arrays import Array, BoolArray
from identification.recording import Recording
from identification.signals import quantum

OFF_GRID = 0.01
"""Greatest distance of a time stamp from its time on the grid, in periods."""
MOST_FILLED = 0.1
"""Greatest share of interpolated samples; above this share the sampling counts as uneven."""
SHORT_HOLE = 3
"""Greatest number of missing samples in a row that are interpolated and used."""
_COUNTED = ("angle", "motor_angle")


def evened(recording: Recording) -> tuple[Recording, BoolArray] | None:
    """Return the recording with evenly spaced samples, and a mask of the samples in gaps that are
    too long to be used; None if the sampling is uneven.

    The grid is fitted to all time stamps, because a grid with the median period would drift away
    from the time stamps within seconds. A recording with even samples is returned unchanged.
    """
    time = recording.time
    steps = np.diff(time)
    period = float(np.median(steps))
    if float(np.ptp(steps)) <= OFF_GRID * period:
        return recording, np.zeros(len(time), dtype=bool)
    index, origin, period = _grid(time, period)
    on = np.abs(time - origin - period * index) <= OFF_GRID * period
    on[1:] &= np.diff(index) > 0
    size = int(index[-1]) + 1
    if index[0] != 0 or np.sum(on) < (1.0 - MOST_FILLED) * size:
        return None
    measured = np.zeros(size, dtype=bool)
    measured[index[on]] = True
    grid: Array = np.asarray(origin + period * np.arange(size), dtype=np.float64)
    channels: dict[str, Array] = {"time": grid}
    for name, values in recording.channels.items():
        if name == "time":
            continue
        filled = np.interp(grid, time, values)
        step = quantum(values) if name in _COUNTED else 0.0
        if step > 0.0:
            first = values[0]
            filled = first + np.round((filled - first) / step) * step
        filled[index[on]] = values[on]
        channels[name] = filled
    return replace(recording, channels=channels), _long(~measured)


def _grid(
    time: Array, period: float
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], float, float]:
    """Return the grid index of each sample, and origin and period of the grid, s.

    Origin and period are those of a straight line of time stamp over index. The line is fitted
    twice, the second time without the samples that are far from the first line.
    """
    index = np.concatenate(
        ([0], np.cumsum(np.maximum(np.round(np.diff(time) / period), 0.0)))
    ).astype(np.int64)
    origin = float(time[0])
    near = np.ones(len(time), dtype=bool)
    for _ in range(2):
        slope, origin = (float(v) for v in np.polyfit(index[near], time[near], 1))
        period = slope
        index = np.round((time - origin) / period).astype(np.int64)
        near = np.abs(time - origin - period * index) <= OFF_GRID * period
        if np.sum(near) < 2:
            break
    return index, origin, period


def _long(missing: BoolArray) -> BoolArray:
    """Return the marks in runs of more than :data:`SHORT_HOLE` missing samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], missing.astype(np.int64), [0]))))
    out = np.zeros(len(missing), dtype=bool)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        out[start:stop] = stop - start > SHORT_HOLE
    return out
