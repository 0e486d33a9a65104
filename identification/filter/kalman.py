"""Computes the one-step prediction errors of the angle by an extended Kalman filter with the
measured torque as input (M14-M21).

The measured torque is a noisy mean over each period, and the encoder is quantised. The output error
drifts with the torque noise, and the equation error differentiates the encoder signal; the one-step
prediction error of the joint angle has neither drawback. The filter has the state (angle, speed),
with J domega/dt = torque - friction(omega) + noise and y = angle + noise. A correlated part of the
torque noise is a third state, a first-order process that is constant within each period. The
normalised innovations are white when the model is right, and their sum of squares is the likelihood
(Ljung, System Identification, 2nd ed., 7.3 and 10.5).

A motion segment that starts from rest starts at its breakaway time, at the angle of rest and with
speed zero. Repeated readings at rest do not reduce the error of the angle below the quantisation
error.
"""

from __future__ import annotations

import math

from identification.filter.segment_table import DIRECTION, FIRST, LAST, TORQUE_RATE
from identification.model.friction import expected_friction
from identification.model.parameters import INERTIA, OFFSET
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled, inlined

# Indices of the noise vector: white torque noise, N m rms; angle noise, rad^2; correlated torque
# noise, N m rms; its correlation time, s; part of the angle noise that is the same in all readings
# at rest, rad^2.
WHITE, ANGLE, CORRELATED, CORRELATION_TIME, STAYING = range(5)

LEAST_SPEED = 1e-7
_SLIP = 0.7
"""Mean square difference between a random walk that is reflected at zero and a free random walk,
under a drift that rises through zero, in natural units (M21); a test simulates this constant.
"""


State = tuple[float, float, float, float, float, float, float, float, float]
"""Angle, speed, and their covariance: variance of the angle, covariance, variance of the speed.

The further elements are the correlated torque noise, its covariances with angle and speed, and its
variance; all of them are zero without correlated noise.
"""


@inlined
def _predict(
    state: State,
    start: float,
    stop: float,
    middle: float,
    torque: float,
    slope: float,
    moment: float,
    inertia: float,
    side: float,
    noise_rate: float,
    steps: float,
    p: Array,
) -> State:
    """Return the state propagated from ``start`` to ``stop`` (M16, M17).

    The speed follows the linearly implicit trapezoidal rule in ``steps`` steps.
    """
    angle, omega, p11, p12, p22, hidden, p13, p23, p33 = state
    h = (stop - start) / steps
    now, inverse = start, 1.0 / inertia
    for _ in range(int(steps)):
        speed = max(side * omega, LEAST_SPEED)
        force, grade = expected_friction(speed, p22, moment, p)
        u = side * (torque + slope * (now + 0.5 * h - middle) - p[OFFSET] + hidden)
        half = -0.5 * h * inverse * grade
        share = 1.0 / max(1.0 - half, 0.5)
        after = speed + h * (u - force) * inverse * share
        missing = max(LEAST_SPEED - after, 0.0)
        after += missing
        growth = min((1.0 + half) * share, 3.0)
        angle += side * h * 0.5 * (speed + after)
        omega = side * after
        b = 0.5 * h * (1.0 + growth)
        q = noise_rate * h
        p11 += 2.0 * b * p12 + b * b * p22 + q * h * h / 3.0
        p12 = growth * (p12 + b * p22) + 0.5 * q * h
        p22 = growth * growth * p22 + q + missing * missing
        if p33 > 0.0:
            c = h * inverse * share
            a = 0.5 * h * c
            along = p13 + b * p23 + a * p33
            p11 += 2.0 * a * (p13 + b * p23) + a * a * p33
            p12 += growth * a * p23 + c * along
            p22 += c * (2.0 * growth * p23 + c * p33)
            p13 = along
            p23 = growth * p23 + c * p33
        now += h
    return angle, omega, p11, p12, p22, hidden, p13, p23, p33


@inlined
def reading_at_rest(
    here: float, p11: float, error: float, angle_noise: float, staying: float
) -> tuple[float, float]:
    """Return the angle of rest and its variance after one more reading with this ``error`` (M20).

    An error of variance ``staying``, which is a part of ``angle_noise``, is the same in all
    readings at rest; further readings reduce only the remaining variance.
    """
    unknown = p11 - staying
    if unknown > 0.0:
        share = unknown / (unknown + angle_noise - staying)
        here += share * error
        p11 -= share * unknown
    return here, p11


@inlined
def corrected(
    state: State, error: float, variance: float, new: float, unsure: float, side: float
) -> State:
    """Return the state after a reading with this ``error`` and ``variance`` (M19); the speed keeps
    its sign ``side``.

    ``new`` is the share of the period since the breakaway; this share makes the result a smooth
    function of the breakaway time. ``unsure`` is added to the variance of the speed.
    """
    angle, omega, p11, p12, p22, hidden, p13, p23, p33 = state
    g1 = p11 / variance
    g2 = p12 / variance
    less = new * (2.0 - new)
    angle += new * g1 * error
    omega += new * g2 * error
    missing = max(LEAST_SPEED - side * omega, 0.0)
    omega += side * missing
    p22 += missing * missing - less * g2 * p12 + unsure
    if p33 > 0.0:
        g3 = p13 / variance
        hidden += new * g3 * error
        p33 -= less * g3 * p13
        p23 -= less * g3 * p12
        p13 *= 1.0 - less * g1
    return (
        angle,
        omega,
        p11 * (1.0 - less * g1),
        p12 * (1.0 - less * g1),
        p22,
        hidden,
        p13,
        p23,
        p33,
    )


