"""Conversion between units of devices and SI units, with gear ratio, sign and zero of the bench."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from drivers.errors import ConfigurationError, DeviceError, ObjectAccessError
from drivers.objects import ObjectAccess, ObjectAddress, optional

RATED: Final = ((0x6075, 0), (0x6076, 0))
"""Objects of the rated current, mA, and of the rated torque, mN m."""
_TOLERANCE: Final = 1e-3


@dataclass(frozen=True)
class ServoScales:
    """Units of one drive according to the bench file."""

    counts_per_turn: float  # counts of 6064h per motor turn
    gear_ratio: float  # motor turns per joint turn
    # Expected value of 6075h, the rated current; 6078h is in per mille of this current.
    rated_current_A: float
    # Expected value of 6076h, the rated torque; 6072h is in per mille of this torque.
    rated_torque_N_m: float
    sign: int = 1  # 1 if positive counts are a positive joint angle, else -1
    offset_rad: float = 0.0  # joint angle at position 0
    current_sign: int = 1  # -1 if the drive's current has the opposite sign of its torque, else 1
    # Current that the drive reports without current, after both signs.
    current_offset_A: float = 0.0
    # Motor speed of one unit of 606Ch and 607Fh, or None for one count per second.
    velocity_unit_rad_s: float | None = None
    # Motor acceleration of one unit of 6083h, 6084h, 6085h and 609Ah, or None for one unit of the
    # speed per second.
    acceleration_unit_rad_s2: float | None = None
    # Object of the mean motor voltage, or None if unknown.
    voltage_object: ObjectAddress | None = None
    voltage_unit_V: float = 0.01  # unit of this object, V
    # Object of the drive's temperature, or None if unknown.
    temperature_object: ObjectAddress | None = None
    temperature_unit_C: float = 0.1  # unit of this object, deg C
    supply_object: ObjectAddress = (0x6079, 0)  # object of the supply voltage
    supply_unit_V: float = 1e-3  # unit of this object, V
    # The maker's own object of the motor current, or None for 6078h or, without 6078h, for 6077h.
    current_object: ObjectAddress | None = None
    named_current_unit_A: float = 1e-3  # unit of the maker's own object, A
    # Motor torque per ampere, for drives that report torque and no current, or None for the ratio
    # of rated torque and rated current.
    torque_constant_N_m_A: float | None = None
    rated_current_object: ObjectAddress = RATED[0]
    rated_current_object_unit_A: float = 1e-3
    rated_torque_object: ObjectAddress = RATED[1]
    rated_torque_object_unit_N_m: float = 1e-3
    # Those of the above objects that the bench file does not name, but that drives of this maker
    # are known to have; a drive may lack them.
    known_objects: tuple[ObjectAddress, ...] = ()
    # Vendor whose drives are known to have these units (1018h:01h), or None if all units are from
    # the bench file.
    vendor_id: int | None = None

    @property
    def named_objects(self) -> tuple[ObjectAddress, ...]:
        """Objects that the bench file names for this drive, and that the drive must have."""
        usual = ServoScales
        return tuple(
            address
            for address, default in (
                (self.current_object, None),
                (self.voltage_object, None),
                (self.temperature_object, None),
                (self.supply_object, usual.supply_object),
                (self.rated_current_object, usual.rated_current_object),
                (self.rated_torque_object, usual.rated_torque_object),
            )
            if address not in (None, default) and address not in self.known_objects
        )

    def __post_init__(self) -> None:
        """Refuse invalid scales."""
        for name in ("counts_per_turn", "gear_ratio", "rated_current_A", "rated_torque_N_m"):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise ConfigurationError(
                    f"{name} is {value}, but must be positive: correct the bench file"
                )
        for name in ("sign", "current_sign"):
            if getattr(self, name) not in (1, -1):
                raise ConfigurationError(
                    f"{name} is {getattr(self, name)}, but must be 1 or -1: correct the bench file"
                )

    def current_A(self, value: float, unit_A: float) -> float:
        """Return the motor current, A, of a value of the drive in units of ``unit_A``."""
        return value * unit_A * self.sign * self.current_sign - self.current_offset_A

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
        """Joint speed of one unit of the drive's speed, without sign."""
        return self.motor_speed_unit_rad_s / self.gear_ratio

    @property
    def motor_speed_unit_rad_s(self) -> float:
        """Motor speed of one unit of the drive's speed, without sign."""
        return self.velocity_unit_rad_s or self.count_rad

    @property
    def motor_acceleration_unit_rad_s2(self) -> float:
        """Motor acceleration of one unit of the drive's acceleration, without sign."""
        return self.acceleration_unit_rad_s2 or self.motor_speed_unit_rad_s

    @property
    def joint_acceleration_unit_rad_s2(self) -> float:
        """Joint acceleration of one unit of the drive's acceleration, without sign."""
        return self.motor_acceleration_unit_rad_s2 / self.gear_ratio

    @property
    def count_rad(self) -> float:
        """Motor angle of one count, without sign."""
        return 2.0 * math.pi / self.counts_per_turn

    @cached_property
    def current_unit_A(self) -> float:
        """Current of one unit of 6078h, without sign."""
        return self.rated_current_A / 1000.0

    @cached_property
    def torque_as_current_A(self) -> float:
        """Motor current that corresponds to one unit of 6077h, without sign."""
        rated_A = (
            self.rated_current_A
            if self.torque_constant_N_m_A is None
            else self.rated_torque_N_m / self.torque_constant_N_m_A
        )
        return rated_A / 1000.0

    @cached_property
    def motor_torque_unit_N_m(self) -> float:
        """Motor torque of one unit of 6077h, without sign."""
        return self.rated_torque_N_m / 1000.0

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
        """Yield an error for each difference between the scales and the values in the drive: rated
        current 6075h, rated torque 6076h (or the objects that are named in place of them), and
        resolution 608Fh.

        Values count as equal within 0.1 % or within one unit of the object, because drives may
        round. An object that the drive lacks is not compared; any other refusal of a read is
        yielded as an error.

        Raises:
            LinkError: No answer.
        """
        current, torque = self.rated_current_object, self.rated_torque_object
        current_A, torque_N_m = self.rated_current_object_unit_A, self.rated_torque_object_unit_N_m
        for what, address, resolution, bench, unit in (
            ("rated current", current, current_A, self.rated_current_A, "A"),
            ("rated torque", torque, torque_N_m, self.rated_torque_N_m, "N m"),
            ("encoder resolution", (0x608F, 0), 0.0, self.counts_per_turn, "counts per motor turn"),
        ):
            try:
                if resolution:
                    value = optional(drive.read, *address)
                    device = None if value is None else value * resolution
                else:
                    device = _resolution(drive)
            except (ConfigurationError, ObjectAccessError) as error:
                yield error
                continue
            # The margin ensures that a difference of one unit is not increased by a rounding error.
            allowed = max(_TOLERANCE * abs(bench), resolution * (1.0 + 1e-6))
            if device is not None and abs(device - bench) > allowed:
                yield ConfigurationError(
                    f"{what}, {address[0]:04X}h: {device:g} {unit} in the drive, but {bench:g} "
                    f"{unit} in the bench file; if this is the right drive, correct the bench file"
                )


