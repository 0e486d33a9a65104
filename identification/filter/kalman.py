"""Computes the one-step prediction errors of the angle by an extended Kalman filter with the
measured torque as input (docs/method.md, M14-M21).

The state is (angle, speed) and, with a correlated part of the torque noise, that part, constant
within each period. The normalised innovations are white when the model is right, and their sum of
squares is the likelihood (Ljung, System Identification, 2nd ed., 7.3 and 10.5). A motion segment
starts at its breakaway time, at the angle of rest and with speed zero. Segments run side by side.
"""

from __future__ import annotations

import math

import numpy as np

from identification.model.friction import Law, expected_friction, friction_slopes, law
from identification.model.parameters import (
    ALPHA,
    INERTIA,
    LOAD_RISE,
    MC,
    MU_2,
    MU_C,
    OFFSET,
    OMEGA_SF,
    OMEGA_SL,
    SIGMA_2,
    SYSTEM_RISE,
)
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled, inlined

FIRST, LAST, DIRECTION, TORQUE_RATE = range(4)
"""Columns of the table of motion segments: first sample, sample after the last, direction of motion
(1 or -1), and rate of rise of the torque before the breakaway, N m/s, greater than zero.
"""
REST, EXTRA_INERTIA, QUANTISATION = range(4, 7)
"""Further columns of the table of an experiment: angle of the reading before the first sample, rad;
known inertia added to J, kg m^2; variance of the quantisation error of the angle, rad^2.
"""
TIME, BEFORE, ANGLE, TORQUE, SLOPE, MOMENT, STEPS, UNSURE = range(8)
"""Columns of the table of samples: time of the sample and of the one before it, s; angle, rad; mean
torque over the period between them, N m, and its rate of change, N m/s; mean contact moment F_P L1,
N m; number of integration steps; variance that is added to the variance of the speed, (rad/s)^2.
"""
SAMPLE_COLUMNS = UNSURE + 1


LANES = 32  # length of a row: the greatest number of segments that are computed side by side
AT_ONCE = 8  # lanes of the widest processor instruction; loops run over a multiple of them
L_ANGLE, L_OMEGA, L_P11, L_P12, L_P22, L_HIDDEN, L_P13, L_P23, L_P33 = (LANES * k for k in range(9))
"""Places of the state: angle, rad, and speed, rad/s; their covariance; the correlated torque noise,
N m, its covariances with angle and speed, and its variance.
"""
L_SIDE, L_INVERSE, L_READING_NOISE, L_STAYING = (LANES * k for k in range(9, 13))
"""Places of the segment: direction; inverse of the inertia; variance of the error of an angle
reading; and the part of this variance whose error is equal in all readings at rest.
"""
L_LENGTH, L_STEPS, L_NOW, L_MIDDLE, L_TORQUE, L_SLOPE, L_MOMENT, L_DIFFUSION = (
    LANES * k for k in range(13, 21)
)
"""Places of the sample period: length and number of the integration steps; start of the next
integration step; middle of the period; torque, rate of change of the torque, and contact moment;
growth of the variance of the speed.
"""
L_MOVED, L_SHARE, L_ANSWER, L_UNSURE, L_ERROR, L_VARIANCE = (LANES * k for k in range(21, 27))
"""Places of the reading: whether the breakaway is within the period; share of the period after the
breakaway; measured angle; variance that is added to the variance of the speed; innovation; variance
of the innovation.
"""
L_B, L_C, L_GROWTH = (LANES * k for k in range(27, 30))
"""Places of the values b, c and growth of one integration step, for the correlated torque noise."""
WORKSPACE = 30 * LANES

WHITE, ANGLE_NOISE, CORRELATED, CORRELATION_TIME = range(4)
"""Indices of the noise vector: white torque noise, N m rms; noise of the angle beyond quantisation,
rad rms; correlated torque noise, N m rms; correlation time of the latter, s.
"""
LEAST_SPEED = 1e-7
_SLIP = 0.7
"""Mean square difference between a random walk that is reflected at zero and a free random walk,
under a drift that rises through zero, in natural units (M21); a test simulates this constant.
"""
_FORGOTTEN = math.pi**2 / 3.0
"""Exponent of the share of the quantisation error that is the same in all readings despite noise of
the angle (M20). Averaged over noise of variance v, the first harmonic of the quantisation error
falls by exp(-(2 pi)^2 v / (12 q)), where q is a twelfth of the squared encoder step (Widrow, IRE
Trans. Circuit Theory 3 (1956) 266).
"""


