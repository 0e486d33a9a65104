"""Compiled functions of series: sine, cosine; responses with memory: lag, Dahl, play, heat."""

from __future__ import annotations

import math

import numpy as np

from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled

SAME_STEP = 1e-6  # relative difference of two time steps up to which it counts as a rounding error
_PER_HALF_TURN = 1.0 / math.pi
_HALF_TURN, _REST = 3.1415926534682512, 1.2154201013012384e-10
"""pi to 33 bits, whose small multiples are exact, and the remainder of pi."""
_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(11))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(12))
_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8, _S9, _S10 = _SINE[1:]
_C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11 = _COSINE[1:]


def sine_cosine(frequency: float, angle: Array) -> Array:
    """Return sin and cos of ``frequency * angle``, shape (2, m), with an error of a few units of
    1e-16 for phases below a million half turns.

    This function has no branches, so that the processor computes several samples at a time; numpy
    computes one sample at a time and takes ten times as long.
    """
    out = np.empty((2, len(angle)))
    _fill(frequency, angle, out[0], out[1])
    return out


@compiled
def _fill(frequency: float, angle: Array, sine: Array, cosine: Array) -> None:
    # The compiler must not change the order of these sums, because it would add the two parts of
    # pi.
    for k in range(len(angle)):
        phase = frequency * angle[k]
        turns = np.floor(phase * _PER_HALF_TURN + 0.5)
        rest = (phase - turns * _HALF_TURN) - turns * _REST
        z = rest * rest
        sign = 1.0 - 2.0 * (turns - 2.0 * np.floor(0.5 * turns))
        # Power series for phases within a quarter turn on either side; the first omitted terms are
        # below 1e-18.
        odd = _S5 + z * (_S6 + z * (_S7 + z * (_S8 + z * (_S9 + z * _S10))))
        odd = 1.0 + z * (_S1 + z * (_S2 + z * (_S3 + z * (_S4 + z * odd))))
        even = _C5 + z * (_C6 + z * (_C7 + z * (_C8 + z * (_C9 + z * (_C10 + z * _C11)))))
        even = 1.0 + z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * even))))
        sine[k] = sign * rest * odd
        cosine[k] = sign * even


@compiled
def first_order_lag(series: Array, step: float, time_constant: float) -> Array:
    """Return the series after a first-order lag, in steady state at the start, linear between
    samples, shape (m,).

    The input is linear between samples, because with a zero-order hold the lag would be too short
    by half a step.
    """
    out = np.empty_like(series)
    state = series[0]
    out[0] = state
    share = 1.0 - np.exp(-step / time_constant)
    rise = 1.0 - share * time_constant / step
    for k in range(1, len(series)):
        change = series[k] - series[k - 1]
        state += share * (series[k - 1] - state) + rise * change
        out[k] = state
    return out


@compiled
def dahl(angle: Array, level: Array, stiffness: float, start: float = 0.0) -> Array:
    """Return Dahl friction, dF = stiffness (1 - F sgn(dtheta)/level) dtheta, N m, shape (m,).

    Dahl, AIAA J. 14 (1976) 1675. The solution over each step is exact, for any step. ``start`` is
    the friction at the first sample, N m.
    """
    out = np.empty_like(angle)
    force = min(max(start, -level[0]), level[0])
    out[0] = force
    for k in range(1, len(angle)):
        travel = angle[k] - angle[k - 1]
        if travel != 0.0 and level[k] > 0.0:
            goal = level[k] if travel > 0.0 else -level[k]
            force = goal + (force - goal) * np.exp(-stiffness * abs(travel) / level[k])
        out[k] = force
    return out


