"""Signal conditioning shared by every estimator: pure functions of arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from identification.numerics.arrays import Array
from identification.numerics.arrays import BoolArray as BoolArray
from identification.numerics.compiled import compiled, compiled_sums
from identification.recording import Recording

_ANGLES = (math.pi / 8.0, 3.0 * math.pi / 8.0)
"""Angles of the poles of a fourth-order Butterworth filter from the imaginary axis."""


def sections(share: float) -> Array:
    """Return numerator and denominator of the two second-order sections of a fourth-order
    Butterworth low-pass, by the bilinear transformation, shape (2, 6).

    Args:
        share: Cut-off over half the sampling rate, between 0 and 1.
    """
    warped = math.tan(0.5 * math.pi * share)
    square = warped * warped
    out = []
    for angle in _ANGLES:
        damping = 2.0 * warped * math.sin(angle)
        whole = 1.0 + damping + square
        gain = square / whole
        denominator = (1.0, 2.0 * (square - 1.0) / whole, (1.0 - damping + square) / whole)
        out.append((gain, 2.0 * gain, gain, *denominator))
    return np.array(out)


def forwards_and_backwards(filters: Array, values: Array, padding: int) -> Array:
    """Return values filtered forwards and backwards, shape (n,).

    The series is continued at both ends by its point reflection in the end value. Each pass of the
    filter starts in the steady state for its first value (alternatives: Gustafsson, IEEE
    Transactions on Signal Processing 44 (1996) 988).

    Args:
        filters: Second-order sections of unit static gain, shape (k, 6).
        values: Shape (n,).
        padding: Number of values added at each end, less than n.
    """
    longer = np.concatenate(
        [
            2.0 * values[0] - values[padding:0:-1],
            values,
            2.0 * values[-1] - values[-2 : -padding - 2 : -1],
        ]
    )
    for _ in range(2):
        _filter(filters, longer)
        longer = longer[::-1].copy()
    return longer[padding : padding + len(values)].copy()


@compiled
def _filter(filters: Array, values: Array) -> None:
    """Filter values in place through second-order sections (transposed direct form II)."""
    for s in filters:
        b0, b1, b2, a1, a2 = s[0], s[1], s[2], s[4], s[5]
        # The initial state is the steady state for a constant input of the first value; the static
        # gain is one.
        one, two = (1.0 - b0) * values[0], (b2 - a2) * values[0]
        for k in range(len(values)):
            x = values[k]
            y = b0 * x + one
            one = b1 * x - a1 * y + two
            two = b2 * x - a2 * y
            values[k] = y


_LEAST_STEPS = 8  # least number of small steps with a common divisor that is not chance
_LONGEST_STEP = 1.5  # longest step between two samples without a missing sample, in sample periods
_KAISER = 5.0  # shape parameter beta of the Kaiser window of the low-pass


def quantum(values: Array) -> float:
    """Return the resolution of a quantised channel, its smallest step; 0.0 if the values look
    continuous.

    A channel counts as quantised if its steps are whole multiples of the smallest step within 2 %
    of this step, as the steps of an encoder are after any scale and offset. Steps of up to 20 times
    the smallest step determine the quantum. Steps of up to 400 times the quantum test the result,
    because near a turning point the steps of a smooth curve are also as 1 to 3 to 5.
    """
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    steps = steps[steps > 1e-9 * float(np.max(steps, initial=0.0))]
    if steps.size == 0:
        return 0.0
    unit = float(np.median(steps[steps < 1.5 * np.min(steps)]))
    for reach in (20.0, 400.0):
        near = steps[steps < reach * unit]
        counts = np.round(near / unit)
        if near.size < _LEAST_STEPS or float(np.mean(np.abs(near / unit - counts) < 0.02)) <= 0.98:
            return 0.0
        unit = float(counts @ near / (counts @ counts))
    return unit


def resample(time: Array, values: Array, grid: Array, offset: float = 0.0) -> Array:
    """Interpolate ``values``, valid at ``time + offset``, linearly onto ``grid``."""
    return np.interp(grid, time + offset, values)


def values_at_ends(
    time: Array, means: Array, period: float, known: BoolArray | None = None
) -> Array:
    """Return the values of a channel at the ends of its sample periods, from its means over them.

    The reconstruction is exact for cubics; interpolation between means would also smooth the
    channel over two periods. Where a sample is missing or unknown nearby, the means are
    interpolated along a straight line, and the last value is the last mean.

    Args:
        time: Times at which the sample periods end, s, shape (n,).
        means: Mean of each sample over the period that ends at its time, shape (n,).
        period: Sample period, s.
        known: Samples whose means are known, shape (n,); all by default.
    """
    out = np.interp(time, time - 0.5 * period, means)
    if len(means) < 4:
        return out
    good = np.ones(len(means), bool) if known is None else known
    even = np.diff(time) < _LONGEST_STEP * period
    whole = good[:-3] & good[1:-2] & good[2:-1] & good[3:] & even[:-2] & even[1:-1] & even[2:]
    curved = means[1:-2] + means[2:-1] - means[:-3] - means[3:]
    out[1:-2] += np.where(whole, curved / 12.0, 0.0)
    return out


def derivative(values: Array, step: float) -> Array:
    """Differentiate by seven points (error of order step^6), lower order at the ends."""
    out = np.gradient(values, step)
    if len(values) >= 7:
        out[3:-3] = (
            45.0 * (values[4:-2] - values[2:-4])
            - 9.0 * (values[5:-1] - values[1:-5])
            + (values[6:] - values[:-6])
        ) / (60.0 * step)
    return out


def central_difference(values: Array, step: float) -> Array:
    """Differentiate by the three-point central difference; one-sided at the ends."""
    return np.gradient(values, step)


def smooth(values: Array, rate: float, cutoff: float) -> Array:
    """Low-pass without phase lag: a fourth-order Butterworth filter, forwards and backwards."""
    if cutoff >= 0.45 * rate:
        return values
    padding = min(len(values) - 1, int(3 * rate / cutoff))
    series = np.asarray(values, dtype=np.float64)
    return forwards_and_backwards(sections(cutoff / (0.5 * rate)), series, padding)


@dataclass(frozen=True)
class Decimator:
    """A symmetric FIR low-pass with decimation, which torque and regressors pass alike."""

    taps: Array  # filter, shape (2 half + 1,), sum 1; a single tap means no filtering
    factor: int  # decimation: one sample in `factor` remains

    @property
    def half(self) -> int:
        """Number of samples before and after its own time on which an output depends."""
        return len(self.taps) // 2

    def __call__(self, values: Array) -> Array:
        """Filter and decimate the last axis, without outputs beyond the ends."""
        if self.half == 0:
            return values[..., :: self.factor]
        series = np.ascontiguousarray(values, dtype=np.float64).reshape(-1, values.shape[-1])
        return _decimated(series, self.taps, self.factor).reshape(*values.shape[:-1], -1)

    def chosen(self, values: Array, places: NDArray[np.int64]) -> Array:
        """Return the outputs at the indices ``places``, (n, k), for series (k, m)."""
        if self.half == 0:
            return np.asarray(values[:, :: self.factor][:, places].T)
        return _chosen(
            np.ascontiguousarray(values, dtype=np.float64), self.taps, self.factor, places
        )

    def untouched(self, bad: BoolArray) -> BoolArray:
        """Return a mask of the outputs, after decimation, that depend on no ``bad`` sample."""
        total = np.concatenate(([0], np.cumsum(bad)))
        reach = len(self.taps)
        return np.asarray((total[reach:] == total[:-reach])[:: self.factor])


@compiled_sums
def _decimated(series: Array, taps: Array, factor: int) -> Array:
    """Return every ``factor``-th output of a symmetric FIR filter, (k, m) to (k, n)."""
    reach = len(taps)
    out = np.empty((series.shape[0], max(0, (series.shape[1] - reach) // factor + 1)))
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            under = series[i, j * factor : j * factor + reach]
            total = 0.0
            for k in range(reach):
                total += taps[k] * under[k]
            out[i, j] = total
    return out


@compiled_sums
def _chosen(series: Array, taps: Array, factor: int, places: NDArray[np.int64]) -> Array:
    """Return the outputs of :func:`_decimated` at the indices ``places``, (k, m) to (n, k)."""
    reach, count = len(taps), len(places)
    out = np.zeros((count, series.shape[0]))
    for i in range(series.shape[0]):
        size = 0.0
        for value in series[i]:
            size += abs(value)
        if size == 0.0:
            continue
        # Four outputs are computed at a time, so that no addition waits for the result of the
        # previous one.
        for j in range(0, count - 3, 4):
            a = series[i, places[j] * factor : places[j] * factor + reach]
            b = series[i, places[j + 1] * factor : places[j + 1] * factor + reach]
            c = series[i, places[j + 2] * factor : places[j + 2] * factor + reach]
            d = series[i, places[j + 3] * factor : places[j + 3] * factor + reach]
            total_a = total_b = total_c = total_d = 0.0
            for k in range(reach):
                total_a += taps[k] * a[k]
                total_b += taps[k] * b[k]
                total_c += taps[k] * c[k]
                total_d += taps[k] * d[k]
            out[j, i], out[j + 1, i], out[j + 2, i], out[j + 3, i] = (
                total_a,
                total_b,
                total_c,
                total_d,
            )
        for j in range(count - count % 4, count):
            under = series[i, places[j] * factor : places[j] * factor + reach]
            total = 0.0
            for k in range(reach):
                total += taps[k] * under[k]
            out[j, i] = total
    return out


def reach(rate: float, bandwidth: float) -> tuple[int, int]:
    """Return decimation factor and half length of the low-pass; (1, 0) for none."""
    if bandwidth >= 0.45 * rate:
        return 1, 0
    factor = max(1, round(rate / (2.5 * bandwidth)))
    return factor, factor * max(2, round(1.6 * rate / bandwidth / factor))


def decimator(rate: float, bandwidth: float) -> Decimator:
    """Design the low-pass for a bandwidth in Hz: -6 dB at the bandwidth, decimated to 2.5 times the
    bandwidth.

    If the bandwidth is 0.45 of the rate or more, the filter has nothing to remove, and the identity
    is returned.
    """
    factor, half = reach(rate, bandwidth)
    if half == 0:
        return Decimator(np.ones(1), 1)
    return Decimator(_low_pass(half, 2.0 * bandwidth / rate), factor)


def _low_pass(half: int, cutoff: float) -> Array:
    """Return the taps of a low-pass of sum one, a sinc in Kaiser's window, (2 half + 1,)."""
    # scipy.signal.firwin returns the same taps, but takes a quarter of the time of all imports.
    place = np.arange(-half, half + 1, dtype=np.float64)
    bessel = scipy.special.i0  # imported here, since no run needs it
    window = bessel(_KAISER * np.sqrt(1.0 - (place / half) ** 2.0)) / bessel(_KAISER)
    taps = cutoff * np.sinc(cutoff * place) * window
    taps /= np.sum(taps)
    return np.asarray(taps / taps.sum())


