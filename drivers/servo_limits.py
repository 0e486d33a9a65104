"""Converts the limits that are stored in a drive between its objects and SI units at the joint."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from drivers.errors import (
    ConfigurationError,
    DeviceError,
    LimitError,
    NotDescribedError,
    ObjectAccessError,
    RangeError,
)
from drivers.interfaces import LimitSteps, ServoLimits
from drivers.objects import ObjectAccess, ObjectAddress, ProcessChannel, optional, problem_of
from drivers.units import ServoScales

POSITION_MIN: Final = (0x607D, 1)
POSITION_MAX: Final = (0x607D, 2)
MAX_SPEED: Final = (0x607F, 0)
MAX_TORQUE: Final = (0x6072, 0)
MAX_CURRENT: Final = (0x6073, 0)
FOLLOWING_WINDOW: Final = (0x6065, 0)
QUICK_STOP_OPTION: Final = (0x605A, 0)
QUICK_STOP_DECELERATION: Final = (0x6085, 0)
PROFILE_SPEED: Final = (0x6081, 0)
PROFILE_ACCELERATION: Final = (0x6083, 0)
PROFILE_DECELERATION: Final = (0x6084, 0)
WINDOW_OFF: Final = 0xFFFFFFFF
NO_OPTION: Final = -1
"""Value that stands for the quick stop option of a drive without an object for this option."""
FIELDS: Final[Mapping[ObjectAddress, tuple[str, str]]] = {
    POSITION_MIN: ("angle_min_rad", "lower end of the joint angle"),
    POSITION_MAX: ("angle_max_rad", "upper end of the joint angle"),
    MAX_SPEED: ("speed_rad_s", "joint speed"),
    MAX_TORQUE: ("torque_N_m", "joint torque"),
    MAX_CURRENT: ("current_A", "motor current"),
    FOLLOWING_WINDOW: ("following_error_rad", "following error"),
    QUICK_STOP_OPTION: ("quick_stop_option", "quick stop option"),
    QUICK_STOP_DECELERATION: ("quick_stop_deceleration_rad_s2", "quick stop deceleration"),
}
"""Object to the field of :class:`ServoLimits` that it stores, and to the name of the limit."""
OBJECTS: Final = tuple(FIELDS)  # all objects that store limits
_ENDS: Final = {POSITION_MIN: POSITION_MAX, POSITION_MAX: POSITION_MIN}
_COUNTS: Final = ("machine.gear_ratio", "servo.counts_per_motor_turn")
_SPEEDS: Final = ("machine.gear_ratio", "servo.velocity_unit")
_RAMPS: Final = ("machine.gear_ratio", "servo.acceleration_unit_rad_s2")
_KEYS: Final[Mapping[ObjectAddress, tuple[str, ...]]] = {
    POSITION_MIN: ("limits.angle_min_deg", *_COUNTS, "servo.offset_deg"),
    POSITION_MAX: ("limits.angle_max_deg", *_COUNTS, "servo.offset_deg"),
    MAX_SPEED: ("limits.speed_deg_s", *_SPEEDS),
    MAX_TORQUE: ("limits.torque_N_m", "machine.gear_ratio", "servo.rated_torque_N_m"),
    MAX_CURRENT: ("limits.current_A", "servo.rated_current_A"),
    FOLLOWING_WINDOW: ("limits.following_error_deg", *_COUNTS),
    QUICK_STOP_OPTION: ("servo.quick_stop_option",),
    QUICK_STOP_DECELERATION: ("servo.quick_stop_deceleration_deg_s2", *_RAMPS),
    PROFILE_SPEED: ("limits.speed_deg_s", *_SPEEDS),
    PROFILE_ACCELERATION: ("servo.profile_acceleration_deg_s2", *_RAMPS),
    PROFILE_DECELERATION: ("servo.profile_acceleration_deg_s2", *_RAMPS),
}
"""Object to the keys of the bench file of its value: first the limit, then its units."""
_UNITS: Final = {
    "deg": ("deg", math.degrees(1.0)),
    "deg_s": ("deg/s", math.degrees(1.0)),
    "deg_s2": ("deg/s^2", math.degrees(1.0)),
    "N_m": ("N m", 1.0),
    "A": ("A", 1.0),
    "option": ("", 1.0),
}
"""End of a key to its unit, and to the factor from SI."""


def _units(scales: ServoScales) -> dict[ObjectAddress, float]:
    """Return what one unit of each object is at the joint, in SI units."""
    count, speed = scales.joint_rad_per_count, scales.joint_speed_unit_rad_s
    ramp = scales.joint_acceleration_unit_rad_s2
    return {
        POSITION_MIN: count,
        POSITION_MAX: count,
        MAX_SPEED: speed,
        MAX_TORQUE: scales.joint_torque_unit_N_m,
        MAX_CURRENT: scales.current_unit_A,
        FOLLOWING_WINDOW: abs(count),
        QUICK_STOP_OPTION: 1.0,
        QUICK_STOP_DECELERATION: ramp,
        PROFILE_SPEED: speed,
        PROFILE_ACCELERATION: ramp,
        PROFILE_DECELERATION: ramp,
    }


def _at_joint(address: ObjectAddress, scales: ServoScales) -> ObjectAddress:
    """Exchange the ends of the angle if the drive has a negative sign."""
    return _ENDS.get(address, address) if scales.sign < 0 else address


def encode(limits: ServoLimits, scales: ServoScales) -> dict[ObjectAddress, int]:
    """Return the object values that store ``limits``, each rounded to the unit of the drive such
    that no limit becomes wider and the quick stop no weaker. A limit of NaN is omitted.
    """
    units = _units(scales)
    encoded: dict[ObjectAddress, int] = {}
    for address in FIELDS:
        limit = getattr(limits, FIELDS[_at_joint(address, scales)][0])
        if limit is None:
            encoded[address] = WINDOW_OFF
            continue
        value = (limit - (scales.offset_rad if address in _ENDS else 0.0)) / units[address]
        if math.isnan(value):
            continue
        upward = address in (POSITION_MIN, QUICK_STOP_DECELERATION)
        encoded[address] = -_whole(-value) if upward else _whole(value)
    if limits.quick_stop_deceleration_rad_s2 > 0.0:
        # A drive with 0 does not brake.
        encoded[QUICK_STOP_DECELERATION] = max(1, encoded[QUICK_STOP_DECELERATION])
    return encoded


def decode(values: Mapping[ObjectAddress, int], scales: ServoScales) -> ServoLimits:
    """Return the limits that the object values store; a limit that the drive lacks is NaN."""
    found: dict[str, Any] = {
        FIELDS[_at_joint(address, scales)][0]: value_at(address, values[address], scales)
        if address in values
        else math.nan
        for address in FIELDS
    }
    found["quick_stop_option"] = values.get(QUICK_STOP_OPTION, NO_OPTION)
    if values.get(FOLLOWING_WINDOW) == WINDOW_OFF:
        found["following_error_rad"] = None
    return ServoLimits(**found)


def steps(scales: ServoScales) -> LimitSteps:
    """Return the resolution of each limit: one unit of its object, at the joint."""
    units = _units(scales)
    objects = (POSITION_MIN, MAX_SPEED, MAX_TORQUE, MAX_CURRENT, FOLLOWING_WINDOW)
    return LimitSteps(*(abs(units[at]) for at in (*objects, QUICK_STOP_DECELERATION)))


def _whole(units: float) -> int:
    # The margin ensures that a value of a whole number of units is not changed by a rounding error.
    return math.floor(units + 1e-6)


def value_at(address: ObjectAddress, units: int, scales: ServoScales) -> float:
    """Return the limit that a value of a limit object stands for, at the joint, in SI units."""
    return units * _units(scales)[address] + (scales.offset_rad if address in _ENDS else 0.0)


def named(
    address: ObjectAddress, value: int, scales: ServoScales, error: DeviceError
) -> DeviceError:
    """Return an error that names the keys from which a refused value was computed."""
    if isinstance(error, NotDescribedError):
        return error
    key, *units = keys = _KEYS[_at_joint(address, scales)]
    unit, factor = next(row for end, row in _UNITS.items() if key.endswith(f"_{end}"))

    def at(units: int) -> float:
        return factor * value_at(address, units, scales)

    words = f"it is {key}, {at(value):.5g} {unit}".rstrip()
    if isinstance(error, RangeError):
        low, high = sorted((at(error.low), at(error.high)))
        words += f", and this drive can hold {low:.5g} to {high:.5g} {unit}".rstrip()
    words += f": change {key}" + (f", or correct {' or '.join(units)}" if units else "")
    if isinstance(error, ObjectAccessError):
        return ObjectAccessError(
            error.index, error.subindex, error.code, f"{error.message}; {words}"
        )
    return LimitError(keys, f"{error}; {words}")


def read(
    drive: ObjectAccess, scales: ServoScales, held: Sequence[ObjectAddress] = OBJECTS
) -> ServoLimits:
    """Read the limits that are stored in a drive, from those limit objects that the drive has."""
    found = {address: optional(drive.read, *address) for address in held}
    return decode({at: value for at, value in found.items() if value is not None}, scales)


def write(
    drive: ObjectAccess,
    scales: ServoScales,
    limits: ServoLimits,
    held: Sequence[ObjectAddress] = OBJECTS,
) -> None:
    """Write limits into those limit objects that a drive has, and verify each by reading it back.

    Raises:
        LimitError: A value that is read back differs from the written value, or a value does not
            fit into its object.
        ObjectAccessError: The drive refuses a value.
    """
    for address, value in encode(limits, scales).items():
        if address in held:
            store_limit(drive, scales, address, value)


def store_limit(
    drive: ObjectAccess, scales: ServoScales, address: ObjectAddress, value: int
) -> None:
    """Write one limit object and read it back; errors as of :func:`write`."""
    for error in problem_of(store, drive, address, value):
        raise named(address, value, scales, error) from error


def problems(
    drive: ProcessChannel, scales: ServoScales, values: Iterable[tuple[ObjectAddress, int]]
) -> Iterator[DeviceError]:
    """Yield an error for each value that does not fit into its object. Nothing is sent."""
    for address, value in values:
        for error in problem_of(drive.require_fit, *address, value):
            yield named(address, value, scales, error)


def store(drive: ObjectAccess, address: ObjectAddress, value: int) -> None:
    """Write one object and verify it by reading it back; an error names the
    object.

    A value that the object already has is not written, because the object may be read-only.
    """
    if drive.read(*address) == value:
        return
    drive.write(*address, value)
    found = drive.read(*address)
    if found != value:
        raise ConfigurationError(
            f"object {address[0]:04X}h:{address[1]:02X}h reads {found} after {value} was written: "
            "the drive does not accept this value; look up the range of the object in its manual"
        )
