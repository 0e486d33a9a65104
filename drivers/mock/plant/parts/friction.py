"""Stribeck friction of the simulated joint (eq. 9, 12, 13), and the throat of its valve."""

from __future__ import annotations

import math

from drivers.mock.plant.parts.compiled import Vector, inlined

# Layout of the friction vector for compiled code.
MC, DM, OMEGA_SF, SIGMA_2, MU_C, DMU, OMEGA_SL, MU_2, ALPHA, MOMENT, INERTIA, FRICTION_SIZE = range(
    12
)


@inlined
def friction(speed: float, p: Vector) -> tuple[float, float]:
    """Return the magnitude |M_f| + |M_L| of friction at a sliding ``speed`` >= 0 rad/s, and its
    slope, in N m and N m s/rad.

    The magnitude at speed 0 is the static limit; the slope at speed 0 is that of the viscous part
    alone.
    """
    alpha = p[ALPHA]
    ratio = speed / p[OMEGA_SF]
    x = ratio * ratio if alpha == 2.0 else ratio**alpha
    bristle = p[DM] * math.exp(-x)
    magnitude = p[MC] + p[SIGMA_2] * speed + bristle
    slope = p[SIGMA_2]
    if speed > 0.0:
        slope -= bristle * alpha * x / speed
    moment = p[MOMENT]
    if moment > 0.0:
        ratio = speed / p[OMEGA_SL]
        x = ratio * ratio if alpha == 2.0 else ratio**alpha
        bristle = moment * p[DMU] * math.exp(-x)
        magnitude += moment * (p[MU_C] + p[MU_2] * speed) + bristle
        slope += moment * p[MU_2]
        if speed > 0.0:
            slope -= bristle * alpha * x / speed
    return magnitude, slope


@inlined
def disc_beyond(radius: float, distance: float) -> float:
    """Return the area of a disc beyond a line at this signed distance from its centre."""
    t = min(max(distance / radius, -1.0), 1.0)
    return radius * radius * (math.acos(t) - t * math.sqrt(1.0 - t * t))


@inlined
def lens(large: float, small: float, distance: float) -> float:
    """Return the area common to two discs with their centres ``distance`` apart."""
    if distance >= large + small:
        return 0.0
    if distance <= large - small:
        return math.pi * small * small
    chord = 0.5 * (distance + (large * large - small * small) / distance)
    return disc_beyond(large, chord) + disc_beyond(small, distance - chord)


@inlined
def open_throat(angle: float, arm: float, hole: float, opening: float, half_width: float) -> float:
    """Return A_t, m^2, at a valve angle.

    Args:
        angle: Valve angle, rad; the areas do not depend on its sign.
        arm: L1, m.
        hole: Radius d/2, m.
        opening: Radius D/2, m.
        half_width: b/2, m; more than the hole's radius.
    """
    aside = arm * math.sin(abs(angle))
    free = disc_beyond(opening, half_width - aside) + disc_beyond(opening, half_width + aside)
    return free + lens(opening, hole, 2.0 * arm * math.sin(0.5 * abs(angle)))
