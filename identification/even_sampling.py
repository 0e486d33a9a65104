"""Even sampling: missing or late samples of a recording are interpolated and marked.

The Kalman filter runs from sample to sample with one period. On a sound bench few samples are lost
or late, and such gaps are short; torque and angle are nearly linear across them. Callers leave out
longer gaps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.numerics.arrays import Array, BoolArray
from identification.recording import Recording
from identification.signals import quantum

OFF_GRID = 0.01
"""Distance from the grid, in periods, up to which a sample is on it."""
MOST_FILLED = 0.1
"""Greatest share of the grid that may be interpolated; above it the sampling counts as uneven."""
SHORT_HOLE = 3
"""Most samples in a row that are interpolated and used."""
_COUNTED = ("angle", "motor_angle")


def evened(recording: Recording) -> tuple[Recording, BoolArray] | None:
    """Return the recording on its even grid and a mask of the samples in gaps too long to use; None
    where the sampling is uneven.

    The grid is fitted to all time stamps, because a grid with the median period would drift away
    from them within seconds. An even recording is returned unchanged.
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
    """Return the grid index of each sample, and origin and period of the line through their times.

    The line is fitted twice, the second time without the samples that are far from the line.
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
    """Return only the marks in runs longer than :data:`SHORT_HOLE`."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], missing.astype(np.int64), [0]))))
    out = np.zeros(len(missing), dtype=bool)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        out[start:stop] = stop - start > SHORT_HOLE
    return out