def _resolution(drive: ObjectAccess) -> float | None:
    increments, turns = optional(drive.read, 0x608F, 1), optional(drive.read, 0x608F, 2)
    if increments is None or turns is None:
        return None
    return increments / turns if turns else math.inf


@dataclass(frozen=True)
class EncoderScales:
    """Units of one joint encoder according to the bench file."""

    counts_per_turn: int  # expected value of 6001h
    sign: int = 1  # 1 if rising counts are a rising joint angle, else -1
    offset_rad: float = 0.0  # joint angle at 6004h = 0
    # Middle of the joint's travel, or None for the angle at 6004h = 0. Of the angles that the first
    # reading may mean, the angle nearest to this middle is used.
    middle_rad: float | None = None

    def __post_init__(self) -> None:
        """Refuse invalid scales."""
        if self.counts_per_turn <= 0:
            raise ConfigurationError(
                f"counts_per_turn is {self.counts_per_turn}, but must be positive: correct the "
                "bench file"
            )
        if self.sign not in (1, -1):
            raise ConfigurationError(
                f"sign is {self.sign}, but must be 1 or -1: correct the bench file"
            )

    @cached_property
    def rad_per_count(self) -> float:
        """Joint angle of one count, with sign."""
        return self.sign * 2.0 * math.pi / self.counts_per_turn

    @cached_property
    def middle(self) -> int:
        """Encoder count at the middle of the joint's travel; 0 if no middle is given."""
        if self.middle_rad is None:
            return 0
        return round((self.middle_rad - self.offset_rad) / self.rad_per_count)


def nearest(value: int, modulus: int, near: int) -> int:
    """Return the count nearest to ``near`` that equals ``value`` modulo ``modulus``.

    Of two counts that are equally near, the lower is returned.
    """
    half = modulus // 2
    return near + (value - near + half) % modulus - half


class Unwrapper:
    """Unwraps a counter modulo ``modulus``.

    Each new value is unwrapped to the count nearest to the last count; therefore the counter must
    move by less than half of its range between calls. The first value is not changed or, with
    ``near``, is unwrapped to the count nearest to ``near``.
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