@compiled
def slip_variance(noise: float, period: float, rise: float, inertia: float) -> float:
    """Return the mean square speed that noise causes before the mean torque reaches the static
    limit, (rad/s)^2 (M21).

    At rest friction balances every backward torque, so that noise moves the joint forward only. The
    speed of the joint is a random walk that is reflected at zero, with the drift rate ``rise`` t /
    ``inertia`` (``rise`` in N m/s). The time t is zero when the mean torque reaches the static
    limit. Random walk and drift are of equal size after the time (noise^2 period / rise^2)^(1/3).
    """
    diffusion = noise * noise * period
    alike = math.pow(diffusion / (rise * rise), 1.0 / 3.0)
    return _SLIP * diffusion * alike / (inertia * inertia)


@inlined
def whole(active: int) -> int:
    """Return ``active`` rounded up to the number of lanes that are computed."""
    return (active + AT_ONCE - 1) // AT_ONCE * AT_ONCE


@compiled
def started(segments: Array, samples: Array, noise: Array, p: Array, lanes: Array) -> None:
    """Start one segment in each lane at its angle of rest.

    The error of the angle at rest is at least the quantisation error, however many readings were
    taken.

    Args:
        segments: Segments of the lanes, shape (m, 7), at most ``LANES``; columns of
            :mod:`identification.filter.kalman`. The remaining lanes repeat the last segment.
        samples: Table of samples, shape (n, 8).
        noise: Noise vector with indices ``WHITE`` to ``CORRELATION_TIME``, shape (4,). The torque
            noise enters the speed divided by the trial inertia: the true torque is unknown, and
            using the measured torque as exact would bias J.
        p: Vector of :mod:`identification.model.parameters`.
        lanes: Workspace, shape (WORKSPACE,).
    """
    for lane in range(LANES):
        s = segments[min(lane, len(segments) - 1)]
        first = int(s[FIRST])
        inertia = p[INERTIA] + s[EXTRA_INERTIA]
        known = noise[ANGLE_NOISE] * noise[ANGLE_NOISE]
        lanes[L_SIDE + lane], lanes[L_INVERSE + lane] = s[DIRECTION], 1.0 / inertia
        lanes[L_READING_NOISE + lane] = s[QUANTISATION] + known
        lanes[L_STAYING + lane] = s[QUANTISATION] * math.exp(-_FORGOTTEN * known / s[QUANTISATION])
        lanes[L_ANGLE + lane], lanes[L_OMEGA + lane] = s[REST], s[DIRECTION] * LEAST_SPEED
        lanes[L_P11 + lane], lanes[L_P12 + lane] = s[QUANTISATION] + known, 0.0
        lanes[L_P22 + lane] = slip_variance(
            noise[WHITE], samples[first, TIME] - samples[first, BEFORE], s[TORQUE_RATE], inertia
        )
        lanes[L_HIDDEN + lane], lanes[L_P13 + lane], lanes[L_P23 + lane] = 0.0, 0.0, 0.0
        lanes[L_P33 + lane] = noise[CORRELATED] * noise[CORRELATED]


@inlined
def still_active(segments: Array, active: int, k: int) -> int:
    """Return how many of the first segments, longest first, have a sample number ``k``."""
    while active > 0 and k >= int(segments[active - 1, LAST] - segments[active - 1, FIRST]):
        active -= 1
    return active


