"""Estimates the noise of rows from their differences."""

from __future__ import annotations

import math

import numpy as np

from identification.recording import Array
from identification.signals import Decimator

LEAST_ROWS_OF_A_TONE = 300
"""Least number of rows from which a tone is removed. The strongest sine explains 2 log(n/2)/n of n
rows of white noise, which is 3 % here.
"""
TONE_PADDING, TONE_TRIALS = 4, 10
"""Ratio of the length of the padded spectrum, in which a tone is searched, to the number of rows;
and number of trial frequencies below and above the greatest line of this spectrum.
"""


def noise(series: Array, owner: np.ndarray, low_pass: Decimator) -> float:
    """Return the scatter of a filtered series that is due to white noise before the filter.

    Third differences within recordings remove changes that are smooth from row to row, and the
    median removes rare outliers. The correlation between rows due to the filter is taken into
    account.
    """
    difference = np.diff(series, n=3)
    same = owner[3:] == owner[:-3]
    spread = 1.4826 * float(np.median(np.abs(difference[same]))) if np.any(same) else 0.0
    taps, factor = low_pass.taps, low_pass.factor
    lags = [
        float(taps[k * factor :] @ taps[: len(taps) - k * factor])
        if k * factor < len(taps)
        else 0.0
        for k in range(4)
    ]
    weights = np.convolve([1.0, -3.0, 3.0, -1.0], [-1.0, 3.0, -3.0, 1.0])[3:]
    gain = weights[0] * lags[0] + 2.0 * float(weights[1:] @ np.array(lags[1:]))
    return spread * float(np.sqrt(lags[0] / gain))


def without_tones(series: Array, owner: np.ndarray, time: Array) -> Array:
    """Return the rows with the strongest sine of each recording subtracted.

    In differences from row to row, a torque at one frequency would count as noise.
    """
    out = series.copy()
    for index in np.unique(owner):
        mine = owner == index
        if np.sum(mine) >= LEAST_ROWS_OF_A_TONE:
            out[mine] -= _tone(series[mine], time[mine] - time[mine][0])
    return out


def _tone(rows: Array, time: Array) -> Array:
    """Return the sine that explains the greatest part of the rows; ``time`` are the times of the
    rows, which need not be evenly spaced.
    """
    step = float(np.min(np.diff(time)))
    place = np.round(time / step).astype(np.int64)
    even = np.zeros(int(place[-1]) + 1)
    even[place] = rows - np.mean(rows)
    padded = TONE_PADDING * len(even)
    strongest = int(np.argmax(np.abs(np.fft.rfft(even, padded))[1:])) + 1
    best, least = np.zeros(len(rows)), math.inf
    for offset in np.linspace(-1.0, 1.0, 2 * TONE_TRIALS + 1):
        phase = 2.0 * math.pi * (strongest + float(offset)) / (padded * step) * time
        columns = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        sine = columns @ np.linalg.lstsq(columns, rows, rcond=None)[0]
        left = float(np.sum((rows - sine) ** 2))
        if left < least:
            best, least = sine, left
    return best
