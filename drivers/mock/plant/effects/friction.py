"""Injected friction effects at the joint: asymmetry, drag, memory, rest time, bristles (LuGre)."""

from __future__ import annotations

import math

from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.outside import ACCELERATION_DRAG, outside_level, outside_sides
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
    """Return friction, N m, at ``speed`` >= 0 rad/s in direction ``side``, and its slope."""
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
    """Return the nominal friction that falls with speed, at ``speed`` >= 0 rad/s, N m."""
    at_rest = p[DM] * math.exp(-((speed / p[OMEGA_SF]) ** p[ALPHA]))
    if moment > 0.0:
        at_rest += moment * p[DMU] * math.exp(-((speed / p[OMEGA_SL]) ** p[ALPHA]))
    return float(at_rest)


@inlined
def step_slipping(
    omega: float, before: float, torque: float, h: float, w: Vector, e: Vector
) -> tuple[float, float, float]:
    """Advance J domega/dt = torque - friction by ``h`` s.

    Friction has the factor sgn(omega), which the paper omits, and may depend on the direction.
    While the joint slides, the step is trapezoidal and implicit in friction. A joint whose speed
    would change its sign stops. A joint at rest stays exactly at rest until the torque exceeds the
    static limit, so that it neither creeps nor oscillates. The step has one solution if h < 2 J /
    |steepest negative slope|.

    Args:
        omega: Speed, rad/s.
        before: Friction magnitude at this speed, N m (third result of the last step).
        torque: Drive torque over the step, N m.
        h: Step, s.
        w: Working friction vector.
        e: Effect vector.

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
        # Newton's method converges quadratically: the remaining error is below rounding.
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
    stiffness = e[table.PRESLIDING_STIFFNESS]
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


_STOP_DAMPING_S = 2e-3
"""Ratio of an end stop's damping to its stiffness, s, which is assumed for a rubber pad."""


@inlined
def device_torque(theta: float, omega: float, e: Vector) -> float:
    """Return the torque of load, imbalance, spring and end stop on the joint, N m.

    A stop pushes only away from itself. One stop acts beyond ``angle_rad``, in the direction of the
    sign of ``angle_rad``. With a second stop (``other_rad``, 0 for none) the first stop acts above
    ``angle_rad`` and the second stop below ``other_rad``.
    """
    torque = float(e[table.CONSTANT_TORQUE])
    if e[table.GRAVITY_TORQUE] != 0.0:
        torque -= e[table.GRAVITY_TORQUE] * math.sin(theta - e[table.GRAVITY_ZERO])
    if e[table.SPRING_STIFFNESS] != 0.0:
        torque -= e[table.SPRING_STIFFNESS] * (theta - e[table.SPRING_REST])
    if e[table.STOP_STIFFNESS] != 0.0:
        side = math.copysign(1.0, e[table.STOP_ANGLE]) if e[table.STOP_OTHER] == 0.0 else 1.0
        depth = side * (theta - e[table.STOP_ANGLE])
        if depth > 0.0:
            torque -= side * max(
                e[table.STOP_STIFFNESS] * (depth + _STOP_DAMPING_S * side * omega), 0.0
            )
        if e[table.STOP_OTHER] != 0.0 and theta < e[table.STOP_OTHER]:
            depth = e[table.STOP_OTHER] - theta
            torque += max(e[table.STOP_STIFFNESS] * (depth - _STOP_DAMPING_S * omega), 0.0)
    return torque


@inlined
def load_factor(theta: float, time: float, e: Vector) -> float:
    """Return the ratio of the contact force to that of the weight at rest."""
    factor = 1.0
    if e[table.LOAD_SLOPE] != 0.0:
        factor = max(1.0 + e[table.LOAD_SLOPE] * theta, 0.0)
    if e[table.SWING_FRACTION] != 0.0:
        swing = math.cos(2.0 * math.pi * e[table.SWING_FREQUENCY] * time) * math.exp(
            -time / e[table.SWING_DECAY]
        )
        factor *= 1.0 + e[table.SWING_FRACTION] * swing
    return factor