@compiled
def loaded(
    segments: Array, begins: Array, samples: Array, k: int, active: int, noise: Array, lanes: Array
) -> int:
    """Load sample number ``k`` of each segment into its lane; return the greatest number of
    integration steps.

    Args:
        segments: Segments of the lanes.
        begins: Breakaway times, s, shape (m,).
        samples: Table of samples, shape (n, 8).
        k: Number of the sample in its segment, from zero.
        active: Number of lanes whose segment has a sample ``k``; all other lanes get integration
            steps of length zero.
        noise: Noise vector, shape (4,).
        lanes: Workspace, shape (WORKSPACE,).
    """
    most = 0.0
    for lane in range(active):
        s = samples[int(segments[lane, FIRST]) + k]
        time, before = s[TIME], s[BEFORE]
        start, period = max(begins[lane], before), time - before
        moving = start < time
        inverse = lanes[L_INVERSE + lane]
        steps = s[STEPS] if moving else 0.0
        lanes[L_STEPS + lane] = steps
        lanes[L_LENGTH + lane] = (time - start) / s[STEPS]
        lanes[L_NOW + lane], lanes[L_MIDDLE + lane] = start, 0.5 * (time + before)
        lanes[L_TORQUE + lane], lanes[L_SLOPE + lane] = s[TORQUE], s[SLOPE]
        lanes[L_MOMENT + lane] = max(s[MOMENT], 0.0)
        lanes[L_DIFFUSION + lane] = noise[WHITE] * noise[WHITE] * period * (inverse * inverse)
        lanes[L_MOVED + lane] = 1.0 / period if moving and begins[lane] > before else 0.0
        lanes[L_SHARE + lane] = (time - start) / period if moving else 0.0
        lanes[L_ANSWER + lane] = s[ANGLE]
        lanes[L_UNSURE + lane] = s[UNSURE] if moving else 0.0
        most = max(most, steps)
        if noise[CORRELATED] > 0.0 and moving:
            kept = math.exp(-period / noise[CORRELATION_TIME])
            fresh = (1.0 - kept * kept) * noise[CORRELATED] * noise[CORRELATED]
            lanes[L_HIDDEN + lane] *= kept
            lanes[L_P13 + lane] *= kept
            lanes[L_P23 + lane] *= kept
            lanes[L_P33 + lane] = kept * kept * lanes[L_P33 + lane] + fresh
    for lane in range(active, whole(active)):
        lanes[L_STEPS + lane], lanes[L_SHARE + lane], lanes[L_UNSURE + lane] = 0.0, 0.0, 0.0
    return int(most)


ERROR, DEVIATION, FILTERED = range(3)
"""Rows of the results: innovation, rad; its deviation, rad; correlated torque noise, N m."""


@inlined
def _predicted(t: Array, wide: int, number: float, p: Law) -> None:
    """Propagate all lanes over integration step ``number`` (M16, M17), linearly implicit."""
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
    """Add the correlated torque noise to the covariances, after :func:`_predicted`."""
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
    """Propagate the state of the first ``wide`` lanes over one integration step (M16, M17)."""
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
    """Correct the correlated torque noise of all lanes, before :func:`_corrected`."""
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

    ``segments``: table of motion segments, the longest first, shape (m, 7); columns of
    :mod:`identification.filter.kalman`. ``samples``: table of samples, shape (n, 8). The number of
    integration steps does not depend on the parameters, so that the innovations are smooth
    functions of the parameters. ``found``: rows ``ERROR`` to ``FILTERED``, shape (3, n). Samples
    outside the segments stay unchanged; so does the row ``FILTERED`` if the torque noise has no
    correlated part.
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


START = OFFSET + 1
"""Column of the directions for the breakaway time; the columns before are the parameters."""
SEEDS = START + 1  # number of columns of the directions
T_ANGLE, T_OMEGA, T_P11, T_P12, T_P22, T_HIDDEN, T_P13, T_P23, T_P33 = (LANES * k for k in range(9))
"""Places of the derivatives of the state in one direction."""
_T_DH, _T_DB, _T_DC, _T_DG = (LANES * k for k in range(9, 13))
"""Places of the derivatives of h, b, c and growth of one step, for the correlated noise."""
TANGENTS = 13 * LANES  # length of the array of one direction
_FRICTION = 15
_SLOW, _PUSH, _C, _HALF_J, _HALF_G, _C_J, _C_HALF, _GROWTH_HALF, _MOVING, _H, _PATH = (
    LANES * (_FRICTION + k) for k in range(11)
)
_H_START, _HALF_START, _C_START, _PUSH_START = (LANES * (_FRICTION + k) for k in range(11, 15))
_P11_B, _B, _GROWTH, _CENTRE, _TWICE, _Q, _MISSING, _Q_J, _Q_START = (
    LANES * (_FRICTION + k) for k in range(15, 24)
)
(
    _F_S, _F_V, _G_S, _F_DM, _F_OF, _F_S2, _G_DM, _G_OF, _F_MC, _F_DL, _F_OL, _F_M2, _G_DL, _G_OL,
    _G_M2,
) = (LANES * k for k in range(_FRICTION))  # fmt: skip
"""Places of the factors of one integration step, which are the same for all directions."""
GAINS = (_FRICTION + 24) * LANES

