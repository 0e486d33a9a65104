"""Injected load effects at the joint: imbalance, spring, end stop, and contact force factor."""

from __future__ import annotations

import math

from drivers.mock.plant.effects.table import (
    GRAVITY_TORQUE,
    GRAVITY_ZERO,
    LOAD_SLOPE,
    SPRING_REST,
    SPRING_STIFFNESS,
    STOP_ANGLE,
    STOP_OTHER,
    STOP_STIFFNESS,
    SWING_DECAY,
    SWING_FRACTION,
    SWING_FREQUENCY,
)
from drivers.mock.plant.parts.compiled import Vector, inlined

_STOP_DAMPING_S = 2e-3
"""Ratio of an end stop's damping to its stiffness, s, which is assumed for a rubber pad."""


@inlined
def device_torque(theta: float, omega: float, e: Vector) -> float:
    """Return the torque of imbalance, spring and end stop on the joint, N m.

    A stop pushes only away from itself. One stop acts beyond ``angle_rad``, in the direction of the
    sign of ``angle_rad``. With a second stop (``other_rad``, 0 for none) the first stop acts above
    ``angle_rad`` and the second stop below ``other_rad``.
    """
    torque = 0.0
    if e[GRAVITY_TORQUE] != 0.0:
        torque -= e[GRAVITY_TORQUE] * math.sin(theta - e[GRAVITY_ZERO])
    if e[SPRING_STIFFNESS] != 0.0:
        torque -= e[SPRING_STIFFNESS] * (theta - e[SPRING_REST])
    if e[STOP_STIFFNESS] != 0.0:
        side = math.copysign(1.0, e[STOP_ANGLE]) if e[STOP_OTHER] == 0.0 else 1.0
        depth = side * (theta - e[STOP_ANGLE])
        if depth > 0.0:
            torque -= side * max(e[STOP_STIFFNESS] * (depth + _STOP_DAMPING_S * side * omega), 0.0)
        if e[STOP_OTHER] != 0.0 and theta < e[STOP_OTHER]:
            depth = e[STOP_OTHER] - theta
            torque += max(e[STOP_STIFFNESS] * (depth - _STOP_DAMPING_S * omega), 0.0)
    return torque


@inlined
def load_factor(theta: float, time: float, e: Vector) -> float:
    """Return the ratio of the contact force to that of the weight at rest, at an angle and a
    time since power-on.
    """
    factor = 1.0
    if e[LOAD_SLOPE] != 0.0:
        factor = max(1.0 + e[LOAD_SLOPE] * theta, 0.0)
    if e[SWING_FRACTION] != 0.0:
        swing = math.cos(2.0 * math.pi * e[SWING_FREQUENCY] * time) * math.exp(
            -time / e[SWING_DECAY]
        )
        factor *= 1.0 + e[SWING_FRACTION] * swing
    return factor
