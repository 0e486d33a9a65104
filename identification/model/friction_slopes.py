"""Computes the derivatives of the expected friction (M15) with respect to speed and parameters;
compiled.
"""

from __future__ import annotations

from identification.model.friction import LEAST_OMEGA, NEGLIGIBLE, Law
from identification.model.parameters import (
    ALPHA,
    LOAD_RISE,
    MC,
    MU_2,
    MU_C,
    OMEGA_SF,
    OMEGA_SL,
    SIGMA_2,
    SYSTEM_RISE,
)
from identification.numerics.compiled import inlined
from identification.numerics.exponential import exponential

Slopes = tuple[float, ...]


@inlined
def _falling_slopes(
    speed: float, omega_s: float, alpha: float, variance: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return expected value and slope of exp(-(speed/omega_s)^alpha) (M15), and their derivatives.

    Returns:
        The value and the slope; the derivatives of the value with respect to speed, variance and
        omega_s; the derivatives of the slope with respect to speed and omega_s.
    """
    omega_s = max(omega_s, LEAST_OMEGA)
    within = omega_s * omega_s
    x = speed * speed / within
    if alpha != 2.0:
        x = (speed / omega_s) ** alpha
    kept = 0.0 if x >= NEGLIGIBLE else 1.0
    x = min(NEGLIGIBLE, x)
    rate = x / (speed * speed)
    part = kept * exponential(-x)
    x_speed, x_omega = alpha * x / speed, -alpha * x / omega_s
    curved = part * alpha * rate
    curved_speed = curved * ((alpha - 2.0) / speed - x_speed)
    curved_omega = curved * (-alpha / omega_s - x_omega)
    spread = within if variance >= within else variance
    spread_variance = 0.0 if variance >= within else 1.0
    spread_omega = 2.0 * omega_s if variance >= within else 0.0
    bend = alpha * x - alpha + 1.0
    return (
        part + 0.5 * spread * curved * bend,
        -curved * speed,
        -part * x_speed + 0.5 * spread * (curved_speed * bend + curved * alpha * x_speed),
        0.5 * spread_variance * curved * bend,
        -part * x_omega
        + 0.5 * spread_omega * curved * bend
        + 0.5 * spread * (curved_omega * bend + curved * alpha * x_omega),
        -curved_speed * speed - curved,
        -curved_omega * speed,
    )


@inlined
def friction_slopes(
    speed: float, variance: float, moment: float, p: Law
) -> tuple[float, float, Slopes]:
    """Return expected friction, N m, its slope (M15), and their derivatives.

    Args:
        speed: Magnitude of the mean speed, rad/s.
        variance: Variance of the speed, (rad/s)^2.
        moment: Contact moment F_P L1, N m, not negative.
        p: Parameters, from :func:`identification.model.friction.law`.

    Returns:
        The friction F; its slope S; and their derivatives in this order: F with respect to speed
        and variance, S with respect to speed; F with respect to dM, omega_sf and sigma_2, S with
        respect to dM and omega_sf; F with respect to mu_c, dmu, omega_sL and mu_2, S with respect
        to dmu, omega_sL and mu_2.
    """
    own, own_slope, f_s, f_v, f_o, g_s, g_o = _falling_slopes(
        speed, p[OMEGA_SF], p[ALPHA], variance
    )
    rise = p[SYSTEM_RISE]
    force = p[MC] + p[SIGMA_2] * speed + rise * own
    grade = p[SIGMA_2] + rise * own_slope
    force_speed, force_variance = p[SIGMA_2] + rise * f_s, rise * f_v
    grade_speed, force_omega, grade_omega = rise * g_s, rise * f_o, rise * g_o
    load, load_slope, f_s, f_v, f_o, g_s, g_o = _falling_slopes(
        speed, p[OMEGA_SL], p[ALPHA], variance
    )
    rise = moment * p[LOAD_RISE]
    force += moment * (p[MU_C] + p[MU_2] * speed) + rise * load
    grade += moment * p[MU_2] + rise * load_slope
    force_speed += moment * p[MU_2] + rise * f_s
    force_variance += rise * f_v
    grade_speed += rise * g_s
    load_omega, load_slope_omega = rise * f_o, rise * g_o
    return (
        force,
        grade,
        (
            force_speed,
            force_variance,
            grade_speed,
            own,
            force_omega,
            speed,
            own_slope,
            grade_omega,
            moment,
            moment * load,
            load_omega,
            moment * speed,
            moment * load_slope,
            load_slope_omega,
            moment,
        ),
    )
