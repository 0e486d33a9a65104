"""Injected elastic transmission: two masses with backlash, spring and hysteresis.

All quantities are at the joint: ``twist`` is phi/i - theta.
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
"""Default stiffness of teeth and shaft; a torque of 20 N m twists the shaft by 20 microradian, one
count of the encoder.
"""
DAMPING_RATIO = 0.08
"""Assumed damping ratio of the oscillation of rotor against joint on the spring of the shaft."""


@inlined
def stiffness_of(e: Vector) -> float:
    """Return the shaft's stiffness, N m/rad."""
    return e[STIFFNESS] if e[STIFFNESS] > 0.0 else HARD_N_M_RAD


@inlined
def shaft_torque(twist: float, rate: float, given: float, damping: float, e: Vector) -> float:
    """Return the torque that the shaft transmits from rotor to joint.

    Teeth can only push, so that damping does not reverse the torque of a closed gap.

    Args:
        twist: Twist, rad.
        rate: Rate of the twist without that of the coupling, rad/s.
        given: Deflection in the coupling's hysteresis, rad.
        damping: Damping, N m s/rad.
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
    """Return the deflection in the coupling's hysteresis for the present play state, rad."""
    most = e[HYSTERESIS_DEFLECTION]
    return float(most * min(max(play / e[HYSTERESIS_TORQUE], -1.0), 1.0)) if most > 0.0 else 0.0


@inlined
def give_way(twist: float, play: float, e: Vector) -> tuple[float, float]:
    """Return the deflection, rad, and the state of the play operator, N m, of a coupling with
    hysteresis in series with the shaft's spring.

    The coupling is rate-independent and dissipative. A play operator of half width ``torque_Nm``
    follows the torque. The deflection is proportional to the output of the operator,
    ``deflection_rad`` for ``torque_Nm``, and at most +- ``deflection_rad``. Deflection and torque
    are solved together in closed form, because the spring is stiff.

    Args:
        twist: Twist of spring and coupling, rad.
        play: Previous state of the play operator, N m.
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
    """Return the mesh error phi/i - theta at a joint angle, rad, and its derivative with respect to
    the angle.
    """
    if e[MESH_AMPLITUDE] == 0.0:
        return 0.0, 0.0
    at = e[MESH_ORDER] * theta + e[MESH_PHASE]
    return e[MESH_AMPLITUDE] * math.sin(at), e[MESH_AMPLITUDE] * e[MESH_ORDER] * math.cos(at)