_MOST = 1e60
"""Greatest tangent after a sample. On the falling branch of friction the tangents of a joint that
sticks and slips may grow without bound; a tangent that overflows would make all later tangents
undefined.
"""


@inlined
def _factors(g: Array, t: Array, wide: int, number: float, p: Law) -> None:
    """Store the factors of the tangents of all lanes for integration step ``number`` (M16, M17)."""
    for lane in range(wide):
        speed = max(t[L_SIDE + lane] * t[L_OMEGA + lane], LEAST_SPEED)
        force, grade, slopes = friction_slopes(speed, t[L_P22 + lane], t[L_MOMENT + lane], p)
        g[_F_S + lane], g[_F_V + lane], g[_G_S + lane] = slopes[0], slopes[1], slopes[2]
        g[_F_DM + lane], g[_F_OF + lane], g[_F_S2 + lane] = slopes[3], slopes[4], slopes[5]
        g[_G_DM + lane], g[_G_OF + lane], g[_F_MC + lane] = slopes[6], slopes[7], slopes[8]
        g[_F_DL + lane], g[_F_OL + lane], g[_F_M2 + lane] = slopes[9], slopes[10], slopes[11]
        g[_G_DL + lane], g[_G_OL + lane], g[_G_M2 + lane] = slopes[12], slopes[13], slopes[14]
        side, inverse, steps = t[L_SIDE + lane], t[L_INVERSE + lane], t[L_STEPS + lane]
        p12, p22, taken = t[L_P12 + lane], t[L_P22 + lane], number < steps
        slope, period_moved = t[L_SLOPE + lane], 1.0 if t[L_MOVED + lane] > 0.0 else 0.0
        h = t[L_LENGTH + lane] if taken else 0.0
        h_start = -period_moved / steps if taken else 0.0
        centre_start = period_moved * (1.0 - (number + 0.5) / steps) if taken else 0.0
        push = t[L_TORQUE + lane] + slope * (t[L_NOW + lane] + 0.5 * h - t[L_MIDDLE + lane])
        push = side * (push - p[OFFSET] + t[L_HIDDEN + lane]) - force
        half = -0.5 * h * inverse * grade
        share = 1.0 / max(1.0 - half, 0.5)
        c = h * inverse * share
        after = speed + c * push
        missing = max(LEAST_SPEED - after, 0.0)
        after += missing
        growth = min((1.0 + half) * share, 3.0)
        b = 0.5 * h * (1.0 + growth)
        q = t[L_DIFFUSION + lane] * h
        centre = p12 + b * p22
        share_half = share * share if 1.0 - half > 0.5 else 0.0
        growing = 1.0 if (1.0 + half) * share < 3.0 else 0.0
        g[_SLOW + lane] = side if side * t[L_OMEGA + lane] > LEAST_SPEED else 0.0
        g[_MOVING + lane] = 0.0 if missing > 0.0 else 1.0
        g[_PUSH + lane], g[_C + lane], g[_H + lane], g[_PATH + lane] = push, c, h, speed + after
        g[_HALF_J + lane], g[_HALF_G + lane] = -half * inverse, -0.5 * h * inverse
        g[_C_J + lane], g[_C_HALF + lane] = -c * inverse, h * inverse * share_half
        g[_GROWTH_HALF + lane] = growing * (share + (1.0 + half) * share_half)
        g[_H_START + lane], g[_HALF_START + lane] = h_start, -0.5 * h_start * inverse * grade
        g[_C_START + lane] = h_start * inverse * share
        g[_PUSH_START + lane] = side * slope * centre_start
        g[_P11_B + lane], g[_B + lane], g[_GROWTH + lane] = 2.0 * centre, b, growth
        g[_CENTRE + lane], g[_TWICE + lane], g[_Q + lane] = centre, 2.0 * growth * p22, q
        g[_MISSING + lane], g[_Q_J + lane] = missing, -2.0 * q * inverse
        g[_Q_START + lane] = t[L_DIFFUSION + lane] * h_start


