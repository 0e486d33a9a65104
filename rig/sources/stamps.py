"""Corrects time stamps that jitter although the samples were taken evenly; time stamps of a host
often jitter in this way.

An error d of a time stamp has the effect of an angle error of the speed times d. Therefore the
angle shows whether the stamps or the samples are uneven: with the right times, each sample is
nearer to the curve through its neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array

Rows = NDArray[np.intp]
LEAST_JITTER = 0.005
"""Rms deviation of the stamps from an even grid, in periods, below which stamps count as even."""
MOST_OFF = 0.25
"""Greatest mean deviation of neighbouring stamps from the grid, in periods. A lost sample or a
changing rate shifts all later stamps; jitter and single late stamps do not.
"""
WINDOW = 101
"""Number of neighbouring stamps over which the deviation from the grid is averaged."""
SMOOTHER = 0.8
"""Ratio of the angle's roughness on the grid to its roughness at the stamps below which the grid
counts as right.

Quantisation and noise contribute equally to both roughnesses. If quantisation and noise hide the
jitter of the stamps, the jitter has little effect on results.
"""
FAST, MOST = 0.25, 0.99
"""Share and quantile: a sample is compared only if its travel is at least this share of this
quantile of the travels of all samples, because at rest a wrong stamp has no effect.
"""
NEIGHBOURS = (-2, -1, 1, 2)


def even_stamps(time: Array, angle: Array) -> tuple[Array, float] | None:
    """Return the times of evenly taken samples and the rms jitter of their stamps, s, or None if
    the stamps are even, no grid fits them, or the samples themselves are uneven.

    Args:
        time: Time stamps, s, shape (n,), increasing.
        angle: Angle or position, shape (n,).
    """
    found = _grid(time)
    if found is None:
        return None
    grid, index = found
    jitter = float(np.std(time - grid))
    rows = _with_neighbours(index, time)
    if jitter < LEAST_JITTER * float(np.median(np.diff(grid))) or not rows.size:
        return None
    travel = np.abs(angle[rows + 2] - angle[rows - 2])
    rows = rows[travel >= FAST * np.quantile(travel, MOST)]
    on_grid, at_stamps = (_roughness(t, angle, rows) for t in (grid, time))
    return (grid, jitter) if on_grid < SMOOTHER * at_stamps else None


def _grid(time: Array) -> tuple[Array, Rows] | None:
    """Return the times on the line through the stamps, and the number of each sample, or None if
    the mean over neighbouring stamps deviates from the line by more than :data:`MOST_OFF`.
    """
    steps = np.diff(time)
    lost = np.maximum(np.round(steps / float(np.median(steps))), 1.0)
    # Jitter may look like a lost sample; therefore lost samples are assumed only if necessary.
    for counts in (np.ones(len(steps)), lost):
        index = np.concatenate(([0], np.cumsum(counts))).astype(np.intp)
        period, origin = (float(v) for v in np.polyfit(index, time, 1))
        grid: Array = np.asarray(origin + period * index, dtype=np.float64)
        window = min(WINDOW, len(time) // 4)
        mean = np.convolve(time - grid, np.full(window, 1.0 / window), mode="valid")
        if float(np.max(np.abs(mean))) <= MOST_OFF * period:
            return grid, index
    return None


def _with_neighbours(index: Rows, time: Array) -> Rows:
    """Return the rows that have two neighbours on either side, each one period from the next, with
    different stamps.
    """
    consecutive = (np.diff(index) == 1) & (np.diff(time) > 0.0)
    runs = consecutive[:-3] & consecutive[1:-2] & consecutive[2:-1] & consecutive[3:]
    return np.flatnonzero(runs) + 2


def _roughness(time: Array, angle: Array, rows: Rows) -> float:
    """Return the median distance of samples from the cubic polynomial through their neighbours.

    A mean is not used: nearly coinciding stamps magnify the noise of their samples without limit,
    so that these few samples would determine a mean.
    """
    apart = [time[rows + k] - time[rows] for k in NEIGHBOURS]
    predicted = np.zeros(len(rows))
    for j, k in enumerate(NEIGHBOURS):
        weight = np.ones(len(rows))
        for m, other in enumerate(apart):
            if m != j:
                weight *= other / (other - apart[j])
        predicted += weight * angle[rows + k]
    return float(np.median(np.abs(angle[rows] - predicted)))
