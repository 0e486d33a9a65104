"""Converts the units of the bench file to SI; missing ones are those of the drive's maker."""

from __future__ import annotations

import math
from typing import Any

from drivers.canopen.device_data import DeviceData
from drivers.canopen.motion import (
    CyclicPosition,
    CyclicSpeed,
    CyclicTorque,
    LoopGains,
    Motion,
    ProfilePosition,
)
from drivers.canopen.sdo import Axis
from drivers.units import EncoderScales, ServoScales
from rig.config.bench import Constants, LimitsSection
from rig.config.canopen import EncoderSection, ServoSection

_OBJECTS = {
    "voltage_object": ("voltage_unit_V", "voltage_unit_V"),
    "temperature_object": ("temperature_unit_C", "temperature_unit_C"),
    "supply_object": ("supply_unit_V", "supply_unit_V"),
    "current_object": ("current_unit_A", "named_current_unit_A"),
    "rated_current_object": ("rated_current_object_unit_A", "rated_current_object_unit_A"),
    "rated_torque_object": ("rated_torque_object_unit_N_m", "rated_torque_object_unit_N_m"),
}
"""Key of the unit of each object, and field of the scales with it, by the object's key."""


def servo_scales(
    servo: ServoSection, machine: Constants, data: DeviceData | None = None
) -> ServoScales:
    """Return the drive's scales in SI units; keys of the bench file precede the maker's data."""
    found: dict[str, Any] = {}
    known = []
    for field, (unit, scale) in _OBJECTS.items():
        named, told = getattr(servo, field), getattr(data, field, None)
        if named is None and told is not None:
            known.append(told)
        if (address := named or told) is not None:
            found[field] = address
        # The unit in the maker's data applies to the maker's object, not to another object that the
        # bench file names.
        same = named in (None, told or getattr(ServoScales, field))
        told_unit = getattr(data, unit, None) if same else None
        if (value := getattr(servo, unit) or told_unit) is not None:
            found[scale] = value
    return ServoScales(
        counts_per_turn=servo.counts_per_motor_turn,
        gear_ratio=machine.gear_ratio,
        rated_current_A=servo.rated_current_A,
        rated_torque_N_m=servo.rated_torque_N_m,
        sign=servo.sign,
        offset_rad=math.radians(servo.offset_deg),
        current_sign=servo.current_sign,
        current_offset_A=servo.current_offset_A,
        velocity_unit_rad_s=servo.motor_speed_unit_rad_s(data),
        acceleration_unit_rad_s2=servo.motor_acceleration_unit_rad_s2(data),
        torque_constant_N_m_A=machine.torque_constant_N_m_A,
        known_objects=tuple(known),
        vendor_id=_vendor(servo, data),
        **found,
    )


def servo_motion(
    servo: ServoSection, scales: ServoScales, data: DeviceData | None, torque_offset: bool = False
) -> Motion:
    """Return the motion command of the drive; a ``torque_offset`` requires cyclic positions."""
    mode = servo.commanded(data)
    if mode == "csp":
        return CyclicPosition(torque_offset)
    if mode == "pp":
        return ProfilePosition(scales, math.radians(servo.profile_acceleration_deg_s2))
    loop = servo.position_loop
    stated = LoopGains(
        loop.position_gain_1_s or 0.0, loop.speed_gain_N_m_s_rad or 0.0, loop.reset_1_s or 0.0
    )
    if mode == "csv":
        return CyclicSpeed(scales, stated)
    return CyclicTorque(scales, stated, loop.inertia_kg_m2 or 0.0)


def servo_axis(servo: ServoSection, data: DeviceData | None) -> Axis:
    """Return the place of the drive's objects."""
    unlike = () if data is None else data.unlike
    return Axis(servo.object_offset, servo.sub_index, unlike)


def _vendor(servo: ServoSection, data: DeviceData | None) -> int | None:
    """Return the vendor that the drive must have, if the maker's data follow from its EDS."""
    found = data is not None and servo.device is None and servo.eds is not None
    return data.vendor_id if data is not None and found else None


def encoder_scales(encoder: EncoderSection, limits: LimitsSection) -> EncoderScales:
    """Return the joint encoder's scales in SI units."""
    return EncoderScales(
        counts_per_turn=encoder.counts_per_turn,
        sign=encoder.sign,
        offset_rad=math.radians(encoder.offset_deg),
        middle_rad=limits.middle_rad,
    )
