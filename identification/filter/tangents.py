"""Computes the derivatives (tangents) of one step and of one reading of the Kalman filter;
compiled.

A tangent is the derivative of the filter's state in one direction of the parameters or breakaway
times. All lanes (:mod:`identification.filter.lanes`) are computed together, direction by direction.
"""

from __future__ import annotations

from identification.filter.lanes import (
    L_DIFFUSION,
    L_ERROR,
    L_HIDDEN,
    L_INVERSE,
    L_LENGTH,
    L_MIDDLE,
    L_MOMENT,
    L_MOVED,
    L_NOW,
    L_OMEGA,
    L_P11,
    L_P12,
    L_P13,
    L_P22,
    L_P23,
    L_P33,
    L_SHARE,
    L_SIDE,
    L_SLOPE,
    L_STEPS,
    L_TORQUE,
    L_VARIANCE,
    LANES,
    LEAST_SPEED,
)
from identification.model.friction import Law, law
from identification.model.friction_slopes import friction_slopes
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

START = OFFSET + 1
"""Column of the directions for the breakaway time; the columns before are the parameters."""
SEEDS = START + 1
"""Number of columns of the directions."""
T_ANGLE, T_OMEGA, T_P11, T_P12, T_P22, T_HIDDEN, T_P13, T_P23, T_P33 = (LANES * k for k in range(9))
"""Places of the derivatives of the state in one direction."""
_T_DH, _T_DB, _T_DC, _T_DG = (LANES * k for k in range(9, 13))
"""Places of the derivatives of h, b, c and growth of one step, for the correlated noise."""
TANGENTS = 13 * LANES
"""Length of the array of one direction."""
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
    """Store the factors of the tangents of the first ``wide`` lanes for one integration step.

    Args:
        g: Factors, shape (GAINS,).
        t: Workspace of the lanes before the step, shape (WORKSPACE,).
        wide: Number of lanes.
        number: Number of the step in the period.
        p: Vector of :mod:`identification.model.parameters`.
    """
    if p[ALPHA] == 2.0:
        _factors(g, t, wide, float(number), law(p, 2.0))
    else:
        _factors(g, t, wide, float(number), law(p, p[ALPHA]))


@compiled
def step(d: Array, seed: Array, g: Array, t: Array, wide: int) -> None:
    """Propagate the tangents of angle, speed and their covariance in one direction over one
    integration step (M16, M17).

    Args:
        d: Tangents of the direction, shape (TANGENTS,).
        seed: The direction, shape (SEEDS,).
        g: Factors of the step, shape (GAINS,).
        t: Workspace of the lanes before the step, shape (WORKSPACE,).
        wide: Number of lanes.
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
    """Propagate the tangents of the correlated torque noise in one direction over one integration
    step, after :func:`step`, which has the same arguments.
    """
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
    """Correct the tangents of one direction by a reading (M19), before the state is corrected.

    Args:
        d: Tangents of the direction, shape (TANGENTS,).
        seed: The direction, shape (SEEDS,).
        t: Workspace of the lanes before the correction, shape (WORKSPACE,).
        wide: Number of lanes.
    """
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
