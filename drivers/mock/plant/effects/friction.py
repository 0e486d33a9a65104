"""Injected friction effects at the joint: asymmetry, drag, memory, rest time, bristles (LuGre)."""

from __future__ import annotations

import math

from drivers.mock.plant.effects.outside import outside_level
from drivers.mock.plant.effects.table import PRESLIDING_STIFFNESS
from drivers.mock.plant.parts.compiled import Vector, inlined
from drivers.mock.plant.parts.friction import (
    ALPHA,
    DM,
    DMU,
    FRICTION_SIZE,
    INERTIA,
    MC,
    MOMENT,
    MU_2,
    MU_C,
    OMEGA_SF,
    OMEGA_SL,
    SIGMA_2,
    friction,
)

# Slots of the working friction vector after those of the nominal friction vector.
SIDE, VISCOUS_SIDE, DRAG, LAGGED, WORK_SIZE = range(FRICTION_SIZE, FRICTION_SIZE + 5)

_BRISTLE_DAMPING = 0.2
"""Assumed damping ratio of the oscillation of a sticking joint on its bristles."""


@inlined
def static_limit(side: float, w: Vector) -> float:
    """Return the static friction limit against a torque in direction ``side`` (1 or -1), N m."""
    return float(
        max(w[MC] + w[DM] + w[MOMENT] * (w[MU_C] + w[DMU]) + side * w[SIDE] + w[LAGGED], 0.0)
    )


@inlined
def level(speed: float, side: float, w: Vector, e: Vector) -> tuple[float, float]:
    """Return friction at a sliding ``speed`` >= 0 rad/s in the direction ``side``, and its slope; N
    m and N m s/rad.
    """
    magnitude, slope = friction(speed, w)
    magnitude += side * (w[SIDE] + w[VISCOUS_SIDE] * speed) + w[DRAG] * speed * speed + w[LAGGED]
    slope += side * w[VISCOUS_SIDE] + 2.0 * w[DRAG] * speed
    more, steeper = outside_level(speed, w[MOMENT], e)
    magnitude += more
    slope += steeper
    if magnitude < 0.0:
        return 0.0, 0.0
    return magnitude, slope


@inlined
def bristle_level(speed: float, p: Vector, moment: float) -> float:
    """Return the part of the nominal friction that falls with speed, at ``speed`` >= 0 rad/s, N
    m.
    """
    at_rest = p[DM] * math.exp(-((speed / p[OMEGA_SF]) ** p[ALPHA]))
    if moment > 0.0:
        at_rest += moment * p[DMU] * math.exp(-((speed / p[OMEGA_SL]) ** p[ALPHA]))
    return float(at_rest)


@inlined
def step_slipping(
    omega: float, before: float, torque: float, h: float, w: Vector, e: Vector
) -> tuple[float, float, float]:
    """Advance J domega/dt = torque - friction by ``h`` s; friction may depend on the direction.

    With the same friction in both directions the result is that of
    :func:`drivers.mock.plant.parts.friction.step_velocity`.

    Returns:
        Speed after the step, impulse of friction against the motion (N m s), friction magnitude at
        the new speed.
    """
    if omega == 0.0:
        side = 1.0 if torque > 0.0 else -1.0
        static = static_limit(side, w)
        if abs(torque) <= static:
            return 0.0, 0.0, static
        if w[SIDE] != 0.0:
            before = static
    else:
        side = 1.0 if omega > 0.0 else -1.0
        static = static_limit(side, w)
    inertia = w[INERTIA]
    start = side * omega
    drive = side * torque
    if inertia * start <= h * (0.5 * (before + static) - drive):
        return 0.0, inertia * start, static
    speed = max(start + h * (drive - before) / inertia, 1e-9)
    after = before
    for _ in range(20):
        after, slope = level(speed, side, w, e)
        residual = inertia * (speed - start) / h + 0.5 * (before + after) - drive
        change = min(residual / (inertia / h + 0.5 * slope), 0.5 * speed)
        speed -= change
        after -= slope * change
        if abs(change) <= 1e-7 * speed:
            break
    return side * speed, 0.5 * h * (before + after), after


@inlined
def step_bristles(
    omega: float, z: float, torque: float, h: float, w: Vector, e: Vector
) -> tuple[float, float, float]:
    """Advance a joint with bristle friction (LuGre model, Canudas de Wit et al. 1995) by ``h``.

    dz/dt = omega - sigma_0 |omega| z / g(omega); friction = sigma_0 z + sigma_1 dz/dt + viscous
    part, with a sigma_1 that falls with speed. The step is linearly implicit, and therefore stable
    for any stiffness.

    Args:
        omega: Speed, rad/s.
        z: Mean deflection of the bristles, rad.
        torque: Torque over the step, N m.
        h: Step, s.
        w: Working friction vector.
        e: Effect vector.

    Returns:
        Speed and deflection after the step, and the friction torque over the step, with its sign.
    """
    stiffness = e[PRESLIDING_STIFFNESS]
    inertia = w[INERTIA]
    speed = abs(omega)
    side = 1.0 if omega > 0.0 or (omega == 0.0 and torque > 0.0) else -1.0
    full, _ = level(speed, side, w, e)
    damping = max(w[SIGMA_2] + w[MOMENT] * w[MU_2] + side * w[VISCOUS_SIDE] + w[DRAG] * speed, 0.0)
    dry = max(full - damping * speed, 1e-6)
    ratio = speed / w[OMEGA_SF]
    inner = 2.0 * _BRISTLE_DAMPING * math.sqrt(stiffness * inertia) * math.exp(-ratio * ratio)
    share = 1.0 / (1.0 + h * stiffness * speed / dry)
    held = stiffness * z * share + inner * z * (share - 1.0) / h
    resistance = (stiffness * h + inner) * share + damping
    new = (inertia * omega / h + torque - held) / (inertia / h + resistance)
    return new, (z + h * new) * share, held + resistance * new
