"""Derivatives of the Kalman filter's innovations and their deviations, by forward differentiation.

The derivatives are with respect to parameters and breakaway times. Forward differentiation of M16
to M21 computes the derivatives.

The recursion of :mod:`identification.filter.kalman` is differentiated step by step (Griewank and
Walther, Evaluating Derivatives, 2nd ed., 3.1). All directions use the exponentials and divisions of
one pass, so that a pass with ten directions takes as long as about three passes without
derivatives.
"""

from __future__ import annotations

import math

from identification.filter.kalman import (
    ANGLE,
    CORRELATED,
    CORRELATION_TIME,
    LEAST_SPEED,
    STAYING,
    WHITE,
    reading_at_rest,
    slip_variance,
)
from identification.filter.segment_table import DIRECTION, FIRST, LAST, TORQUE_RATE
from identification.filter.tangents import begun, correct, forgotten, predict, slopes_of_reading
from identification.model.parameters import INERTIA
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled

Samples = tuple[Array, Array, Array, Array, Array, Array, Array]


@compiled
def sensitivities(
    segments: Array,
    breakaway_times: Array,
    samples: Samples,
    extra_inertia: float,
    noise: Array,
    p: Array,
    tangents: Array,
    errors: Array,
    deviations: Array,
) -> None:
    """Fill ``errors`` with the derivatives of the innovations of every segment, and ``deviations``
    with the derivatives of the logarithms of their standard deviations.

    Args:
        segments: Table of motion segments, as for :func:`identification.filter.kalman.innovations`.
        breakaway_times: Breakaway time of each segment, s, shape (m,).
        samples: Time, angle, torque, slope, moment, steps and unsure of every sample, shape (n,)
            each, as for :func:`identification.filter.kalman.innovations`.
        extra_inertia: Known inertia added to J, kg m^2.
        noise: Noise vector, shape (5,), which is constant.
        p: Vector of :mod:`identification.model.parameters`.
        tangents: Tangents and seeds of d directions, from
            :func:`identification.filter.tangents.seeded`.
        errors: Derivatives of the innovations, rad per unit of the direction, shape (n, d); samples
            outside segments are left unchanged.
        deviations: Derivatives of the logarithms of the deviations, per unit of the direction,
            shape (n, d).
    """
    time, angle, torque, slope, moment, steps, unsure = samples
    inertia = p[INERTIA] + extra_inertia
    correlated = noise[CORRELATED] > 0.0
    ended, omega = -1, 0.0
    for j in range(len(segments)):
        first, last = int(segments[j, FIRST]), int(segments[j, LAST])
        side = float(segments[j, DIRECTION])
        here, p11, p12 = angle[first - 1], noise[ANGLE], 0.0
        hidden, p13, p23, p33 = 0.0, 0.0, 0.0, noise[CORRELATED] * noise[CORRELATED]
        if segments[j, TORQUE_RATE] > 0:
            begin = breakaway_times[j]
            omega = side * LEAST_SPEED
            period = time[first] - time[first - 1]
            p22 = slip_variance(noise[WHITE], period, segments[j, TORQUE_RATE], inertia)
            begun(tangents, -2.0 * p22 / inertia, 0.0, False)
        else:
            begin = time[first - 1]
            omega = omega if ended == first else 0.0
            p22 = omega * omega
            begun(tangents, 0.0, omega, ended == first)
        for k in range(first, last):
            start = max(begin, time[k - 1])
            if start >= time[k]:
                errors[k, :], deviations[k, :] = 0.0, 0.0
                error = angle[k] - here
                here, p11 = reading_at_rest(here, p11, error, noise[ANGLE], noise[STAYING])
                continue
            period = time[k] - time[k - 1]
            if correlated:
                kept = math.exp(-period / noise[CORRELATION_TIME])
                hidden, p13, p23 = kept * hidden, kept * p13, kept * p23
                p33 = kept * kept * p33 + (1.0 - kept * kept) * noise[CORRELATED] ** 2
                forgotten(tangents, kept)
            moved = 1.0 if begin > time[k - 1] else 0.0
            h = (time[k] - start) / steps[k]
            state = (here, omega, p11, p12, p22, hidden, p13, p23, p33)
            rate = noise[WHITE] * noise[WHITE] * period / (inertia * inertia)
            drive = (torque[k], slope[k], moment[k], inertia, side, rate)
            centre = start + 0.5 * h - 0.5 * (time[k] + time[k - 1])
            for i in range(int(steps[k])):
                left = moved * (1.0 - (i + 0.5) / steps[k])
                times = (h, centre + i * h, -moved / steps[k], left)
                state = predict(state, tangents, times, drive, p)
            variance = state[2] + noise[ANGLE]
            slopes_of_reading(tangents, variance, errors[k], deviations[k])
            news = ((time[k] - start) / period, -moved / period)
            here, omega, p11, p12, p22, hidden, p13, p23, p33 = correct(
                state, tangents, angle[k] - state[0], variance, news, unsure[k], side
            )
        ended = last
