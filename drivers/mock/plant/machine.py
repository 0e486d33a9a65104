"""The simulated machine with its servo loops: advance it in time, latch what its sensors see."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drivers.mock.plant import constants


class Reading(NamedTuple):
    """What drive and joint encoder see at one instant.

    ``current_A`` and ``voltage_V`` are means since the previous latch; the others are values at the instant.
    """

    motor_counts: int
    joint_counts: int
    motor_velocity_rad_s: float
    current_A: float
    voltage_V: float
    supply_V: float
    temperature_C: float
    following_error_counts: float


class SimulatedMachine:
    """Motor, gear, friction, lever with weights and the drive's loops, integrated with a fixed step."""

    def __init__(self, machine: constants.Machine, rng: np.random.Generator) -> None:
        self.constants = machine
        self.loop_ns = round(1e9 / machine.loops.rate_Hz)

    def hang(self, mass_kg: float) -> None:
        """Hang a total of ``mass_kg`` on the lever (eq. 17)."""
        raise NotImplementedError

    def power(self, on: bool) -> None:
        """Switch the power stage. Off: the motor is open-circuit and coasts."""
        raise NotImplementedError

    def track(self, target_counts: float, over_ns: int) -> None:
        """Follow ``target_counts`` (motor encoder), reached by linear interpolation ``over_ns`` from now."""
        raise NotImplementedError

    def brake(self, deceleration_rad_s2: float) -> None:
        """Ramp the commanded joint speed to zero at this deceleration and hold there (quick stop)."""
        raise NotImplementedError

    def advance(self, duration_ns: int) -> None:
        """Integrate for a whole number of loop periods."""
        raise NotImplementedError

    def latch(self) -> Reading:
        """Return what the sensors see now and start new means for current and voltage."""
        raise NotImplementedError
