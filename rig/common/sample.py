"""Sample of one control cycle: checked, recorded, and later used for identification."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple


class Sample(NamedTuple):
    """One cycle in SI units; the field order is the order of the tags in the recording.

    ``command`` is the target that the cycle sent; all other values were latched at the SYNC of this
    cycle.

    Attributes:
        time: Start of the cycle since the start of the run, s.
        host_time: Time at which the answer was complete, by the host's clock, since the start of
            the run, s.
        device_time: The drive's own time stamp, s.
        encoder_time: The encoder's own time stamp, s.
        command: Target joint angle, rad.
        motor_angle: Angle of the motor shaft, rad.
        angle: Joint angle by the joint encoder, rad.
        velocity: Joint speed as the drive estimates it, rad/s.
        current: Motor current, mean over the cycle that ends here, A.
        voltage: Motor voltage, mean over the cycle that ends here, V.
        supply_voltage: Supply voltage, V.
        temperature: Temperature of the drive, deg C.
        following_error: Command minus joint angle as the drive computes it, rad.
        statusword: Object 6041h.
        segment: Number of the excitation in the run, from 1; 0 outside an excitation.
        fresh: 1 if every part of the answer arrived in this cycle; 0 if values are those of the
            last good answer.
        pressure: Pressure in the gas generator's chamber, Pa. Not a number on a bench without a
            transmitter.
    """

    time: float
    host_time: float
    device_time: float
    encoder_time: float
    command: float
    motor_angle: float
    angle: float
    velocity: float
    current: float
    voltage: float
    supply_voltage: float
    temperature: float
    following_error: float
    statusword: int
    segment: int
    fresh: bool
    pressure: float = math.nan


class Phase(Enum):
    """Phase of a run. The drive is energised only from ENABLE to RELEASE."""

    LOAD = "load"
    PREPARE = "prepare"
    ENABLE = "enable"
    FIRST_PASS = "first pass"
    WEIGH = "weight check"
    APPROACH = "approach"
    SETTLE = "settle"
    EXCITE = "excite"
    HOLD = "hold"
    RELEASE = "release"
    BOUNDARY = "between stages"
    FINISHED = "finished"
