"""Computes the gains of a world's drive, for plants whose drive has position, velocity and current
loops.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from benchmarks.worlds.world import World

SOFT_DAMPING = 0.8
"""Damping ratio of a ``pd`` loop."""
RESET = 5.0
"""Ratio of the velocity loop's bandwidth to the corner frequency of its integral part."""
FILTER = 4.0
"""Ratio of the corner frequency of the speed filter to the bandwidth of the velocity loop."""


class Gains(NamedTuple):
    """Gains of the loops, at the joint.

    Attributes:
        position: For a cascade, speed per position error, 1/s; else stiffness, N m/rad.
        velocity: Torque per speed error, or damping, N m s/rad.
        integral: For a cascade, rate of change of the torque per speed error, N m/rad.
        filter_rad_s: Corner frequency of the filter of the measured speed.
        current: Voltage per current error, V/A.
        current_integral: Rate of change of the voltage per current error, V/(A s).
    """

    position: float
    velocity: float
    integral: float
    filter_rad_s: float
    current: float
    current_integral: float


def gains(world: World) -> Gains:
    """Return the gains of the drive, or of the host that computes the drive's torque.

    A ``pd`` loop needs an angle error to overcome the static friction. This angle error is
    inversely proportional to the gain of the position loop; the gain is chosen so that the angle
    error is a third of the
    amplitude of the smallest motion if the bandwidth of the position loop is 1 Hz.
    """
    drive, motor, J = world.drive, world.motor, world.constants.J
    omega = 2.0 * math.pi * drive.velocity_Hz
    integral = 0.0
    if drive.kind == "cascade":
        position, velocity = 2.0 * math.pi * drive.position_Hz, J * omega
        integral = J * omega**2 / RESET
    elif drive.kind in ("host", "torque"):
        position, velocity = world.host_law
    else:
        position = 3.0 * drive.position_Hz * world.holding_N_m / world.smallest_rad
        velocity = 2.0 * SOFT_DAMPING * math.sqrt(position * J)
    wide = 2.0 * math.pi * drive.current_Hz
    return Gains(
        position,
        velocity,
        integral,
        FILTER * omega,
        motor.inductance_H * wide,
        motor.resistance_ohm * wide,
    )