@compiled
def factors(g: Array, t: Array, wide: int, number: int, p: Array) -> None:
    """Store the factors of the tangents of the first ``wide`` lanes for one integration step."""
    if p[ALPHA] == 2.0:
        _factors(g, t, wide, float(number), law(p, 2.0))
    else:
        _factors(g, t, wide, float(number), law(p, p[ALPHA]))


@compiled
def step(d: Array, seed: Array, g: Array, t: Array, wide: int) -> None:
    """Propagate the tangents of angle, speed and their covariance in one direction over one
    integration step (M16, M17).

    ``d``: tangents of the direction, shape (TANGENTS,). ``seed``: the direction, shape (SEEDS,).
    ``g``: factors of the step, shape (GAINS,).
    """
    mc, rise, omega_sf, sigma_2 = seed[MC], seed[SYSTEM_RISE], seed[OMEGA_SF], seed[SIGMA_2]
    mu_c, load_rise, omega_sl, mu_2 = seed[MU_C], seed[LOAD_RISE], seed[OMEGA_SL], seed[MU_2]
    inertia, offset, start = seed[INERTIA], seed[OFFSET], seed[START]
    for k in range(wide):
        d12, d22, ds = d[T_P12 + k], d[T_P22 + k], g[_SLOW + k] * d[T_OMEGA + k]
        h, b, q, growth = g[_H + k], g[_B + k], g[_Q + k], g[_GROWTH + k]
        side, p22, centre = t[L_SIDE + k], t[L_P22 + k], g[_CENTRE + k]
        d_force = g[_F_S + k] * ds + g[_F_V + k] * d22 + mc
        d_force += g[_F_DM + k] * rise + g[_F_OF + k] * omega_sf + g[_F_S2 + k] * sigma_2
        d_force += g[_F_MC + k] * mu_c + g[_F_DL + k] * load_rise
        d_force += g[_F_OL + k] * omega_sl + g[_F_M2 + k] * mu_2
        d_grade = g[_G_S + k] * ds + g[_G_DM + k] * rise + g[_G_OF + k] * omega_sf + sigma_2
        d_grade += g[_G_DL + k] * load_rise + g[_G_OL + k] * omega_sl + g[_G_M2 + k] * mu_2
        d_push = g[_PUSH_START + k] * start + side * (d[T_HIDDEN + k] - offset) - d_force
        d_half = g[_HALF_START + k] * start + g[_HALF_J + k] * inertia + g[_HALF_G + k] * d_grade
        dc = g[_C_START + k] * start + g[_C_J + k] * inertia + g[_C_HALF + k] * d_half
        d_free = ds + g[_PUSH + k] * dc + g[_C + k] * d_push
        d_after = g[_MOVING + k] * d_free
        d_growth = g[_GROWTH_HALF + k] * d_half
        dh = g[_H_START + k] * start
        db = 0.5 * h * d_growth + 0.5 * (1.0 + growth) * dh
        dq = g[_Q_START + k] * start + g[_Q_J + k] * inertia
        d[T_ANGLE + k] += side * 0.5 * (dh * g[_PATH + k] + h * (ds + d_after))
        d[T_OMEGA + k] = side * d_after
        d[T_P11 + k] += (
            g[_P11_B + k] * db + 2.0 * b * d12 + b * b * d22 + (h * h * dq + 2.0 * q * h * dh) / 3.0
        )
        d[T_P12 + k] = (
            d_growth * centre + growth * (d12 + p22 * db + b * d22) + 0.5 * (h * dq + q * dh)
        )
        d[T_P22 + k] = (
            g[_TWICE + k] * d_growth
            + growth * growth * d22
            + dq
            - 2.0 * g[_MISSING + k] * (d_free - d_after)
        )
        d[_T_DH + k], d[_T_DB + k], d[_T_DC + k], d[_T_DG + k] = dh, db, dc, d_growth


