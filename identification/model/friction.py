"""The friction law of the nominal model, eq. 9, 12 and 13 (M1, M2): friction torque over speed.

The law has three forms: compiled for one speed, compiled as the expected value over an uncertain
speed, and in numpy for arrays.

With speed w >= 0, contact moment m and gear load g the magnitude of friction is

    F = Mc + sigma_2 w + (dM + g dmu_g) e(w/omega_sf)
        + m (mu_c + mu_2 w + dmu e(w/omega_sL)) + g mu_gc

where e(x) = exp(-x^alpha). At rest F is the static limit (M3).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.model.parameters import (
    ALPHA,
    GEAR_RISE,
    LOAD_RISE,
    MC,
    MU_2,
    MU_C,
    MU_GC,
    OMEGA_SF,
    OMEGA_SL,
    SIGMA_2,
    SYSTEM_RISE,
)
from identification.numerics.arrays import Array
from identification.numerics.compiled import exponential, inlined

Law = tuple[float, ...]  # the first parameters of the vector, up to `ALPHA`, as a tuple
NEGLIGIBLE = 37.0
"""Exponent beyond which falling friction is neglected: exp(-37) is below the rounding error."""
LEAST_OMEGA = 1e-100
"""Stribeck speed in place of zero, rad/s; with this value the falling part is zero at any speed."""


@inlined
def _falling_part(height: float, speed: float, omega_s: float, alpha: float) -> tuple[float, float]:
    """Return ``height`` exp(-(speed/omega_s)^alpha), N m, and its slope; zero slope at rest."""
    x = speed / omega_s
    x = x * x if alpha == 2.0 else x**alpha
    if x >= NEGLIGIBLE:
        return 0.0, 0.0
    part = height * math.exp(-x)
    return part, -part * alpha * x / speed if speed > 0.0 else 0.0


@inlined
def friction(speed: float, moment: float, gear: float, p: Array) -> tuple[float, float]:
    """Return the magnitude of friction, N m, and its slope at ``speed`` >= 0.

    Args:
        speed: Magnitude, rad/s.
        moment: Contact moment F_P L1, N m.
        gear: Magnitude of the torque that the gear transmits, N m; the falling part of the gear's
            friction has the Stribeck speed omega_sf.
        p: Vector of :mod:`identification.model.parameters`.
    """
    value, slope = p[MC] + p[SIGMA_2] * speed, p[SIGMA_2]
    height = p[SYSTEM_RISE]
    if gear > 0.0:
        height += gear * p[GEAR_RISE]
        value += gear * p[MU_GC]
    if height > 0.0:
        part, grade = _falling_part(height, speed, p[OMEGA_SF], p[ALPHA])
        value += part
        slope += grade
    if moment > 0.0:
        part = 0.0
        slope += moment * p[MU_2]
        if p[LOAD_RISE] > 0.0:
            height = moment * p[LOAD_RISE]
            part, grade = _falling_part(height, speed, p[OMEGA_SL], p[ALPHA])
            slope += grade
        value += moment * (p[MU_C] + p[MU_2] * speed) + part
    return value, slope


@inlined
def static_friction(moment: float, p: Array) -> float:
    """Return the static limit (M3) without the terms in the transmitted load, N m."""
    limit: float = p[MC] + p[SYSTEM_RISE] + moment * (p[MU_C] + p[LOAD_RISE])
    return limit


@inlined
def law(p: Array, alpha: float) -> Law:
    """Return the parameters of the friction law as a tuple, which a compiled loop reads faster than
    an array; if ``alpha`` is a constant, the compiler replaces powers in the loop by
    multiplications.
    """
    return p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11], alpha


@inlined
def _falling(
    height: float, speed: float, omega_s: float, alpha: float, variance: float
) -> tuple[float, float]:
    """Return the expectation of the falling part to second order (M15), and its slope."""
    omega_s = max(omega_s, LEAST_OMEGA)
    within = omega_s * omega_s
    rate = 1.0 / within
    x = speed * speed * rate
    if alpha != 2.0:
        x = (speed / omega_s) ** alpha
        rate = x / (speed * speed)
    part = height * exponential(-min(NEGLIGIBLE, x))
    part = 0.0 if x >= NEGLIGIBLE else part
    curved = part * alpha * rate
    return part + 0.5 * min(variance, within) * curved * (alpha * x - alpha + 1.0), -curved * speed


@inlined
def expected_friction(speed: float, variance: float, moment: float, p: Law) -> tuple[float, float]:
    """Return the expected magnitude of friction, N m, and its slope, for an uncertain speed > 0
    (M15).

    The function has no branches, so that one instruction computes several motion segments.

    Args:
        speed: Magnitude of the mean speed, rad/s.
        variance: Variance of the speed, (rad/s)^2; if it is zero, the result equals that of
            :func:`friction`.
        moment: Contact moment F_P L1, N m, not negative.
        p: Parameters, from :func:`law`.
    """
    part, slope = _falling(p[SYSTEM_RISE], speed, p[OMEGA_SF], p[ALPHA], variance)
    value = p[MC] + p[SIGMA_2] * speed + part
    slope += p[SIGMA_2]
    part, fall = _falling(moment * p[LOAD_RISE], speed, p[OMEGA_SL], p[ALPHA], variance)
    value += moment * (p[MU_C] + p[MU_2] * speed) + part
    slope += moment * p[MU_2] + fall
    return value, slope


def stribeck_shape(velocity: Array, omega_s: float, alpha: float) -> Array:
    """Return sgn(omega) exp(-|omega/omega_s|^alpha), the part of eq. 9 that falls with speed; an
    array of the shape of ``velocity``.
    """
    return np.asarray(np.sign(velocity) * np.exp(-(np.abs(velocity / omega_s) ** alpha)))


def system_friction(velocity: Array, parameters: Mapping[str, float], alpha: float) -> Array:
    """Return M_f of eq. 9 in sliding, N m; 0 at rest, where friction is set-valued."""
    p = parameters
    return np.asarray(
        p["Mc"] * np.sign(velocity)
        + (p["Ms"] - p["Mc"]) * stribeck_shape(velocity, p["omega_sf"], alpha)
        + p["sigma_2"] * velocity
    )


def load_coefficient(velocity: Array, parameters: Mapping[str, float], alpha: float) -> Array:
    """Return m_L of eq. 12, dimensionless; m_L times F_P L1 is the working load M_L of eq. 13."""
    p = parameters
    return np.asarray(
        p["mu_c"] * np.sign(velocity)
        + (p["mu_s"] - p["mu_c"]) * stribeck_shape(velocity, p["omega_sL"], alpha)
        + p["mu_2"] * velocity
    )


Slopes = tuple[float, ...]


@inlined
def _falling_slopes(
    speed: float, omega_s: float, alpha: float, variance: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return value and slope of the expected falling part, then their derivatives."""
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
