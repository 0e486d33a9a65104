"""Reads the values of all devices before a run, and finds those that would prevent it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass

from rig.common.errors import Cause, Finding
from rig.common.sample import Sample
from rig.control.safety import RUNNING, check
from rig.planning.limits import Limits
from rig.wiring.devices import Devices

NOT_AVAILABLE = "not available"


@dataclass(frozen=True)
class Readings:
    """Readings of the devices, which are not simultaneous; a value that a device does not report is
    NaN.

    Attributes:
        motor_encoder_at_joint_rad: Angle of the drive's encoder, divided by the gear ratio.
        pressure_Pa: Pressure in the gas generator's chamber; None on a bench without a pressure
            transmitter.
    """

    state: str
    motor_encoder_at_joint_rad: float
    joint_encoder_rad: float
    speed_rad_s: float
    current_A: float
    supply_V: float
    temperature_C: float
    pressure_Pa: float | None

    @property
    def difference_rad(self) -> float:
        """Angle of the drive's encoder minus the joint encoder, both at the joint."""
        return self.motor_encoder_at_joint_rad - self.joint_encoder_rad

    def record(self) -> dict[str, str | float | None]:
        """Return the record for ``--json``; null for values that are not available."""
        values = {**dataclasses.asdict(self), "difference_rad": self.difference_rad}
        return {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in values.items()
        }

    def rows(self) -> list[list[str]]:
        """Return name, value and unit of each reading, angles in degrees."""
        rows = [
            ["motor encoder, at the joint", _degrees(self.motor_encoder_at_joint_rad), "deg"],
            ["joint encoder", _degrees(self.joint_encoder_rad), "deg"],
            ["difference of the two", _degrees(self.difference_rad), "deg"],
            ["joint speed", _degrees(self.speed_rad_s), "deg/s"],
            ["motor current", _number(self.current_A, 3), "A"],
            ["supply voltage", _number(self.supply_V, 1), "V"],
            ["temperature", _number(self.temperature_C, 1), "deg C"],
        ]
        if self.pressure_Pa is not None:
            rows.append(["chamber pressure", _number(self.pressure_Pa * 1e-6, 4), "MPa"])
        return [[name, value, "" if value == NOT_AVAILABLE else unit] for name, value, unit in rows]


def take_readings(devices: Devices, gear_ratio: float) -> Readings:
    """Read the values of every device without writing, or raise a DeviceError."""
    servo = devices.servo.readings()
    return Readings(
        state=devices.servo.state().value,
        motor_encoder_at_joint_rad=servo.motor_angle_rad / gear_ratio,
        joint_encoder_rad=devices.encoder.reading(),
        speed_rad_s=servo.velocity_rad_s,
        current_A=servo.current_A,
        supply_V=servo.supply_voltage_V,
        temperature_C=servo.temperature_C,
        pressure_Pa=None if devices.pressure is None else devices.pressure.reading(),
    )


def reading_findings(readings: Readings, limits: Limits) -> Iterator[Finding]:
    """Yield the readings that would stop a run as soon as the drive is enabled.

    Each reading is checked by :func:`rig.control.safety.check`, as in a run, with all other values
    set inside their limits. Values that are not available are not checked.
    """
    gear, angle, pressure = limits.gear_ratio, readings.joint_encoder_rad, readings.pressure_Pa
    calm = at_rest(limits)
    shown: list[tuple[float, Sample]] = [
        (angle, calm._replace(angle=angle, motor_angle=angle * gear)),
        (readings.speed_rad_s, calm._replace(velocity=readings.speed_rad_s)),
        (readings.current_A, calm._replace(current=readings.current_A)),
        (
            readings.difference_rad,
            calm._replace(motor_angle=(calm.angle + readings.difference_rad) * gear),
        ),
        (readings.temperature_C, calm._replace(temperature=readings.temperature_C)),
        (readings.supply_V, calm._replace(supply_voltage=readings.supply_V)),
    ]
    if pressure is not None:
        # The gas force depends on the valve angle; an angle beyond its limit was reported above.
        at = angle if limits.angle_min <= angle <= limits.angle_max else calm.angle
        shown.append((pressure, calm._replace(pressure=pressure, angle=at, motor_angle=at * gear)))
    for value, sample in shown:
        if not math.isnan(value) and (trip := check(sample, 0.0, 0.0, limits)) is not None:
            yield Finding(Cause.READINGS, trip.now)


def at_rest(limits: Limits) -> Sample:
    """Return a sample of a joint at rest, with every value far inside its limits."""
    middle = 0.5 * (limits.angle_min + limits.angle_max)
    return Sample(
        time=0.0,
        host_time=0.0,
        device_time=0.0,
        encoder_time=0.0,
        command=middle,
        motor_angle=middle * limits.gear_ratio,
        angle=middle,
        velocity=0.0,
        current=0.0,
        voltage=0.0,
        supply_voltage=limits.supply_min,
        temperature=limits.temperature,
        following_error=0.0,
        statusword=RUNNING,
        segment=0,
        fresh=True,
        pressure=0.0,
    )


def _degrees(value: float) -> str:
    return _number(math.degrees(value), 3)


def _number(value: float, decimals: int) -> str:
    return NOT_AVAILABLE if math.isnan(value) else f"{value:z.{decimals}f}"
