"""Computes the derivatives (tangents) of one step and of one reading of the Kalman filter;
compiled.

A tangent is the derivative of the filter's state in one direction of the parameters or breakaway
times; several directions are computed together.
"""

from __future__ import annotations

import numpy as np

from identification.filter.kalman import LEAST_SPEED, State, corrected
from identification.model.friction_slopes import Slopes, friction_slopes
from identification.model.parameters import (
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

START = OFFSET + 1
"""Column of the seeds for the breakaway time; the columns before it are parameters."""
SEEDS = START + 1
"""Columns of the seeds."""
WIDTH = 8
"""Number of directions in one block; a constant, so that the compiler combines several directions
in one instruction.
"""
_ANGLE, _OMEGA, _P11, _P12, _P22, _HIDDEN, _P13, _P23, _P33 = (WIDTH * k for k in range(9))
"""First place of each derivative of the state in the flat array of tangents."""
_STATES = 9 * WIDTH
_MC, _RISE, _OMEGA_SF, _SIGMA_2, _INERTIA = (
    _STATES + WIDTH * k for k in (MC, SYSTEM_RISE, OMEGA_SF, SIGMA_2, INERTIA)
)
_MU_C, _LOAD_RISE, _OMEGA_SL, _MU_2, _OFFSET, _START = (
    _STATES + WIDTH * k for k in (MU_C, LOAD_RISE, OMEGA_SL, MU_2, OFFSET, START)
)
"""First places of the seeds in the same array; in one array the compiler knows that they do not
overlap.
"""
_DH, _DB, _DC, _DG = (_STATES + WIDTH * k for k in range(SEEDS, SEEDS + 4))
"""First places, in the same array, of the terms of the third state that depend on the first two
states.
"""
_SIZE = _STATES + (SEEDS + 4) * WIDTH

_MOST = 1e60
"""Greatest tangent after a sample. Where friction falls with speed, tangents of a joint that sticks
and slips may grow without bound, and a tangent that overflows would make all later tangents
undefined.
"""
Gains = tuple[float, ...]
Covariance = tuple[float, ...]


@compiled
def _step(t: Array, friction: Slopes, gains: Gains, covariance: Covariance) -> None:
    """Step the tangents of angle, speed and their covariance (M16, M17).

    Args:
        t: Tangents and seeds of one block, shape (_SIZE,).
        friction: Derivatives of friction and of its slope, from :func:`friction_slopes`.
        gains: Values of :func:`predict`.
        covariance: Values of :func:`predict`.
    """
    f_s, f_v, g_s, f_dm, f_of, f_s2, g_dm, g_of, f_mc, f_dl, f_ol, f_m2, g_dl, g_ol, g_m2 = friction
    slow, side, push, c, half_j, half_g, c_j, c_half, growth_half, moving, h, path = gains[:12]
    h_start, half_start, c_start, push_start = gains[12:]
    p11_b, b, p22, growth, middle, twice, q, missing, q_j, q_start, half_h = covariance
    for d in range(WIDTH):
        start, inertia = t[_START + d], t[_INERTIA + d]
        rise, omega_sf, sigma_2 = t[_RISE + d], t[_OMEGA_SF + d], t[_SIGMA_2 + d]
        load_rise, omega_sl, mu_2 = t[_LOAD_RISE + d], t[_OMEGA_SL + d], t[_MU_2 + d]
        d12, d22, ds = t[_P12 + d], t[_P22 + d], slow * t[_OMEGA + d]
        d_force = f_s * ds + f_v * d22 + t[_MC + d]
        d_force += f_dm * rise + f_of * omega_sf + f_s2 * sigma_2
        d_force += f_mc * t[_MU_C + d] + f_dl * load_rise + f_ol * omega_sl + f_m2 * mu_2
        d_grade = g_s * ds + g_dm * rise + g_of * omega_sf + sigma_2
        d_grade += g_dl * load_rise + g_ol * omega_sl + g_m2 * mu_2
        d_push = push_start * start + side * (t[_HIDDEN + d] - t[_OFFSET + d]) - d_force
        d_half = half_start * start + half_j * inertia + half_g * d_grade
        dc = c_start * start + c_j * inertia + c_half * d_half
        d_free = ds + push * dc + c * d_push
        d_after = moving * d_free
        d_growth = growth_half * d_half
        dh = h_start * start
        db = half_h * d_growth + 0.5 * (1.0 + growth) * dh
        dq = q_start * start + q_j * inertia
        t[_ANGLE + d] += side * 0.5 * (dh * path + h * (ds + d_after))
        t[_OMEGA + d] = side * d_after
        t[_P11 + d] += (
            p11_b * db + 2.0 * b * d12 + b * b * d22 + (h * h * dq + 2.0 * q * h * dh) / 3.0
        )
        t[_P12 + d] = (
            d_growth * middle + growth * (d12 + p22 * db + b * d22) + 0.5 * (h * dq + q * dh)
        )
        t[_P22 + d] = (
            twice * d_growth + growth * growth * d22 + dq - 2.0 * missing * (d_free - d_after)
        )
        t[_DH + d], t[_DB + d], t[_DC + d], t[_DG + d] = dh, db, dc, d_growth


@compiled
def _step_hidden(
    t: Array, hidden: tuple[float, float, float], gains: tuple[float, float, float, float]
) -> None:
    """Step the tangents of the correlated torque noise, after :func:`_step`.

    Args:
        t: Tangents and seeds of one block, shape (_SIZE,).
        hidden: Covariances of the noise with angle and speed, and its variance, before the step.
        gains: Length of the step, s, and the values b, c and growth of :func:`predict`.
    """
    p13, p23, p33 = hidden
    h, b, c, growth = gains
    a = 0.5 * h * c
    along = p13 + b * p23 + a * p33
    twice = 2.0 * growth * p23 + c * p33
    for d in range(WIDTH):
        db, dc, d_growth = t[_DB + d], t[_DC + d], t[_DG + d]
        da = 0.5 * (t[_DH + d] * c + h * dc)
        d13, d23, d33 = t[_P13 + d], t[_P23 + d], t[_P33 + d]
        d_along = d13 + db * p23 + b * d23 + da * p33 + a * d33
        d_twice = 2.0 * (d_growth * p23 + growth * d23) + dc * p33 + c * d33
        # p11 grows by 2 a (p13 + b p23) + a^2 p33 = a (2 along - a p33).
        t[_P11 + d] += da * (2.0 * along - a * p33) + a * (2.0 * d_along - da * p33 - a * d33)
        t[_P12 + d] += a * (d_growth * p23 + growth * d23) + growth * p23 * da
        t[_P12 + d] += dc * along + c * d_along
        t[_P22 + d] += dc * twice + c * d_twice
        t[_P13 + d] = d_along
        t[_P23 + d] = d_growth * p23 + growth * d23 + dc * p33 + c * d33


@inlined
def predict(
    state: State,
    tangents: Array,
    times: tuple[float, float, float, float],
    drive: tuple[float, float, float, float, float, float],
    p: Array,
) -> State:
    """Return the state after one integration step (M16, M17), and advance its tangents too.

    Args:
        state: Before.
        tangents: Tangents and seeds, shape (b, _SIZE).
        times: Length of the step, s; its middle, from the middle of the period, s; and their
            derivatives with respect to the breakaway time.
        drive: Torque, N m; its rate, N m/s; contact moment, N m; inertia, kg m^2; direction of
            motion; growth of the speed's variance, (rad/s)^2/s.
        p: Vector of :mod:`identification.model.parameters`.
    """
    _, omega, _, p12, p22, hidden, p13, p23, p33 = state
    h, centre, h_start, centre_start = times
    torque, slope, moment, inertia, side, noise_rate = drive
    inverse = 1.0 / inertia
    speed = max(side * omega, LEAST_SPEED)
    force, grade, friction = friction_slopes(speed, p22, moment, p)
    push = side * (torque + slope * centre - p[OFFSET] + hidden) - force
    half = -0.5 * h * inverse * grade
    share = 1.0 / max(1.0 - half, 0.5)
    c = h * inverse * share
    after = speed + c * push
    missing = max(LEAST_SPEED - after, 0.0)
    after += missing
    growth = min((1.0 + half) * share, 3.0)
    b = 0.5 * h * (1.0 + growth)
    q = noise_rate * h
    middle = p12 + b * p22
    share_half = share * share if 1.0 - half > 0.5 else 0.0
    growing = 1.0 if (1.0 + half) * share < 3.0 else 0.0
    slow, moving = side if side * omega > LEAST_SPEED else 0.0, 0.0 if missing > 0.0 else 1.0
    by_half = (h * inverse * share_half, growing * (share + (1.0 + half) * share_half))
    by_inertia = (-half * inverse, -0.5 * h * inverse, -c * inverse)
    by_start = (
        h_start,
        -0.5 * h_start * inverse * grade,
        h_start * inverse * share,
        side * slope * centre_start,
    )
    gains = (slow, side, push, c, *by_inertia, *by_half, moving, h, speed + after, *by_start)
    noise = (q, missing, -2.0 * q * inverse, noise_rate * h_start)
    covariance = (2.0 * middle, b, p22, growth, middle, 2.0 * growth * p22, *noise, 0.5 * h)
    for block in range(len(tangents)):
        _step(tangents[block], friction, gains, covariance)
        if p33 > 0.0:
            _step_hidden(tangents[block], (p13, p23, p33), (h, b, c, growth))
    motion = (side * h * 0.5 * (speed + after), side * after, missing * missing + q)
    return _moved(state, motion, (h, b, q, growth, c))


@inlined
def _moved(
    state: State,
    motion: tuple[float, float, float],
    gains: tuple[float, float, float, float, float],
) -> State:
    """Return the state after one integration step (M16, M17).

    Args:
        state: Before.
        motion: Change of the angle, rad; speed after the step, rad/s; increase of the variance of
            the speed.
        gains: Length of the step, s, and the values b, q, growth and c of :func:`predict`.
    """
    angle, _, p11, p12, p22, hidden, p13, p23, p33 = state
    change, omega, gained = motion
    h, b, q, growth, c = gains
    p11 += 2.0 * b * p12 + b * b * p22 + q * h * h / 3.0
    p12 = growth * (p12 + b * p22) + 0.5 * q * h
    p22 = growth * growth * p22 + gained
    if p33 > 0.0:
        a = 0.5 * h * c
        along = p13 + b * p23 + a * p33
        p11 += 2.0 * a * (p13 + b * p23) + a * a * p33
        p12 += growth * a * p23 + c * along
        p22 += c * (2.0 * growth * p23 + c * p33)
        p13 = along
        p23 = growth * p23 + c * p33
    return angle + change, omega, p11, p12, p22, hidden, p13, p23, p33


@compiled
def _correct_block(
    t: Array, state: State, error: float, variance: float, news: tuple[float, float], side: float
) -> None:
    """Correct the tangents of one block by a reading (M19); the arguments are those of
    :func:`correct`.
    """
    _, omega, p11, p12, _, _, p13, _, _ = state
    new, new_start = news
    g1, g2, g3, less = p11 / variance, p12 / variance, p13 / variance, new * (2.0 - new)
    kept, inverse = 1.0 - less * g1, 1.0 / variance
    missing = max(LEAST_SPEED - side * (omega + new * g2 * error), 0.0)
    moving = 0.0 if missing > 0.0 else 1.0
    for d in range(WIDTH):
        d_new = new_start * t[_START + d]
        d_less = 2.0 * d_new * (1.0 - new)
        d11, d12, d13 = t[_P11 + d], t[_P12 + d], t[_P13 + d]
        d_error = -t[_ANGLE + d]
        d1, d2, d3 = (
            (d11 - g1 * d11) * inverse,
            (d12 - g2 * d11) * inverse,
            (d13 - g3 * d11) * inverse,
        )
        d_kept = -d_less * g1 - less * d1
        d_free = t[_OMEGA + d] + d_new * g2 * error + new * (d2 * error + g2 * d_error)
        t[_ANGLE + d] += d_new * g1 * error + new * (d1 * error + g1 * d_error)
        t[_OMEGA + d] = moving * d_free
        t[_P22 + d] -= (
            2.0 * missing * side * (1.0 - moving) * d_free
            + d_less * g2 * p12
            + less * (d2 * p12 + g2 * d12)
        )
        t[_HIDDEN + d] += d_new * g3 * error + new * (d3 * error + g3 * d_error)
        t[_P33 + d] -= d_less * g3 * p13 + less * (d3 * p13 + g3 * d13)
        t[_P23 + d] -= d_less * g3 * p12 + less * (d3 * p12 + g3 * d12)
        t[_P13 + d] = d13 * kept + p13 * d_kept
        t[_P11 + d] = d11 * kept + p11 * d_kept
        t[_P12 + d] = d12 * kept + p12 * d_kept
    for k in range(_STATES):
        t[k] = min(max(t[k], -_MOST), _MOST)


@inlined
def correct(
    state: State,
    tangents: Array,
    error: float,
    variance: float,
    news: tuple[float, float],
    unsure: float,
    side: float,
) -> State:
    """Return the state after a reading (M19), and correct its tangents too.

    Args:
        state: Before.
        tangents: Tangents and seeds, shape (b, _SIZE).
        error: Innovation, rad.
        variance: Variance of the innovation, rad^2.
        news: Share of the period since the breakaway, and its derivative with respect to the
            breakaway time.
        unsure: Variance that is added to the variance of the speed, (rad/s)^2.
        side: Direction of motion.
    """
    for block in range(len(tangents)):
        _correct_block(tangents[block], state, error, variance, news, side)
    return corrected(state, error, variance, news[0], unsure, side)


@compiled
def begun(tangents: Array, p22_inertia: float, speed: float, follows: bool) -> None:
    """Set the tangents at the start of a segment.

    Args:
        tangents: Tangents and seeds.
        p22_inertia: Derivative of the speed's variance with respect to the inertia.
        speed: Speed at the end of the segment before it, rad/s.
        follows: Whether the segment continues the segment before it.
    """
    for t in tangents:
        for d in range(WIDTH):
            omega = t[_OMEGA + d]
            for k in range(d, _STATES, WIDTH):
                t[k] = 0.0
            t[_P22 + d] = p22_inertia * t[_INERTIA + d]
            if follows:
                t[_OMEGA + d] = omega
                t[_P22 + d] = 2.0 * speed * omega


@compiled
def forgotten(tangents: Array, kept: float) -> None:
    """Let the tangents of the correlated torque noise decay over a period to a share ``kept``."""
    for t in tangents:
        for d in range(WIDTH):
            t[_HIDDEN + d] *= kept
            t[_P13 + d] *= kept
            t[_P23 + d] *= kept
            t[_P33 + d] *= kept * kept


@compiled
def slopes_of_reading(tangents: Array, variance: float, error: Array, deviation: Array) -> None:
    """Fill the derivatives of one innovation and of its log standard deviation, shape (d,) each."""
    for j in range(len(error)):
        t, d = tangents[j // WIDTH], j % WIDTH
        error[j] = -t[_ANGLE + d]
        deviation[j] = 0.5 * t[_P11 + d] / variance


def seeded(seeds: Array) -> Array:
    """Return the workspace of tangents and seeds for directions, shape (b, _SIZE).

    Args:
        seeds: Directions, shape (d, SEEDS): derivative of each parameter, and in column ``START``
            that of all breakaway times.
    """
    blocks = -(-len(seeds) // WIDTH)
    padded = np.zeros((blocks * WIDTH, SEEDS))
    padded[: len(seeds)] = seeds
    out = np.zeros((blocks, _SIZE))
    out[:, _STATES:_DH] = (
        padded.reshape(blocks, WIDTH, SEEDS).transpose(0, 2, 1).reshape(blocks, -1)
    )
    return out
