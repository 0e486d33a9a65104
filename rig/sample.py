"""What one control cycle leaves behind: the row that is checked, recorded and later identified from."""

from __future__ import annotations

import math
from typing import NamedTuple


class Sample(NamedTuple):
    """One cycle in SI units; the field order is the order of the tags in the recording.

    ``command`` is the target that the cycle sent; everything else was latched at that cycle's SYNC. ``current`` and
    ``voltage`` are means over the cycle that ends there. ``command``, ``angle``, ``velocity`` and ``following_error``
    are at the joint, ``motor_angle``, ``current`` and ``voltage`` at the motor.

    Attributes:
        time: Start of the cycle since the start of the run, s.
        host_time: When the answer had been collected, by the host's clock since the start of the run, s.
        device_time: The drive's own time stamp, s.
        encoder_time: The encoder's own time stamp, s.
        command: Target joint angle, rad.
        motor_angle: Motor shaft, rad.
        angle: Joint encoder, rad.
        velocity: Joint speed as the drive estimates it, rad/s.
        current: A.
        voltage: V at the motor.
        supply_voltage: V.
        temperature: deg C.
        following_error: rad, as the drive computes it.
        statusword: Object 6041h.
        segment: 0 outside an excitation, else the 1-based number of the stage repeat.
        fresh: Whether every part of the answer arrived this cycle; if not, the values are the last good ones.
        pressure: In the gas generator's chamber, Pa; NaN on a bench without a transmitter.
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
