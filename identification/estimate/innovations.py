"""One-step prediction errors of the joint angle: an extended Kalman filter driven by the measured torque.

The measured torque is a noisy mean over each period and the encoder is quantised, so neither an output error (which
drifts with the torque noise) nor an equation error (which differentiates the encoder) is the right residual. The filter
carries both: x = (angle, speed), J domega/dt = torque - friction(omega) + noise, y = angle + noise. Its normalised
innovations are white when the model is right, and their sum of squares is the likelihood (Ljung, System
Identification, 2nd ed., 7.3 and 10.5).

A stretch of motion that begins at rest starts from the state that is known then, angle of rest and speed zero, at the
moment when the torque passes the static limit.
"""

from __future__ import annotations

import math

from identification.compiled import compiled
from identification.recording import Array

# Parameter vector of one evaluation.
MC, DM, OMEGA_SF, SIGMA_2, INERTIA, MU_C, DMU, OMEGA_SL, MU_2, OFFSET, PARAMETERS = range(11)
# Columns of the stretch table. The last is how fast the torque rises before the breakaway, N m/s; zero where the
# stretch does not begin at rest.
FIRST, LAST, SIDE, RISE = range(4)

_LEAST_SPEED = 1e-7
_SLIP = 0.7
"""Mean square by which a speed held at zero or above comes to exceed one that is not, under a drift that rises through
zero; in the unit that both have (simulated in the tests)."""


@compiled
def _shift(speed: float, variance: float, omega_s: float, part: float, power: float, alpha: float) -> float:
    """Return half the curvature of the falling ``part`` of friction times the speed's variance, N m.

    ``power`` is alpha (speed/omega_s)^alpha. Beyond a deviation of omega_s the expansion says nothing, and is held.
    """
    return 0.5 * min(variance, omega_s * omega_s) / (speed * speed) * part * power * (power - alpha + 1.0)


@compiled
def _friction(speed: float, moment: float, alpha: float, variance: float, p: Array) -> tuple[float, float]:
    """Return the expected friction magnitude (N m) and its slope at ``speed`` > 0: eq. 9 plus eq. 13.

    To second order in a speed of that ``variance``: near rest friction is curved enough for the speed's own uncertainty
    to shift its mean, and with it the static limits.
    """
    ratio = speed / p[OMEGA_SF]
    x = ratio * ratio if alpha == 2.0 else ratio**alpha
    part = p[DM] * math.exp(-x)
    value = p[MC] + p[SIGMA_2] * speed + part
    slope = p[SIGMA_2] - part * alpha * x / speed
    value += _shift(speed, variance, p[OMEGA_SF], part, alpha * x, alpha)
    if moment > 0.0:
        ratio = speed / p[OMEGA_SL]
        x = ratio * ratio if alpha == 2.0 else ratio**alpha
        part = moment * p[DMU] * math.exp(-x)
        value += moment * (p[MU_C] + p[MU_2] * speed) + part
        slope += moment * p[MU_2] - part * alpha * x / speed
        value += _shift(speed, variance, p[OMEGA_SL], part, alpha * x, alpha)
    return value, slope


@compiled
def _predict(
    state: list[float],
    start: float,
    stop: float,
    middle: float,
    torque: float,
    slope: float,
    moment: float,
    inertia: float,
    side: float,
    alpha: float,
    noise_rate: float,
    steps: float,
    p: Array,
) -> None:
    """Propagate (angle, speed, covariance) from ``start`` to ``stop`` in place.

    Speed by the linearly implicit trapezoidal rule in ``steps`` steps.
    """
    h = (stop - start) / steps
    now = start
    for _ in range(int(steps)):
        speed = max(side * state[1], _LEAST_SPEED)
        force, grade = _friction(speed, moment, alpha, state[4], p)
        u = side * (torque + slope * (now + 0.5 * h - middle) - p[OFFSET])
        rate = (u - force) / inertia
        gain = -grade / inertia
        nearer = 1.0 - 0.5 * h * gain
        if nearer < 0.5:
            nearer = 0.5
        change = h * rate / nearer
        after = speed + change
        missing = max(_LEAST_SPEED - after, 0.0)
        after += missing
        growth = min((1.0 + 0.5 * h * gain) / nearer, 3.0)
        state[0] += side * h * 0.5 * (speed + after)
        state[1] = side * after
        b = 0.5 * h * (1.0 + growth)
        p11, p12, p22 = state[2], state[3], state[4]
        q = noise_rate * h
        state[2] = p11 + 2.0 * b * p12 + b * b * p22 + q * h * h / 3.0
        state[3] = growth * (p12 + b * p22) + 0.5 * q * h
        state[4] = growth * growth * p22 + q + missing * missing
        now += h


