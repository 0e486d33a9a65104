"""Computes the gains of a world's drive, for plants that have the drive's usual loops."""

from __future__ import annotations

import math
from typing import NamedTuple

from rig.results.prove.worlds.world import World

SOFT_DAMPING = 0.8
"""Damping ratio of a ``pd`` loop."""
RESET = 5.0
"""Bandwidth of the velocity loop over the corner of its integral."""
FILTER = 4.0
"""Corner of the filter of the measured speed over the bandwidth of the velocity loop."""


class Gains(NamedTuple):
    """Gains of the loops, at the joint.

    Attributes:
        position: Of a cascade, speed over position error, 1/s; else stiffness, N m/rad.
        velocity: Torque over speed error, or damping, N m s/rad.
        integral: Rate of the torque over speed error of a cascade, N m/rad.
        filter_rad_s: Corner of the filter of the measured speed.
        current: Voltage over current error, V/A.
        current_integral: Rate of that voltage, V/(A s).
    """

    position: float
    velocity: float
    integral: float
    filter_rad_s: float
    current: float
    current_integral: float


def gains(world: World) -> Gains:
    """Return the gains of the drive, or of the host that computes its torque.

    A ``pd`` loop needs an angle error to overcome the static friction. This angle error is
    inversely proportional to the gain, and is a third of the amplitude of the smallest motion with
    a position loop of 1 Hz.
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