@compiled
def step_hidden(d: Array, g: Array, t: Array, wide: int) -> None:
    """Propagate the tangents of the correlated noise over a step, after :func:`step`."""
    for k in range(wide):
        p13, p23, p33 = t[L_P13 + k], t[L_P23 + k], t[L_P33 + k]
        h, b, c, growth = g[_H + k], g[_B + k], g[_C + k], g[_GROWTH + k]
        a = 0.5 * h * c
        along = p13 + b * p23 + a * p33
        twice = 2.0 * growth * p23 + c * p33
        db, dc, d_growth = d[_T_DB + k], d[_T_DC + k], d[_T_DG + k]
        da = 0.5 * (d[_T_DH + k] * c + h * dc)
        d13, d23, d33 = d[T_P13 + k], d[T_P23 + k], d[T_P33 + k]
        d_along = d13 + db * p23 + b * d23 + da * p33 + a * d33
        d_twice = 2.0 * (d_growth * p23 + growth * d23) + dc * p33 + c * d33
        # p11 grows by 2 a (p13 + b p23) + a^2 p33 = a (2 along - a p33).
        d[T_P11 + k] += da * (2.0 * along - a * p33) + a * (2.0 * d_along - da * p33 - a * d33)
        d[T_P12 + k] += a * (d_growth * p23 + growth * d23) + growth * p23 * da
        d[T_P12 + k] += dc * along + c * d_along
        d[T_P22 + k] += dc * twice + c * d_twice
        d[T_P13 + k] = d_along
        d[T_P23 + k] = d_growth * p23 + growth * d23 + dc * p33 + c * d33


@compiled
def correct_tangents(d: Array, seed: Array, t: Array, wide: int) -> None:
    """Correct the tangents of one direction by a reading (M19), before the state is corrected."""
    start = seed[START]
    for k in range(wide):
        error, variance, side = t[L_ERROR + k], t[L_VARIANCE + k], t[L_SIDE + k]
        p12, p13, new = t[L_P12 + k], t[L_P13 + k], t[L_SHARE + k]
        inverse = 1.0 / variance
        g1, g2, g3 = t[L_P11 + k] * inverse, p12 * inverse, p13 * inverse
        less = new * (2.0 - new)
        kept = 1.0 - less * g1
        missing = max(LEAST_SPEED - side * (t[L_OMEGA + k] + new * g2 * error), 0.0)
        moving = 0.0 if missing > 0.0 else 1.0
        d_new = -t[L_MOVED + k] * start
        d_less = 2.0 * d_new * (1.0 - new)
        d11, d12, d13, d_error = d[T_P11 + k], d[T_P12 + k], d[T_P13 + k], -d[T_ANGLE + k]
        d1, d2, d3 = (
            (d11 - g1 * d11) * inverse,
            (d12 - g2 * d11) * inverse,
            (d13 - g3 * d11) * inverse,
        )
        d_kept = -d_less * g1 - less * d1
        d_free = d[T_OMEGA + k] + d_new * g2 * error + new * (d2 * error + g2 * d_error)
        d22 = 2.0 * missing * side * (1.0 - moving) * d_free
        d22 += d_less * g2 * p12 + less * (d2 * p12 + g2 * d12)
        hidden = d_new * g3 * error + new * (d3 * error + g3 * d_error)
        angle = d_new * g1 * error + new * (d1 * error + g1 * d_error)
        d[T_ANGLE + k] = _limited(d[T_ANGLE + k] + angle)
        d[T_OMEGA + k] = _limited(moving * d_free)
        d[T_P22 + k] = _limited(d[T_P22 + k] - d22)
        d[T_HIDDEN + k] = _limited(d[T_HIDDEN + k] + hidden)
        d33, d23 = d_less * g3 * p13 + less * (d3 * p13 + g3 * d13), d_less * g3 * p12
        d[T_P33 + k] = _limited(d[T_P33 + k] - d33)
        d[T_P23 + k] = _limited(d[T_P23 + k] - d23 - less * (d3 * p12 + g3 * d12))
        d[T_P13 + k] = _limited(d13 * kept + p13 * d_kept)
        d[T_P11 + k] = _limited(d11 * kept + t[L_P11 + k] * d_kept)
        d[T_P12 + k] = _limited(d12 * kept + p12 * d_kept)


