"""Computes the one-step prediction errors of the angle by an extended Kalman filter with the
measured torque as input (M14-M21).

The measured torque is a noisy mean over each period, and the encoder is quantised. An output error
would drift with the torque noise, and an equation error needs derivatives of the encoder signal;
the one-step prediction error of the joint angle has neither drawback. The filter has the state
(angle, speed), with J domega/dt = torque - friction(omega) + noise and y = angle + noise. A
correlated part of the torque noise is a third state, a first-order process that is constant within
each period. The normalised innovations are white when the model is right, and their sum of squares
is the likelihood (Ljung, System Identification, 2nd ed., 7.3 and 10.5).

A motion segment starts at its breakaway time, at the angle of rest and with speed zero. Segments
run side by side (:mod:`identification.filter.lanes`).
"""

from __future__ import annotations

import math

import numpy as np

from identification.filter.lanes import (
    CORRELATED,
    L_ANGLE,
    L_ANSWER,
    L_B,
    L_C,
    L_DIFFUSION,
    L_ERROR,
    L_GROWTH,
    L_HIDDEN,
    L_INVERSE,
    L_LENGTH,
    L_MIDDLE,
    L_MOMENT,
    L_NOW,
    L_OMEGA,
    L_P11,
    L_P12,
    L_P13,
    L_P22,
    L_P23,
    L_P33,
    L_READING_NOISE,
    L_SHARE,
    L_SIDE,
    L_SLOPE,
    L_STAYING,
    L_STEPS,
    L_TORQUE,
    L_UNSURE,
    L_VARIANCE,
    LANES,
    LEAST_SPEED,
    WORKSPACE,
    loaded,
    started,
    still_active,
    whole,
)
from identification.filter.segment_table import FIRST, LAST
from identification.model.friction import Law, expected_friction, law
from identification.model.parameters import ALPHA, OFFSET
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled, inlined

ERROR, DEVIATION, FILTERED = range(3)
"""Rows of the results: innovation, rad; its standard deviation, rad; filtered correlated torque
noise, N m.
"""


@inlined
def _predicted(t: Array, wide: int, number: float, p: Law) -> None:
    """Propagate the state of all lanes over integration step ``number`` (M16, M17), by the linearly
    implicit trapezoidal rule for the speed.
    """
    for lane in range(wide):
        omega, side, inverse = t[L_OMEGA + lane], t[L_SIDE + lane], t[L_INVERSE + lane]
        p11, p12, p22, now = t[L_P11 + lane], t[L_P12 + lane], t[L_P22 + lane], t[L_NOW + lane]
        h = t[L_LENGTH + lane] if number < t[L_STEPS + lane] else 0.0
        speed = max(side * omega, LEAST_SPEED)
        force, grade = expected_friction(speed, p22, t[L_MOMENT + lane], p)
        push = t[L_TORQUE + lane] + t[L_SLOPE + lane] * (now + 0.5 * h - t[L_MIDDLE + lane])
        u = side * (push - p[OFFSET] + t[L_HIDDEN + lane])
        half = -0.5 * h * inverse * grade
        share = 1.0 / max(1.0 - half, 0.5)
        c = h * inverse * share
        after = speed + h * (u - force) * inverse * share
        missing = max(LEAST_SPEED - after, 0.0)
        after += missing
        growth = min((1.0 + half) * share, 3.0)
        b = 0.5 * h * (1.0 + growth)
        q = t[L_DIFFUSION + lane] * h
        t[L_ANGLE + lane] += side * h * 0.5 * (speed + after)
        t[L_OMEGA + lane] = side * after
        t[L_P11 + lane] = p11 + (2.0 * b * p12 + b * b * p22 + q * h * h / 3.0)
        t[L_P12 + lane] = growth * (p12 + b * p22) + 0.5 * q * h
        t[L_P22 + lane] = growth * growth * p22 + q + missing * missing
        t[L_NOW + lane] = now + h
        t[L_B + lane], t[L_C + lane], t[L_GROWTH + lane] = b, c, growth


@inlined
def _predicted_hidden(t: Array, wide: int, number: float) -> None:
    """Add the effect of the correlated torque noise to the covariances of all lanes, after
    :func:`_predicted`.
    """
    for lane in range(wide):
        h = t[L_LENGTH + lane] if number < t[L_STEPS + lane] else 0.0
        b, c, growth = t[L_B + lane], t[L_C + lane], t[L_GROWTH + lane]
        p13, p23, p33 = t[L_P13 + lane], t[L_P23 + lane], t[L_P33 + lane]
        a = 0.5 * h * c
        along = p13 + b * p23 + a * p33
        t[L_P11 + lane] += 2.0 * a * (p13 + b * p23) + a * a * p33
        t[L_P12 + lane] += growth * a * p23 + c * along
        t[L_P22 + lane] += c * (2.0 * growth * p23 + c * p33)
        t[L_P13 + lane] = along
        t[L_P23 + lane] = growth * p23 + c * p33