@compiled
def slip_variance(noise: float, period: float, rise: float, inertia: float) -> float:
    """Return the mean square speed that noise causes before the mean torque reaches the static
    limit, (rad/s)^2 (M21).

    At rest friction balances every backward torque, so that noise moves the joint forward only. The
    speed of the joint is a random walk that is reflected at zero, under the drift ``rise`` t /
    ``inertia`` (``rise`` in N m/s), which passes zero when the torque reaches the static limit.
    Walk and drift are of equal size after the time (noise^2 period / rise^2)^(1/3).
    """
    diffusion = noise * noise * period
    alike = math.pow(diffusion / (rise * rise), 1.0 / 3.0)
    return _SLIP * diffusion * alike / (inertia * inertia)


@compiled
def innovations(
    segments: Array,
    breakaway_times: Array,
    time: Array,
    angle: Array,
    torque: Array,
    slope: Array,
    moment: Array,
    extra_inertia: float,
    noise: Array,
    steps: Array,
    unsure: Array,
    p: Array,
    out: Array,
    spread: Array,
    speeds: Array,
    hiddens: Array,
) -> None:
    """Fill ``out`` with the innovations of every segment, ``spread`` with their standard deviations
    (M18), and ``speeds`` and ``hiddens`` with the filtered states.

    Args:
        segments: Table of motion segments, shape (m, 4); columns of
        :mod:`identification.filter.segment_table`.
        breakaway_times: Breakaway time of each segment, s, shape (m,).
        time: s, shape (n,).
        angle: Joint angle, rad, shape (n,).
        torque: Mean torque over the period that ends at each sample, N m, shape (n,).
        slope: Rate of change of the torque within that period, N m/s, shape (n,).
        moment: F_P L1, N m, shape (n,).
        extra_inertia: Known inertia added to J, kg m^2.
        noise: Noise vector with indices ``WHITE`` to ``STAYING``, shape (5,). The torque noise
            enters the speed divided by the trial inertia: the true torque is unknown, and using the
            measured torque as exact would bias J.
        steps: Integration steps in the period that ends at each sample, shape (n,). Their number
            does not depend on the parameters, so that the innovations are smooth functions of the
            parameters.
        unsure: Variance that is added to the variance of the speed at each sample, (rad/s)^2, shape
            (n,).
        p: Vector of :mod:`identification.model.parameters`.
        out: Innovations, rad, shape (n,); samples outside segments are left unchanged.
        spread: Standard deviations of the innovations, rad, shape (n,).
        speeds: Filtered speed, rad/s, shape (n,).
        hiddens: Filtered correlated torque noise, N m, shape (n,); left unchanged if the noise has
            no correlated part.
    """
    inertia = p[INERTIA] + extra_inertia
    correlated = noise[CORRELATED] > 0.0
    for j in range(len(segments)):
        first = int(segments[j, FIRST])
        last = int(segments[j, LAST])
        side = float(segments[j, DIRECTION])
        if segments[j, TORQUE_RATE] > 0:
            begin = breakaway_times[j]
            omega = side * LEAST_SPEED
            p22 = slip_variance(
                noise[WHITE], time[first] - time[first - 1], segments[j, TORQUE_RATE], inertia
            )
        else:
            begin = time[first - 1]
            omega = speeds[first - 1]
            p22 = omega * omega
        here, p11, p12 = angle[first - 1], noise[ANGLE], 0.0
        hidden, p13, p23, p33 = 0.0, 0.0, 0.0, noise[CORRELATED] * noise[CORRELATED]
        for k in range(first, last):
            start = max(begin, time[k - 1])
            if start < time[k]:
                period = time[k] - time[k - 1]
                rate = noise[WHITE] * noise[WHITE] * period / (inertia * inertia)
                middle = 0.5 * (time[k] + time[k - 1])
                if correlated:
                    kept = math.exp(-period / noise[CORRELATION_TIME])
                    hidden, p13, p23 = kept * hidden, kept * p13, kept * p23
                    p33 = (
                        kept * kept * p33
                        + (1.0 - kept * kept) * noise[CORRELATED] * noise[CORRELATED]
                    )
                here, omega, p11, p12, p22, hidden, p13, p23, p33 = _predict(
                    (here, omega, p11, p12, p22, hidden, p13, p23, p33),
                    start,
                    time[k],
                    middle,
                    torque[k],
                    slope[k],
                    moment[k],
                    inertia,
                    side,
                    rate,
                    steps[k],
                    p,
                )
            variance = p11 + noise[ANGLE]
            error = angle[k] - here
            out[k] = error
            spread[k] = math.sqrt(variance)
            if start >= time[k]:
                here, p11 = reading_at_rest(here, p11, error, noise[ANGLE], noise[STAYING])
                speeds[k] = omega
                continue
            here, omega, p11, p12, p22, hidden, p13, p23, p33 = corrected(
                (here, omega, p11, p12, p22, hidden, p13, p23, p33),
                error,
                variance,
                (time[k] - start) / (time[k] - time[k - 1]),
                unsure[k],
                side,
            )
            speeds[k] = omega
            if correlated:
                hiddens[k] = hidden
