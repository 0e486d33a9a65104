"""Interfaces of the devices of a bench to the rest of the program, in SI units.

A :class:`Link` exchanges all outputs and inputs of its :class:`Servo` and :class:`Encoder` once a
cycle. Angles, speeds and torques are at the joint unless the name says ``motor``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, fields
from enum import Enum
from typing import NamedTuple

from drivers.clock import Clock
from drivers.errors import ConfigurationError, DeviceError, DriveFault
from drivers.homing import Homes
from drivers.lacks import NOTHING, Lacks
from drivers.remedies import Recognised, SpeedRemedies


class ServoState(Enum):
    """State of the CiA 402 power drive system, as decoded from object 6041h."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"

    @property
    def energised(self) -> bool:
        """Whether the power stage may produce torque in this state."""
        return self in _ENERGISED


_ENERGISED = frozenset(
    {ServoState.OPERATION_ENABLED, ServoState.QUICK_STOP_ACTIVE, ServoState.FAULT_REACTION}
)


@dataclass(frozen=True)
class Identity:
    """Identity of a device (objects 1018h, 1008h, 100Ah or their serial equivalents)."""

    name: str
    vendor_id: int
    product_code: int
    revision: int
    serial_number: int
    hardware_version: str = ""
    software_version: str = ""


@dataclass(frozen=True)
class ServoLimits:
    """Limits held in the drive, at the joint, in SI units.

    ``following_error_rad`` is None where the drive's window is off (6065h = FFFFFFFFh). A limit
    that the drive does not hold is NaN, see :meth:`Servo.lacks`.
    """

    angle_min_rad: float
    angle_max_rad: float
    speed_rad_s: float
    torque_N_m: float
    current_A: float
    following_error_rad: float | None
    quick_stop_option: int
    quick_stop_deceleration_rad_s2: float


@dataclass(frozen=True)
class LimitSteps:
    """Resolution of the limits that a drive holds: one unit of each object, at the joint, in SI.

    A step is zero if the drive does not hold the limit, or holds the limit exactly.
    """

    angle_rad: float
    speed_rad_s: float
    torque_N_m: float
    current_A: float
    following_error_rad: float
    quick_stop_deceleration_rad_s2: float


class ServoReadings(NamedTuple):
    """Values read singly from a drive, outside the cyclic exchange.

    The values are not simultaneous. NaN where the drive gives no value.
    """

    motor_angle_rad: float = math.nan
    velocity_rad_s: float = math.nan
    current_A: float = math.nan
    supply_voltage_V: float = math.nan
    temperature_C: float = math.nan


class ServoSample(NamedTuple):
    """Sample of the drive in one cycle.

    ``current_A`` is the mean over the SYNC period that ends at ``device_time_s``. ``fresh`` is
    False when a part of the answer is missing or bad; the values are then those of the last good
    frame. ``motor_torque_N_m`` is the torque at the motor as the drive measures it, or NaN if the
    drive measures only the current; the value may be up to ten cycles old.
    """

    device_time_s: float
    motor_angle_rad: float
    velocity_rad_s: float
    current_A: float
    voltage_V: float
    supply_voltage_V: float
    temperature_C: float
    following_error_rad: float
    statusword: int
    fresh: bool
    motor_torque_N_m: float = math.nan


class EncoderSample(NamedTuple):
    """Sample of the joint encoder in one cycle."""

    device_time_s: float
    angle_rad: float
    fresh: bool


class PressureSample(NamedTuple):
    """Sample of the pressure transmitter in one cycle."""

    pressure_Pa: float
    fresh: bool


class RawFrame(NamedTuple):
    """One frame as transmitted, for the log. ``sent`` is True for frames of the host."""

    time_ns: int
    identifier: int
    data: bytes
    sent: bool


class Link(ABC):
    """A bus or port with the devices on it, exchanged once a cycle.

    Its methods raise only DeviceError.

    Attributes:
        clock: Real or simulated clock, matching the bus.
        has_watchdog: Whether the devices stop by themselves if the control loop stops.
    """

    clock: Clock
    has_watchdog: bool = True

    @abstractmethod
    def open(self) -> None:
        """Open the bus. Moves nothing and energises nothing.

        Raises:
            LinkError: It cannot be opened; the message names the cause.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the bus; safe to call twice and after a failure. Raises nothing."""

    @abstractmethod
    def exchange(self) -> None:
        """Send every device's outputs, latch all inputs at one instant and collect them.

        The exchange also sends the master's heartbeat, so that the heartbeat ends when the control
        loop stops. If a device does not answer in time, its last sample stays, with ``fresh``
        False; an error is raised only if the bus itself fails.

        Raises:
            LinkError: The bus failed.
            DriveFault: A device sent an emergency message.
        """

    @abstractmethod
    def take_frames(self) -> list[RawFrame]:
        """Return the raw frames seen since the last call, oldest first."""


