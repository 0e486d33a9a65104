"""Converts limits held in the drive between its objects and SI units at the joint."""

from __future__ import annotations

import math
from typing import Final

from drivers.errors import ConfigurationError
from drivers.interfaces import LimitSteps, ServoLimits
from drivers.objects import ObjectAccess, ObjectAddress
from drivers.units import ServoScales

POSITION_MIN: Final = (0x607D, 1)
POSITION_MAX: Final = (0x607D, 2)
MAX_SPEED: Final = (0x607F, 0)
MAX_TORQUE: Final = (0x6072, 0)
MAX_CURRENT: Final = (0x6073, 0)
FOLLOWING_WINDOW: Final = (0x6065, 0)
QUICK_STOP_OPTION: Final = (0x605A, 0)
QUICK_STOP_DECELERATION: Final = (0x6085, 0)
WINDOW_OFF: Final = 0xFFFFFFFF
OBJECTS: Final = (
    *(POSITION_MIN, POSITION_MAX, MAX_SPEED, MAX_TORQUE, MAX_CURRENT),
    *(FOLLOWING_WINDOW, QUICK_STOP_OPTION, QUICK_STOP_DECELERATION),
)
"""All of them."""


def encode(limits: ServoLimits, scales: ServoScales) -> dict[ObjectAddress, int]:
    """Return the object values that hold ``limits``, each rounded to the drive's unit and never to
    a wider limit.
    """
    first, last = sorted(
        (angle - scales.offset_rad) / scales.joint_rad_per_count
        for angle in (limits.angle_min_rad, limits.angle_max_rad)
    )
    window = limits.following_error_rad
    speed = scales.joint_speed_unit_rad_s
    return {
        POSITION_MIN: -_whole(-first),
        POSITION_MAX: _whole(last),
        MAX_SPEED: _whole(limits.speed_rad_s / speed),
        MAX_TORQUE: _whole(limits.torque_N_m / scales.joint_torque_unit_N_m),
        MAX_CURRENT: _whole(limits.current_A / scales.current_unit_A),
        FOLLOWING_WINDOW: WINDOW_OFF
        if window is None
        else _whole(window / abs(scales.joint_rad_per_count)),
        QUICK_STOP_OPTION: limits.quick_stop_option,
        QUICK_STOP_DECELERATION: round(limits.quick_stop_deceleration_rad_s2 / speed),
    }


def decode(values: dict[ObjectAddress, int], scales: ServoScales) -> ServoLimits:
    """Return the limits that the object values hold."""
    ends = sorted(
        (scales.joint_angle_rad(values[POSITION_MIN]), scales.joint_angle_rad(values[POSITION_MAX]))
    )
    window = values[FOLLOWING_WINDOW]
    speed = scales.joint_speed_unit_rad_s
    return ServoLimits(
        angle_min_rad=ends[0],
        angle_max_rad=ends[1],
        speed_rad_s=values[MAX_SPEED] * speed,
        torque_N_m=values[MAX_TORQUE] * scales.joint_torque_unit_N_m,
        current_A=values[MAX_CURRENT] * scales.current_unit_A,
        following_error_rad=None
        if window == WINDOW_OFF
        else window * abs(scales.joint_rad_per_count),
        quick_stop_option=values[QUICK_STOP_OPTION],
        quick_stop_deceleration_rad_s2=values[QUICK_STOP_DECELERATION] * speed,
    )


def steps(scales: ServoScales) -> LimitSteps:
    """Return one unit of each object, at the joint."""
    count, speed = abs(scales.joint_rad_per_count), scales.joint_speed_unit_rad_s
    return LimitSteps(
        count, speed, scales.joint_torque_unit_N_m, scales.current_unit_A, count, speed
    )


def _whole(units: float) -> int:
    # The margin keeps a value that was a whole number of units unchanged.
    return math.floor(units + 1e-6)


def read(drive: ObjectAccess, scales: ServoScales) -> ServoLimits:
    """Read the limits a drive holds."""
    return decode({address: drive.read(*address) for address in OBJECTS}, scales)


def write(drive: ObjectAccess, scales: ServoScales, limits: ServoLimits) -> None:
    """Write limits into a drive and verify each by reading back.

    Raises:
        ConfigurationError: The drive holds another value, or one does not fit its object.
        ObjectAccessError: The drive refuses one.
    """
    for address, value in encode(limits, scales).items():
        store(drive, address, value)


def store(drive: ObjectAccess, address: ObjectAddress, value: int) -> None:
    """Write one object and verify it; raises as :func:`write`.

    What the drive holds already is not written, as it may be fixed there.
    """
    if drive.read(*address) == value:
        return
    drive.write(*address, value)
    found = drive.read(*address)
    if found != value:
        raise ConfigurationError(
            f"object {address[0]:04X}h:{address[1]:02X}h reads {found} after writing {value}: "
            "the drive does not take this setting; check its range in the manual"
        )
