"""The transmission where it is not rigid: rotor and joint as two masses with a gap, a spring and a
hysteresis between.

All at the joint: ``twist`` is phi/i - theta.
"""

from __future__ import annotations

import math

from drivers.mock.plant.effects.table import (
    GAP,
    HYSTERESIS_DEFLECTION,
    HYSTERESIS_TORQUE,
    MESH_AMPLITUDE,
    MESH_ORDER,
    MESH_PHASE,
    STIFFNESS,
)
from drivers.mock.plant.parts.compiled import Vector, inlined

HARD_N_M_RAD = 1e6
"""Stiffness of teeth and shaft where nothing says otherwise: 20 N m twist it by 20 microradian, an
encoder count.
"""
DAMPING_RATIO = 0.08
"""Of rotor against joint on the shaft's spring; chosen."""


@inlined
def stiffness_of(e: Vector) -> float:
    """Return the shaft's stiffness, N m/rad."""
    return e[STIFFNESS] if e[STIFFNESS] > 0.0 else HARD_N_M_RAD


@inlined
def shaft_torque(twist: float, rate: float, given: float, damping: float, e: Vector) -> float:
    """Return the torque that the shaft carries from rotor to joint.

    Teeth push and never pull: the damping cannot turn the torque of a closed gap around.

    Args:
        twist: rad.
        rate: Its rate without the coupling's, rad/s.
        given: Deflection of the coupling's hysteresis, rad.
        damping: N m s/rad.
        e: Effect vector.
    """
    stiffness = stiffness_of(e)
    half = 0.5 * e[GAP]
    if half == 0.0:
        return float(stiffness * (twist - given) + damping * rate)
    if twist > half:
        return float(max(stiffness * (twist - half - given) + damping * rate, 0.0))
    if twist < -half:
        return float(min(stiffness * (twist + half - given) + damping * rate, 0.0))
    return 0.0


@inlined
def deflection(play: float, e: Vector) -> float:
    """Return the deflection of the coupling's hysteresis where its play stands, rad."""
    most = e[HYSTERESIS_DEFLECTION]
    return float(most * min(max(play / e[HYSTERESIS_TORQUE], -1.0), 1.0)) if most > 0.0 else 0.0


@inlined
def give_way(twist: float, play: float, e: Vector) -> tuple[float, float]:
    """Return the deflection (rad) and the play (N m) of a coupling with hysteresis in series with
    the shaft's spring.

    Rate-independent and dissipative: a play of half width ``torque_Nm`` follows the torque, and the
    deflection is ``deflection_rad`` for each ``torque_Nm`` of it, to no more than +-
    ``deflection_rad``. Deflection and torque are solved together, in closed form, since the spring
    is stiff.

    Args:
        twist: Of spring and coupling, rad.
        play: Where the play stood, N m.
        e: Effect vector.
    """
    most, width = e[HYSTERESIS_DEFLECTION], e[HYSTERESIS_TORQUE]
    if most == 0.0:
        return 0.0, 0.0
    half = 0.5 * e[GAP]
    beyond = max(twist - half, 0.0) + min(twist + half, 0.0)
    stiffness = stiffness_of(e)
    torque = stiffness * (beyond - most * min(max(play / width, -1.0), 1.0))
    if abs(torque - play) > width:
        side = 1.0 if torque > play else -1.0
        play = stiffness * (beyond + side * most) / (1.0 + stiffness * most / width) - side * width
        if abs(play) > width:
            play = stiffness * (beyond - math.copysign(most, play)) - side * width
    return deflection(play, e), play


@inlined
def mesh_error(theta: float, e: Vector) -> tuple[float, float]:
    """Return phi/i - theta that the teeth force at a joint angle, rad, and its derivative by the
    angle.
    """
    if e[MESH_AMPLITUDE] == 0.0:
        return 0.0, 0.0
    at = e[MESH_ORDER] * theta + e[MESH_PHASE]
    return e[MESH_AMPLITUDE] * math.sin(at), e[MESH_AMPLITUDE] * e[MESH_ORDER] * math.cos(at)