@compiled
def play(angle: Array, gap: float, start: float = 0.0) -> Array:
    """Return the lead of the driving side of a gap over its driven side, within +- gap/2, shape
    (m,).

    Friction holds the driven side at rest until a flank of the gap drives it. If the input is a
    torque in place of an angle, the lead is the force of one Maxwell-slip element. ``start`` is the
    lead at the first sample.
    """
    out = np.empty_like(angle)
    half = 0.5 * gap
    lead = min(max(start, -half), half)
    out[0] = lead
    for k in range(1, len(angle)):
        lead += angle[k] - angle[k - 1]
        if (
            lead > half
        ):  # the processor predicts branches; min and max would each wait for the previous value
            lead = half
        elif lead < -half:
            lead = -half
        out[k] = lead
    return out


@compiled
def first_swing(series: Array, width: float) -> int:
    """Return the first sample at which the range of a series reaches ``width``; from this sample on
    the output of a play (backlash operator) of this width does not depend on its start value.

    The result is the number of samples if the range never reaches ``width``.
    """
    low = high = series[0]
    for k in range(len(series)):
        low, high = min(low, series[k]), max(high, series[k])
        if high - low >= width:
            return k
    return len(series)


@compiled
def falling_play(
    angle: Array, speed: Array, step: float, gap: float, pull: Array, hold: Array, start: float
) -> Array:
    """Return the lead as in :func:`play`, but with a weight that may move the driven side through
    the open gap, shape (m,).

    Args:
        angle: Angle of the driving side, rad.
        speed: Speed of the driving side, rad/s; the driven side has this speed while a flank drives
            it.
        step: Time step, s.
        gap: Width of the gap, rad.
        pull: Torque of the weight on the driven side over the inertia of this side, rad/s^2.
        hold: Friction torque of the driven side over the inertia of this side, rad/s^2.
        start: Lead at the first sample, rad.
    """
    out = np.empty_like(angle)
    half = 0.5 * gap
    lead = min(max(start, -half), half)
    out[0] = lead
    moves = 0.0
    for k in range(1, len(angle)):
        free = moves + step * pull[k]
        moves = np.sign(free) * max(abs(free) - step * hold[k], 0.0)
        lead += angle[k] - angle[k - 1] - step * moves
        if abs(lead) >= half:
            lead = half if lead > 0.0 else -half
            moves = speed[k]
        out[k] = lead
    return out


@compiled
def temperature_rise(loss: Array, run_time: Array, time_constant: float) -> Array:
    """Return the heating of a first-order thermal body, shape (2, m): temperature rise over thermal
    resistance, W, and the remainder of an initial temperature rise of 1 K.
    """
    out = np.empty((2, len(loss)))
    rise, left = 0.0, 1.0
    out[0, 0], out[1, 0] = rise, left
    step = kept = 0.0
    for k in range(1, len(loss)):
        # Steps of an even grid differ only by rounding errors, and an exponential for each step
        # would take most of the computing time.
        if abs(run_time[k] - run_time[k - 1] - step) > SAME_STEP * step:
            step = run_time[k] - run_time[k - 1]
            kept = np.exp(-step / time_constant)
        rise = loss[k] + kept * (rise - loss[k])
        left *= kept
        out[0, k], out[1, k] = rise, left
    return out


@compiled
def delayed_series(series: Array, step: float, time_s: float) -> Array:
    """Return a series delayed by ``time_s`` (advanced if negative), with the end values held, shape
    (m,).

    Between two samples the series is the cubic through the four nearest samples. A straight line
    would be wrong by an eighth of the acceleration times ``step`` squared, which in a log of 100 Hz
    exceeds the noise of an encoder. Beside the ends the series is a straight line.
    """
    out = np.empty(len(series))
    last = len(series) - 1
    for k in range(len(series)):
        place = min(max(k - time_s / step, 0.0), float(last))
        j = min(int(place), last - 1)
        x = place - j
        line = (series[j + 1] - series[j]) * x + series[j]
        if 1 <= j < last - 1:
            bent = series[j + 1] - 2.0 * series[j] + series[j - 1]
            more = series[j + 2] - 3.0 * series[j + 1] + 3.0 * series[j] - series[j - 1]
            line += x * (x - 1.0) * (0.5 * bent + (x + 1.0) / 6.0 * more)
        out[k] = line
    return out