@compiled
def _slip_variance(noise: float, period: float, rise: float, inertia: float) -> float:
    """Return the mean square speed that noise gives before the mean torque reaches the static limit, (rad/s)^2.

    At rest friction holds whatever would turn the shaft back, so that noise pushes it forward only: a random walk held
    at zero from below, whose drift ``rise`` t / ``inertia`` grows through zero as the torque (N m, at ``rise`` N m/s)
    passes the limit. Walk and drift are alike over the time (noise^2 period / rise^2)^(1/3).
    """
    diffusion = noise * noise * period
    alike = math.pow(diffusion / (rise * rise), 1.0 / 3.0)
    return _SLIP * diffusion * alike / (inertia * inertia)


@compiled
def innovations(
    stretches: Array,
    begins: Array,
    time: Array,
    angle: Array,
    torque: Array,
    slope: Array,
    moment: Array,
    extra_inertia: float,
    alpha: float,
    noise: Array,
    steps: Array,
    unsure: Array,
    p: Array,
    out: Array,
    spread: Array,
    speeds: Array,
) -> None:
    """Fill ``out`` with the innovations of every stretch, ``spread`` with their deviations, ``speeds`` with the speed.

    Args:
        stretches: Table of stretches of motion, shape (m, 4).
        begins: When each stretch that starts from rest breaks away, s, shape (m,).
        time: s, shape (n,).
        angle: Joint angle, rad, shape (n,).
        torque: Mean torque over the period that ends at each sample, N m, shape (n,).
        slope: Its slope within that period, N m/s, shape (n,).
        moment: F_P L1, N m, shape (n,).
        extra_inertia: Known inertia added to J, kg m^2.
        alpha: Stribeck exponent.
        noise: (torque noise rms N m, angle noise variance rad^2). The torque noise stands over the inertia on trial:
            the true torque is then an unknown of the fit, not the measured one taken for true, which would bias J.
        steps: Integration steps in the period that ends at each sample, shape (n,); fixed beforehand, so that the
            innovations are smooth in the parameters.
        unsure: Variance that the speed gains at each sample, as the shaft all but stops there, (rad/s)^2, shape (n,).
        p: Parameters, shape (10,).
        out: Innovations, rad, shape (n,); samples outside stretches are left alone.
        spread: Their standard deviations, rad, shape (n,).
        speeds: Filtered speed, rad/s, shape (n,).
    """
    state = [0.0, 0.0, 0.0, 0.0, 0.0]
    inertia = p[INERTIA] + extra_inertia
    for j in range(len(stretches)):
        first = int(stretches[j, FIRST])
        last = int(stretches[j, LAST])
        side = float(stretches[j, SIDE])
        if stretches[j, RISE] > 0:
            begin = begins[j]
            state[0] = angle[first - 1]
            state[1] = side * _LEAST_SPEED
            state[2] = noise[1]
            state[3] = 0.0
            state[4] = _slip_variance(noise[0], time[first] - time[first - 1], stretches[j, RISE], inertia)
        else:
            begin = time[first - 1]
            state[0] = angle[first - 1]
            state[1] = speeds[first - 1]
            state[2] = noise[1]
            state[3] = 0.0
            state[4] = state[1] * state[1]
        for k in range(first, last):
            start = max(begin, time[k - 1])
            if start < time[k]:
                period = time[k] - time[k - 1]
                rate = noise[0] * noise[0] * period / (inertia * inertia)
                middle = 0.5 * (time[k] + time[k - 1])
                _predict(
                    state,
                    start,
                    time[k],
                    middle,
                    torque[k],
                    slope[k],
                    moment[k],
                    inertia,
                    side,
                    alpha,
                    rate,
                    steps[k],
                    p,
                )
            variance = state[2] + noise[1]
            error = angle[k] - state[0]
            out[k] = error
            spread[k] = math.sqrt(variance)
            g1 = state[2] / variance
            g2 = state[3] / variance
            state[0] += g1 * error
            state[1] += g2 * error
            missing = max(_LEAST_SPEED - side * state[1], 0.0)
            state[1] += side * missing
            state[4] += missing * missing - g2 * state[3] + unsure[k]
            state[3] *= 1.0 - g1
            state[2] *= 1.0 - g1
            speeds[k] = state[1]