class Servo(SpeedRemedies, Recognised, Homes, ABC):
    """A position servo. Only :meth:`enable` ever changes the state of the drive toward power.

    Attributes:
        watch_s: Silence of the control loop after which the drive stops by itself, s, or None if it
            never does.
        limits_taken: Fields of :class:`ServoLimits` that :meth:`write_limits` can set.
        limit_places: Field of :class:`ServoLimits` to the name of the place where the drive holds
            it, or None for the objects of CiA 402.
    """

    watch_s: float | None = None
    limits_taken: Set[str] = frozenset(field.name for field in fields(ServoLimits))
    limit_places: Mapping[str, str] | None = None

    @abstractmethod
    def identity(self) -> Identity:
        """Read who it is."""

    @abstractmethod
    def state(self) -> ServoState:
        """Read the drive's state from the device (6041h), not from a cached frame."""

    @abstractmethod
    def read_limits(self) -> ServoLimits:
        """Read back the limits held in the drive."""

    def lacks(self, cycle_s: float) -> Lacks:
        """Return the limits that the drive does not enforce and the measured values (temperature,
        supply voltage) that it does not report. Nothing is sent.
        """
        return NOTHING

    def limit_steps(self) -> LimitSteps | None:
        """Return the resolution of the held limits, or None if not known. Nothing is sent."""
        return None

    def limit_refusals(self, limits: ServoLimits) -> Iterator[DeviceError]:
        """Yield the errors that :meth:`write_limits` would raise. Nothing is sent."""
        yield from ()

    @abstractmethod
    def write_limits(self, limits: ServoLimits) -> None:
        """Write limits into the drive and verify them by reading back.

        Raises:
            ConfigurationError: The drive holds another value than the one written.
        """

    def readings(self) -> ServoReadings:
        """Read the drive's values without preparing it.

        The method writes nothing, and sends only read requests.

        Raises:
            LinkError: The drive cannot be reached.
        """
        return ServoReadings()

    def fault(self) -> DriveFault:
        """Read the cause of the drive's fault; only for a drive in fault."""
        return DriveFault(
            0, "the drive is in fault: see its display and manual, and remove the cause"
        )

    def refusals(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield why :meth:`prepare` would refuse a de-energised drive, by read requests alone.

        Raises:
            LinkError: The drive cannot be reached.
        """
        yield from ()

    @abstractmethod
    def prepare(self, cycle_s: float) -> None:
        """Check units against the drive, map process data, set the cycle, verify the heartbeat
        time-out. Nothing is energised.

        The heartbeat time-out is read back; :meth:`enable` starts it and :meth:`disable` ends it.

        Raises:
            ConfigurationError: Scale, unit or identity differ from the bench file.
        """

    @abstractmethod
    def enable(self) -> None:
        """Energise and hold the present position.

        Raises:
            StateError: Not reached in time; the drive is left de-energised.
            DriveFault: The drive is in fault.
        """

    @abstractmethod
    def disable(self) -> None:
        """Take the power off and verify this by reading 6041h.

        Raises:
            StateError: The drive still reports an energised state.
        """

    @abstractmethod
    def quick_stop(self) -> None:
        """Brake with the drive's own ramp; the method never switches the power on."""

    @abstractmethod
    def reset_fault(self) -> None:
        """Clear a fault. Afterwards the drive is de-energised; motion does not restart."""

    @abstractmethod
    def set_target(self, angle_rad: float) -> None:
        """Set the joint angle that the next exchange sends."""

    def set_torque_offset(self, torque_N_m: float) -> None:
        """Set a joint torque that the drive adds to the torque of its controller, from the next
        exchange until the value is changed.

        The drive must be prepared for the offset; while it is not operating, the offset is zero.

        Raises:
            ConfigurationError: The drive was not prepared for it, or has no such input.
        """
        raise ConfigurationError(
            f"this drive has no torque offset, but {torque_N_m:g} N m are requested: run without "
            f"feed-forward, "
            "or use a CANopen drive with object 60B2h"
        )

    @abstractmethod
    def sample(self) -> ServoSample:
        """Return the sample of the last exchange."""


class Encoder(Recognised, ABC):
    """A joint encoder."""

    @abstractmethod
    def identity(self) -> Identity:
        """Read who it is."""

    def reading(self) -> float:
        """Read the joint angle, rad, without preparing the encoder; NaN if there is no angle.

        Writes nothing.

        Raises:
            LinkError: The encoder cannot be reached.
        """
        return math.nan

    def refusals(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield the reasons why :meth:`prepare` would refuse the encoder, by read requests alone.

        Raises:
            LinkError: The encoder cannot be reached.
        """
        yield from ()

    def lacks(self) -> Iterator[str]:
        """Yield the values that the encoder does not report, by read requests alone.

        Raises:
            LinkError: The encoder cannot be reached.
        """
        yield from ()

    @abstractmethod
    def prepare(self, cycle_s: float) -> None:
        """Check resolution against the device and map process data."""

    @abstractmethod
    def sample(self) -> EncoderSample:
        """Return the sample of the last exchange."""


class PressureTransmitter(ABC):
    """A transmitter on the gas generator's chamber."""

    @abstractmethod
    def identity(self) -> Identity:
        """Read who it is."""

    def reading(self) -> float:
        """Read the pressure, Pa, without preparing the transmitter; NaN if there is no pressure.

        Writes nothing.

        Raises:
            LinkError: The transmitter cannot be reached.
        """
        return math.nan

    def refusals(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield why :meth:`prepare` would refuse the transmitter, by read requests alone.

        Raises:
            LinkError: The transmitter cannot be reached.
        """
        yield from ()

    @abstractmethod
    def prepare(self, cycle_s: float) -> None:
        """Check unit and state against the device and map process data."""

    @abstractmethod
    def sample(self) -> PressureSample:
        """Return the sample of the last exchange."""
