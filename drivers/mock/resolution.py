"""Resolution of the motor encoder, as a drive states it in object 608Fh."""

from __future__ import annotations

import math

from drivers.mock.plant.parts import constants


def encoder_resolution(machine: constants.Machine) -> tuple[int, int]:
    """Return a number of motor encoder increments and the corresponding motor turns (608Fh).

    With an exact sensor the machine counts microradians of the joint; with 100 turns this ratio is
    exact to about 1e-9.
    """
    counts = machine.sensing.motor_counts_per_turn
    if counts:
        return counts, 1
    return round(2e8 * math.pi / machine.motor.gear_ratio), 100
