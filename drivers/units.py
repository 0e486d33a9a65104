"""Conversion between device units and SI, with the bench's gear ratio, sign and zero."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Final

from drivers.errors import ConfigurationError, DeviceError, ObjectAccessError
from drivers.objects import ObjectAccess, ObjectAddress

RATED: Final = ((0x6075, 0), (0x6076, 0))
"""Rated current and rated torque, mA and mN m."""
_NO_OBJECT: Final = 0x06020000
_TOLERANCE: Final = 1e-3
_MILLI: Final = 1e-3


@dataclass(frozen=True)
class ServoScales:
    """Units of one drive according to the bench file.

    Attributes:
        counts_per_turn: Counts of 6064h per motor turn.
        gear_ratio: Motor turns per joint turn.
        rated_current_A: Expected value of 6075h; 6078h is in per mille of it.
        rated_torque_N_m: Expected value of 6076h; 6072h is in per mille of it.
        sign: 1 where positive counts are a positive joint angle, else -1.
        offset_rad: Joint angle at position 0.
        velocity_unit_rad_s: Motor speed of one unit of 606Ch, 607Fh and, per second, 6085h; None
            for one count per second.
        voltage_object: Object of the mean motor voltage.
        voltage_unit_V: Unit of that object, V.
        temperature_object: Object of the drive's temperature.
        temperature_unit_C: Unit of that object, deg C.
    """

    counts_per_turn: float
    gear_ratio: float
    rated_current_A: float
    rated_torque_N_m: float
    sign: int = 1
    offset_rad: float = 0.0
    velocity_unit_rad_s: float | None = None
    voltage_object: ObjectAddress = (0x2100, 0)
    voltage_unit_V: float = 0.01
    temperature_object: ObjectAddress = (0x2101, 0)
    temperature_unit_C: float = 0.1

    def __post_init__(self) -> None:
        """Refuse invalid scales.

        Raises:
            ConfigurationError: A scale is not positive, or the sign is not 1 or -1.
        """
        for name in ("counts_per_turn", "gear_ratio", "rated_current_A", "rated_torque_N_m"):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise ConfigurationError(
                    f"{name} is {value}, must be positive: correct the bench file"
                )
        if self.sign not in (1, -1):
            raise ConfigurationError(
                f"sign is {self.sign}, must be 1 or -1: correct the bench file"
            )

    @cached_property
    def motor_rad_per_count(self) -> float:
        """Motor angle of one count, with sign."""
        return self.sign * 2.0 * math.pi / self.counts_per_turn

    @cached_property
    def joint_rad_per_count(self) -> float:
        """Joint angle of one count, with sign."""
        return self.motor_rad_per_count / self.gear_ratio

    @cached_property
    def joint_speed_unit_rad_s(self) -> float:
        """Joint speed of one velocity unit, without sign."""
        unit = self.velocity_unit_rad_s or 2.0 * math.pi / self.counts_per_turn
        return unit / self.gear_ratio

    @cached_property
    def current_unit_A(self) -> float:
        """Current of one unit of 6078h, without sign."""
        return self.rated_current_A / 1000.0

    @cached_property
    def joint_torque_unit_N_m(self) -> float:
        """Joint torque of one unit of 6072h, without sign."""
        return self.rated_torque_N_m * self.gear_ratio / 1000.0

    def joint_angle_rad(self, counts: int) -> float:
        """Return the joint angle at a motor position."""
        return counts * self.joint_rad_per_count + self.offset_rad

    def counts(self, joint_angle_rad: float) -> int:
        """Return the motor position of a joint angle, to the nearest count."""
        return round((joint_angle_rad - self.offset_rad) / self.joint_rad_per_count)

    def mismatches(self, drive: ObjectAccess) -> Iterator[DeviceError]:
        """Yield differences of the scales from the drive's own values: 6075h, 6076h and 608Fh, if
        present.

        Values count as equal within 0.1 % or within one unit of the object, as drives may round. An
        object that the drive refuses is yielded as well.

        Raises:
            LinkError: No answer.
        """
        current, torque = RATED
        for what, address, bench, unit in (
            ("rated current, 6075h", current, self.rated_current_A, "A"),
            ("rated torque, 6076h", torque, self.rated_torque_N_m, "N m"),
        ):
            yield from _compare(
                what, partial(_milli, drive, address), bench, unit, resolution=_MILLI
            )
        what, unit = "encoder resolution, 608Fh", "counts per motor turn"
        for error in _compare(what, lambda: _resolution(drive), self.counts_per_turn, unit):
            if not isinstance(error, ObjectAccessError) or error.code != _NO_OBJECT:
                yield error


def _milli(drive: ObjectAccess, address: ObjectAddress) -> float:
    return drive.read(*address) * _MILLI


def _resolution(drive: ObjectAccess) -> float:
    increments, turns = drive.read(0x608F, 1), drive.read(0x608F, 2)
    return increments / turns if turns else math.inf


def _compare(
    what: str, read: Callable[[], float], bench: float, unit: str, resolution: float = 0.0
) -> Iterator[DeviceError]:
    try:
        device = read()
    except (ConfigurationError, ObjectAccessError) as error:
        yield error
        return
    # The margin keeps a difference of one whole unit at one unit.
    if abs(device - bench) > max(_TOLERANCE * abs(bench), resolution * (1.0 + 1e-6)):
        yield ConfigurationError(
            f"{what}: the drive says {device:g} {unit}, the bench file {bench:g} {unit}; "
            "correct the bench file, or check that this is the right drive"
        )


@dataclass(frozen=True)
class EncoderScales:
    """Units of one joint encoder according to the bench file.

    Attributes:
        counts_per_turn: Expected value of 6001h.
        sign: 1 if rising counts are a rising joint angle, else -1.
        offset_rad: Joint angle at 6004h = 0.
        middle_rad: Middle of the joint's travel, to which the first angle is taken as near as the
            encoder's range allows; None for the angle at 6004h = 0.
    """

    counts_per_turn: int
    sign: int = 1
    offset_rad: float = 0.0
    middle_rad: float | None = None

    def __post_init__(self) -> None:
        """Refuse invalid scales.

        Raises:
            ConfigurationError: The resolution is not positive, or the sign is not 1 or -1.
        """
        if self.counts_per_turn <= 0:
            raise ConfigurationError(f"counts_per_turn is {self.counts_per_turn}, must be positive")
        if self.sign not in (1, -1):
            raise ConfigurationError(
                f"sign is {self.sign}, must be 1 or -1: correct the bench file"
            )

    @cached_property
    def rad_per_count(self) -> float:
        """Joint angle of one count, with sign."""
        return self.sign * 2.0 * math.pi / self.counts_per_turn

    @cached_property
    def middle(self) -> int:
        """Count of the middle of the joint's travel; 0 where none is given."""
        if self.middle_rad is None:
            return 0
        return round((self.middle_rad - self.offset_rad) / self.rad_per_count)


def nearest(value: int, modulus: int, near: int) -> int:
    """Return the count nearest to ``near`` that equals ``value`` modulo ``modulus``.

    The lower one of two that are equally near is returned.
    """
    half = modulus // 2
    return near + (value - near + half) % modulus - half


class Unwrapper:
    """Unwraps a counter modulo ``modulus``.

    Each new value is unwrapped to the nearest to the last one, so the counter must move less than
    half its range between calls. The first value is unchanged or, with ``near``, the nearest to
    that count.
    """

    def __init__(self, modulus: int, near: int | None = None) -> None:
        self._modulus = modulus
        self._half = modulus // 2
        self._total = near

    def update(self, raw: int) -> int:
        """Return the unwrapped count for a new raw value."""
        total = self._total
        if total is None:
            total = raw
        modulus = self._modulus
        step = (raw - total) % modulus
        if step > self._half:
            step -= modulus
        self._total = total + step
        return self._total