@inlined
def _limited(tangent: float) -> float:
    return min(max(tangent, -_MOST), _MOST)


@compiled
def _started(tangents: Array, seeds: Array, lanes: Array) -> None:
    """Set the derivatives of the state at the start of a segment (M21)."""
    tangents[:] = 0.0
    for j in range(len(seeds)):
        for lane in range(LANES):
            by_inertia = -2.0 * lanes[L_P22 + lane] * lanes[L_INVERSE + lane]
            tangents[j, T_P22 + lane] = by_inertia * seeds[j, INERTIA]


@compiled
def _forgotten(tangents: Array, lanes: Array, lane: int, kept: float) -> None:
    """Multiply the derivatives of the correlated torque noise of a lane in motion by ``kept``."""
    if lanes[L_SHARE + lane] > 0.0:
        for d in tangents:
            d[T_HIDDEN + lane] *= kept
            d[T_P13 + lane] *= kept
            d[T_P23 + lane] *= kept
            d[T_P33 + lane] *= kept * kept


@compiled
def sensitivities(
    segments: Array,
    begins: Array,
    samples: Array,
    noise: Array,
    p: Array,
    seeds: Array,
    errors: Array,
    deviations: Array,
) -> None:
    """Fill ``errors`` with the derivatives of the innovations of every segment, and ``deviations``
    with the derivatives of the logarithms of their standard deviations.

    ``segments``: table of motion segments, the longest first, as for
    :func:`identification.filter.kalman.innovations`. ``noise``: noise vector, shape (4,), which is
    constant. ``seeds``: directions of differentiation, shape (d, SEEDS): derivative of each
    parameter, and in column ``START`` the derivative of all breakaway times. ``errors``:
    derivatives of the innovations, rad per unit of the direction, shape (n, d); samples outside the
    segments are left unchanged. ``deviations``: derivatives of the logarithms of the standard
    deviations, per unit of the direction, shape (n, d).
    """
    lanes, gains = np.zeros(WORKSPACE), np.zeros(GAINS)
    tangents = np.zeros((len(seeds), TANGENTS))
    correlated = noise[CORRELATED] > 0.0
    for begin in range(0, len(segments), LANES):
        group, times = segments[begin : begin + LANES], begins[begin : begin + LANES]
        started(group, samples, noise, p, lanes)
        _started(tangents, seeds, lanes)
        active = len(group)
        for k in range(int(group[0, LAST] - group[0, FIRST])):
            active = still_active(group, active, k)
            wide = whole(active)
            most = loaded(group, times, samples, k, active, noise, lanes)
            if correlated:
                for lane in range(active):
                    row = int(group[lane, FIRST]) + k
                    period = samples[row, TIME] - samples[row, BEFORE]
                    kept = np.exp(-period / noise[CORRELATION_TIME])
                    _forgotten(tangents, lanes, lane, kept)
            for number in range(most):
                factors(gains, lanes, wide, number, p)
                for j in range(len(seeds)):
                    step(tangents[j], seeds[j], gains, lanes, wide)
                    if correlated:
                        step_hidden(tangents[j], gains, lanes, wide)
                predict(lanes, wide, number, p, correlated)
            compare(lanes, wide)
            for j in range(len(seeds)):
                d = tangents[j]
                for lane in range(active):
                    row = int(group[lane, FIRST]) + k
                    errors[row, j] = -d[T_ANGLE + lane]
                    deviations[row, j] = 0.5 * d[T_P11 + lane] / lanes[L_VARIANCE + lane]
                correct_tangents(d, seeds[j], lanes, wide)
            correct(lanes, wide, correlated)