REST_RAD_S = 1e-4  # mean speed over `REST_SPAN_S` below which a joint counts as resting
REST_SPAN_S = 0.05


@dataclass(frozen=True)
class Tracking:
    """Tracking errors and effort of one recording or a part of it."""

    rms: float  # rms of command less angle, rad
    largest: float  # greatest magnitude of command less angle, rad
    # Last value of command less angle, rad; the steady-state error if the command is constant.
    at_end: float
    energy: float  # electrical energy consumed by the motor, the integral of U I, J
    waiting: float  # share of the commanded motion time in which the joint rested


def tracking_error(recording: Recording) -> Array:
    """Return command less angle one sample after the command was sent, rad, (n,)."""
    command = recording.channels["command"]
    return np.asarray(np.concatenate([command[:1], command[:-1]]) - recording.channels["angle"])


def resting(recording: Recording) -> Array:
    """Return 1 at samples where the mean speed of the joint is near zero, else 0, (n,)."""
    n = max(1, round(REST_SPAN_S / recording.period))
    angle = recording.channels["angle"]
    padded = np.pad(angle, (n // 2, n - n // 2), mode="edge")
    return np.asarray(
        np.abs(padded[n:] - padded[:-n]) < REST_RAD_S * n * recording.period, dtype=np.float64
    )


def track(recording: Recording, first: float = 0.0, last: float = np.inf) -> Tracking:
    """Return the tracking errors of a recording from ``first`` to ``last`` s after its start."""
    time = recording.time - recording.time[0]
    part = (time >= first) & (time < last)
    if not np.any(part):
        raise ValueError(f"{recording.name}: no sample from {first:g} to {last:g} s")
    error = tracking_error(recording)[part]
    command = recording.channels["command"]
    sent = np.abs(np.gradient(command, recording.period)) > REST_RAD_S
    moving = part & sent
    power = recording.channels["voltage"] * recording.channels["current"]
    return Tracking(
        rms=float(np.sqrt(np.mean(error**2))),
        largest=float(np.max(np.abs(error))),
        at_end=float(error[-1]),
        energy=float(np.nansum(power[part]) * recording.period),
        waiting=float(np.mean(resting(recording)[moving])) if np.any(moving) else 0.0,
    )


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
    """Return the sine that explains most of the rows; the times may be uneven."""
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