@compiled
def predict(t: Array, wide: int, number: int, p: Array, correlated: bool) -> None:
    """Propagate the state of the first ``wide`` lanes over one integration step (M16, M17).

    Args:
        t: Workspace of the lanes, shape (WORKSPACE,).
        wide: Number of lanes.
        number: Number of the step in the period.
        p: Vector of :mod:`identification.model.parameters`.
        correlated: Whether the torque noise has a correlated part.
    """
    if p[ALPHA] == 2.0:
        _predicted(t, wide, float(number), law(p, 2.0))
    else:
        _predicted(t, wide, float(number), law(p, p[ALPHA]))
    if correlated:
        _predicted_hidden(t, wide, float(number))


@compiled
def compare(t: Array, wide: int) -> None:
    """Compute innovation and variance of the innovation of the first ``wide`` lanes (M18)."""
    for lane in range(wide):
        t[L_ERROR + lane] = t[L_ANSWER + lane] - t[L_ANGLE + lane]
        t[L_VARIANCE + lane] = t[L_P11 + lane] + t[L_READING_NOISE + lane]


@inlined
def _corrected(t: Array, wide: int) -> None:
    """Correct the states of all lanes by readings of the angle (M19); the speed keeps its sign.

    The reading is weighted with the share of the period that lies after the breakaway, so that the
    result is a smooth function of the breakaway time. At rest this share is zero, and a reading
    corrects the angle alone (M20). One part of the error of a reading is equal in all readings at
    rest; more readings reduce the variance of the remaining part only.
    """
    for lane in range(wide):
        error, variance, side = t[L_ERROR + lane], t[L_VARIANCE + lane], t[L_SIDE + lane]
        p11, p12, new = t[L_P11 + lane], t[L_P12 + lane], t[L_SHARE + lane]
        g1, g2 = p11 / variance, p12 / variance
        less = new * (2.0 - new)
        omega = t[L_OMEGA + lane] + new * g2 * error
        missing = max(LEAST_SPEED - side * omega, 0.0)
        kept = 1.0 - less * g1
        staying = t[L_STAYING + lane]
        unknown = p11 - staying
        gain = unknown / (unknown + t[L_READING_NOISE + lane] - staying)
        gain = gain if unknown > 0.0 else 0.0
        gain = 0.0 if new > 0.0 else gain
        t[L_ANGLE + lane] += (gain if gain > 0.0 else new * g1) * error
        t[L_OMEGA + lane] = omega + side * missing
        t[L_P22 + lane] += missing * missing - less * g2 * p12 + t[L_UNSURE + lane]
        t[L_P11 + lane] = p11 * kept - gain * unknown
        t[L_P12 + lane] = p12 * kept


@inlined
def _corrected_hidden(t: Array, wide: int) -> None:
    """Correct the correlated torque noise of all lanes by readings of the angle, before
    :func:`_corrected`.
    """
    for lane in range(wide):
        variance, new = t[L_VARIANCE + lane], t[L_SHARE + lane]
        p12, p13 = t[L_P12 + lane], t[L_P13 + lane]
        g1, g3 = t[L_P11 + lane] / variance, p13 / variance
        less = new * (2.0 - new)
        t[L_HIDDEN + lane] += new * g3 * t[L_ERROR + lane]
        t[L_P33 + lane] -= less * g3 * p13
        t[L_P23 + lane] -= less * g3 * p12
        t[L_P13 + lane] = p13 * (1.0 - less * g1)


@compiled
def correct(t: Array, wide: int, correlated: bool) -> None:
    """Correct the states of the first ``wide`` lanes by readings of the angle (M19, M20)."""
    if correlated:
        _corrected_hidden(t, wide)
    _corrected(t, wide)


@compiled
def innovations(
    segments: Array, begins: Array, samples: Array, noise: Array, p: Array, found: Array
) -> None:
    """Fill ``found`` with the innovations of every segment and their standard deviations (M18).

    Args:
        segments: Table of motion segments, the longest first, shape (m, 7); columns of
            :mod:`identification.filter.segment_table`.
        begins: Breakaway time of each segment, s, shape (m,).
        samples: Table of samples, shape (n, 8). The number of integration steps does not depend on
            the parameters, so that the innovations are smooth functions of the parameters.
        noise: Noise vector of :mod:`identification.filter.lanes`, shape (4,).
        p: Vector of :mod:`identification.model.parameters`.
        found: Rows ``ERROR`` to ``FILTERED``, shape (3, n). Samples outside the segments stay
            unchanged; so does the row ``FILTERED`` if the torque noise has no correlated part.
    """
    lanes = np.zeros(WORKSPACE)
    correlated = noise[CORRELATED] > 0.0
    for begin in range(0, len(segments), LANES):
        group, times = segments[begin : begin + LANES], begins[begin : begin + LANES]
        started(group, samples, noise, p, lanes)
        active = len(group)
        for k in range(int(group[0, LAST] - group[0, FIRST])):
            active = still_active(group, active, k)
            wide = whole(active)
            for number in range(loaded(group, times, samples, k, active, noise, lanes)):
                predict(lanes, wide, number, p, correlated)
            compare(lanes, wide)
            for lane in range(active):
                row = int(group[lane, FIRST]) + k
                found[ERROR, row] = lanes[L_ERROR + lane]
                found[DEVIATION, row] = math.sqrt(lanes[L_VARIANCE + lane])
            correct(lanes, wide, correlated)
            if correlated:
                for lane in range(active):
                    found[FILTERED, int(group[lane, FIRST]) + k] = lanes[L_HIDDEN + lane]