_RENEWAL_RAD = 1e-3  # assumed sliding distance after which a rest no longer counts, rad
_SMOOTHED_S = 2.5e-3  # assumed time constant of the acceleration of `x_acceleration_drag`, s


@inlined
def renew(w: Vector, p: Vector, e: Vector, x: Vector, omega: float) -> None:
    """Write all elements of the friction vector ``w`` of one loop period except the inertia."""
    theta = x[table.JOINT]
    for k in range(FRICTION_SIZE - 1):
        w[k] = p[k]
    w[SIDE] = e[table.ASYMMETRIC_COULOMB]
    w[VISCOUS_SIDE] = e[table.ASYMMETRIC_VISCOUS]
    w[DRAG] = e[table.QUADRATIC_DRAG]
    w[LAGGED] = 0.0
    if e[table.PATCH_TORQUE] != 0.0:
        u = (theta - e[table.PATCH_CENTER]) / e[table.PATCH_WIDTH]
        w[MC] += e[table.PATCH_TORQUE] * math.exp(-0.5 * u * u)
    if e[table.COULOMB_RATE] != 0.0:
        time = e[table.COULOMB_TIME]
        w[MC] -= e[table.COULOMB_RATE] * time * math.expm1(-x[table.RUN] / time)
    if e[table.THERMAL_FRACTION] != 0.0:
        w[SIGMA_2] *= 1.0 - e[table.THERMAL_FRACTION] * (
            1.0 - math.exp(-x[table.RUN] / e[table.THERMAL_TIME])
        )
    if p[MOMENT] > 0.0:
        w[MOMENT] = p[MOMENT] * load_factor(theta, x[table.TIME], e)
        w[MC] += e[table.PIVOT_TORQUE]
    both, one = outside_sides(theta, x[table.ACCELERATION], e)
    w[MC] += both
    w[SIDE] += one
    if 0.0 < e[table.EFFICIENCY] < 1.0:
        share = e[table.EFFICIENCY]
        driving = x[table.TRANSMITTED] * omega >= 0.0
        w[MC] += abs(x[table.TRANSMITTED]) * (1.0 - share if driving else 1.0 / share - 1.0)
    w[MC] = max(w[MC] + e[table.LOAD_FRICTION] * abs(x[table.EXTERNAL]), 0.0)
    if e[table.DWELL_GROWTH] != 0.0:
        w[DM] += x[table.GROWN]
    if e[table.MEMORY_TIME] > 0.0:
        w[DM] = w[DMU] = 0.0
        w[LAGGED] = x[table.FALLING]
        if e[table.MEMORY_OF_SPEED] > 0.0:
            w[LAGGED] = bristle_level(abs(x[table.FALLING]), p, w[MOMENT])


@inlined
def remember(
    w: Vector, p: Vector, e: Vector, x: Vector, before: float, omega: float, h: float
) -> None:
    """Advance the states of friction with memory by one loop period of ``h`` seconds."""
    speed = abs(omega)
    if e[table.MEMORY_TIME] > 0.0:
        wanted = omega
        if e[table.MEMORY_OF_SPEED] == 0.0:
            wanted = bristle_level(speed, p, w[MOMENT])
        x[table.FALLING] = wanted + (x[table.FALLING] - wanted) * math.exp(
            -h / e[table.MEMORY_TIME]
        )
    if e[table.DWELL_GROWTH] != 0.0:
        # The joint counts as at rest, on bristles too, if it is slower than a hundredth of the
        # Stribeck speed.
        if speed < 0.01 * p[OMEGA_SF]:
            wanted = e[table.DWELL_GROWTH]
            x[table.GROWN] = wanted + (x[table.GROWN] - wanted) * math.exp(-h / e[table.DWELL_TIME])
        else:
            x[table.GROWN] *= math.exp(-speed * h / _RENEWAL_RAD)
    if e[ACCELERATION_DRAG] != 0.0:
        share = 1.0 - math.exp(-h / _SMOOTHED_S)
        x[table.ACCELERATION] += share * ((omega - before) / h - x[table.ACCELERATION])
