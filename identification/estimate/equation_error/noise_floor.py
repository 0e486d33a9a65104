"""Computes the torque noise floor of a fit: the part of the residual that does not repeat with the
command.

Unmodelled physics causes the same error whenever a motion is repeated; noise does not repeat. The
difference of the residuals of two passes with equal inputs has twice the variance of the noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.equation_error.regression import model_torque
from identification.numerics.arrays import Array, BoolArray
from identification.prepare import Prepared, uniform_grid, volts_per_torque
from identification.recording import Recording
from identification.signals import resample

INPUTS = ("command", "feedforward", "load_force")
SAME = 2e-3
"""Greatest difference of inputs that count as equal, as a share of the range of each input."""
LEAST_CORRELATION = 0.95
"""Least autocorrelation of the command at a lag that counts as its period."""
NEAR, ROWS = 0.05, 2000
"""Range of the lags that are tried around the first lag of high autocorrelation, as a share of this
first lag, and number of samples that are compared at each lag.
"""
NEIGHBOURS = 0.02
"""Share of the period, or of the duration of a repeat, over which inputs must be equal before and
after a sample.
"""
LEAST_SAMPLES = 100


@dataclass(frozen=True)
class Floor:
    """Torque noise floor: the least torque error that any model of these recordings can have.

    Attributes:
        rms: Rms of the floor, in the unit of the fit.
        samples: Number of pairs of samples used.
        periods: Number of pairs of periods within recordings used.
        repeats: Number of pairs of recordings used.
    """

    rms: float
    samples: int
    periods: int
    repeats: int


def noise_floor(
    prepared: Sequence[Prepared], values: Mapping[str, float], alpha: float
) -> Floor | None:
    """Return the floor from periods within recordings and from repeated recordings, or None if no
    motion is repeated.

    Args:
        prepared: Recordings at one bandwidth.
        values: Parameters of a fit; the repeating part of the fit's error cancels in the
            differences.
        alpha: Stribeck exponent.
    """
    residuals = {id(p): p.torque - model_torque(p, values, alpha) for p in prepared}
    total = samples = 0.0
    periods = repeats = 0
    for p in prepared:
        lag = command_period(p.recording)
        if lag is None:
            continue
        share, count = _difference(p, p, lag, residuals, lag)
        total, samples, periods = total + share, samples + count, periods + (count > 0)
    for k, p in enumerate(prepared):
        other = next((q for q in prepared[k + 1 :] if _same_rig(p.recording, q.recording)), None)
        if other is None:
            continue
        shift = float(other.recording.time[0] - p.recording.time[0])
        share, count = _difference(p, other, shift, residuals, float(np.ptp(p.recording.time)))
        total, samples, repeats = total + share, samples + count, repeats + (count > 0)
    if samples < LEAST_SAMPLES:
        return None
    scale = volts_per_torque(prepared[0].recording) or 1.0
    return Floor(scale * math.sqrt(0.5 * total / samples), int(samples), periods, repeats)


def command_period(recording: Recording) -> float | None:
    """Return the period of the command, s, or None if the command does not repeat."""
    if "command" not in recording.channels:
        return None
    series = resample(recording.time, recording.channels["command"], uniform_grid(recording))
    centred = series - np.mean(series)
    n = len(centred)
    if not np.any(centred):
        return None
    size = 1 << (2 * n - 1).bit_length()
    product = np.fft.irfft(np.abs(np.fft.rfft(centred, size)) ** 2, size)[:n]
    power = np.concatenate(([0.0], np.cumsum(centred**2)))
    lags = np.arange(n)
    scale = np.sqrt((power[n - lags]) * (power[n] - power[lags]))
    correlation = np.divide(product, scale, out=np.zeros(n), where=scale > 1e-12 * power[n])[
        : n // 2 + 1
    ]
    away = np.flatnonzero(correlation < 0.5)
    if away.size == 0:
        return None
    peak = float(np.max(correlation[away[0] :]))
    if peak < LEAST_CORRELATION:
        return None
    # The autocorrelation has peaks of equal height at all multiples of the period; the first peak
    # is the period.
    first = int(away[0] + np.argmax(correlation[away[0] :] > peak - 0.005))
    return _sharpened(series, first) * recording.period


def _sharpened(series: Array, lag: int) -> int:
    """Return the lag near ``lag`` at which the greatest part of the series repeats; the lag of the
    greatest autocorrelation would be biased if the series fades in and out.
    """
    reach = max(round(NEAR * lag), 1)
    lags = np.arange(max(lag - reach, 1), min(lag + reach, len(series) - 2) + 1)
    rows = np.arange(0, len(series) - int(lags[-1]), max(len(series) // ROWS, 1))
    changes = [float(np.median(np.abs(series[rows + k] - series[rows]))) for k in lags]
    return int(lags[int(np.argmin(changes))])


def _same_rig(one: Recording, other: Recording) -> bool:
    return (
        one.stage == other.stage
        and one.weight_mass == other.weight_mass
        and one.pendulum == other.pendulum
        and one.bench == other.bench
        and one.hoist == other.hoist
        and one.constant_torque == other.constant_torque
        and one.controller == other.controller
        and "command" in one.channels
        and "command" in other.channels
    )


def _difference(
    p: Prepared, q: Prepared, shift: float, residuals: Mapping[int, Array], span: float
) -> tuple[float, int]:
    """Return the sum of (e_p(t) - e_q(t + shift))^2, with the residuals e_p and e_q of two
    recordings, over the moving samples with equal inputs, and the number of these samples.
    """
    later = p.time + shift
    inside = (later >= q.time[0]) & (later <= q.time[-1])
    moving = p.used & (np.interp(later, q.time, q.used.astype(np.float64)) > 0.999)
    both = inside & moving & _equal_inputs(p, q, later, span)
    error = residuals[id(p)] - np.interp(later, q.time, residuals[id(q)])
    return float(np.sum(error[both] ** 2)), int(np.sum(both))


def _equal_inputs(p: Prepared, q: Prepared, later: Array, span: float) -> BoolArray:
    equal = np.ones(len(p.time), dtype=bool)
    for name in INPUTS:
        ours, theirs = p.recording.channels.get(name), q.recording.channels.get(name)
        if ours is None and theirs is None:
            continue
        if ours is None or theirs is None:
            return np.zeros(len(p.time), dtype=bool)
        here = np.interp(p.time, p.recording.time, ours)
        there = np.interp(later, q.recording.time, theirs)
        equal &= np.abs(here - there) <= SAME * max(float(np.ptp(ours)), 1e-300)
    step = float(p.time[1] - p.time[0]) if len(p.time) > 1 else 1.0
    reach = max(round(NEIGHBOURS * span / step), 1)
    others = np.concatenate(([0], np.cumsum(~equal)))
    place = np.arange(len(equal))
    first, last = np.maximum(place - reach, 0), np.minimum(place + reach + 1, len(equal))
    return np.asarray(others[last] == others[first])
