"""Interfaces of the devices of a bench for the rest of the program, in SI units.

A :class:`Link` exchanges all outputs and inputs of its :class:`Servo` and :class:`Encoder` once a
cycle. Angles, speeds and torques are at the joint unless the name says ``motor``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, fields
from enum import Enum
from typing import Final, NamedTuple

from drivers.clock import Clock
from drivers.errors import ConfigurationError, DeviceError, DriveFault


@dataclass(frozen=True)
class Lacks:
    """Limits and values that a device lacks.

    Attributes:
        limits: Fields of :class:`~drivers.interfaces.ServoLimits` that the drive does not enforce.
        temperature: Whether the drive does not report its temperature.
        supply: Whether the drive does not report its supply voltage.
        words: Text for the operator, one sentence for each limit or value.
    """

    limits: frozenset[str] = frozenset()
    temperature: bool = False
    supply: bool = False
    words: tuple[str, ...] = ()


NOTHING = Lacks()  # record of a device that enforces all limits and reports all values


KNOWN_SPREAD: Final = 2.2
"""Greatest ratio between the unit of speed that is computed from a motion and a known unit, at
which the two count as equal. Known units differ by far more. The computed unit is inexact because
the drive rounds the speed to whole units.
"""
MEASURED_SPREAD: Final = 1.5
"""Greatest error factor of a unit of speed that is computed from a motion of some hundredths of a
radian, without rounding: on most simulated benches with stick-slip the factor was 0.74 to 1.42.
"""


class SpeedRemedies:
    """Corrections of a wrong unit of the reported speed of a drive."""

    def speed_remedy(self, factor: float) -> str:
        """Return a text on how to correct a reported speed of ``factor`` times the true speed."""
        return "correct the drive's unit of speed in the bench file"

    def nearest_speed_factor(self, factor: float, spread: float) -> float:
        """Return the factor of the nearest known unit of speed, if its ratio to the rough
        ``factor`` is within ``spread``; otherwise the rough factor.
        """
        return factor

    def speed_settings(self, factor: float) -> Sequence[tuple[str, str | float | None]]:
        """Return the keys in the drive's section of the bench file, and their values, that correct
        a speed reported as ``factor`` times the true speed; empty if no key corrects it.
        """
        return ()


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
    """Limits that are stored in the drive, at the joint, in SI units.

    ``following_error_rad`` is None if the limit of the following error is switched off in the drive
    (6065h = FFFFFFFFh). A limit that the drive does not have is NaN (:meth:`Servo.lacks`).
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
    """Resolution of the limits that a drive stores: one unit of each object, at the joint, in SI.

    The resolution is zero if the drive does not have the limit, or stores it exactly.
    """

    angle_rad: float
    speed_rad_s: float
    torque_N_m: float
    current_A: float
    following_error_rad: float
    quick_stop_deceleration_rad_s2: float


class ServoReadings(NamedTuple):
    """Values that are read from a drive one by one, outside the cyclic exchange.

    The values are not simultaneous. A value that the drive does not have is NaN.
    """

    motor_angle_rad: float = math.nan
    velocity_rad_s: float = math.nan
    current_A: float = math.nan
    supply_voltage_V: float = math.nan
    temperature_C: float = math.nan


class Measuring(NamedTuple):
    """How finely a drive measures; a value that is not known, or not reported, is NaN.

    Attributes:
        joint_step_rad: Joint angle of one unit of the position.
        gear_ratio: Motor turns per joint turn.
        current_step_A: Current of one unit of the current; NaN if the drive reports no current.
        rated_current_A: Rated current, or the current limit of a drive whose rated current is not
            known.
    """

    joint_step_rad: float = math.nan
    gear_ratio: float = 1.0
    current_step_A: float = math.nan
    rated_current_A: float = math.nan


class ServoMotion(NamedTuple):
    """Joint angle and joint speed that are read from a drive; NaN if unknown."""

    angle_rad: float = math.nan
    velocity_rad_s: float = math.nan


class ServoSample(NamedTuple):
    """Sample of the drive in one cycle.

    ``current_A`` is the mean over the SYNC period that ends at ``device_time_s``. ``fresh`` is
    False if a part of the answer is missing or bad; the values are then those of the last good
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
    """One frame as it was on the bus, for the log; ``sent`` is True for frames of the host."""

    time_ns: int
    identifier: int
    data: bytes
    sent: bool


class Link(ABC):
    """A bus or port with its devices, whose values are exchanged once a cycle.

    The methods of a link raise only DeviceError.

    Attributes:
        clock: Real or simulated clock, as the bus.
        has_watchdog: Whether the devices stop by themselves if the control loop stops.
    """

    clock: Clock
    has_watchdog: bool = True

    @abstractmethod
    def open(self) -> None:
        """Open the bus, without motion and without energising a drive.

        Raises:
            LinkError: The bus cannot be opened; the message states the cause.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the bus, without raising an error; may be called twice and after a failure."""

    @abstractmethod
    def exchange(self) -> None:
        """Send the outputs of every device, sample all inputs at one instant and receive them.

        The exchange also sends the heartbeat of the master, so that the heartbeat ends when the
        control loop stops. If a device does not answer in time, its last sample is kept, with
        ``fresh`` False; an error is raised only if the bus fails.

        Raises:
            LinkError: The bus failed.
            DriveFault: A device sent an emergency message.
        """

    @abstractmethod
    def take_frames(self) -> list[RawFrame]:
        """Return the raw frames that were sent or received since the last call, oldest first."""


class Device(ABC):
    """What every device of a bench can do; LinkError if the device cannot be reached."""

    @abstractmethod
    def identity(self) -> Identity:
        """Read who it is.

        Raises:
            LinkError: The device cannot be reached, as in the other methods.
        """

    def identity_problems(self) -> Iterator[DeviceError]:
        """Yield an error for each difference between the device and its description."""
        yield from ()

    def problems(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield the errors of :meth:`prepare` for a de-energised device, by read requests alone."""
        yield from ()

    def lacks(self, cycle_s: float) -> Lacks:
        """Return the limits and measured values that the device lacks, by read requests alone."""
        return NOTHING

    @abstractmethod
    def prepare(self, cycle_s: float) -> None:
        """Compare units and resolution with those of the device, and map process data. A drive is
        not energised; its cycle time is set, and its heartbeat time-out is verified by reading it
        back (:meth:`Servo.enable` starts it and :meth:`Servo.disable` ends it).

        Raises:
            ConfigurationError: A scale, a unit or the identity differs from the bench file.
        """


class Servo(SpeedRemedies, Device):
    """A position servo. Only :meth:`enable` ever changes the state of the drive toward power.

    Attributes:
        watch_s: Time without a sign of the control loop after which the drive stops by itself, s,
            or None if it never stops by itself.
        limits_taken: Fields of :class:`ServoLimits` that :meth:`write_limits` can set.
        limit_places: Field of :class:`ServoLimits` to the name of the drive's parameter that stores
            the limit, or None for the objects of CiA 402.
        prepared: Whether exchanges send the commands.
        asked: Whether reading the state sends the present command, which restarts the watchdog.
    """

    watch_s: float | None = None
    asked: bool = False
    limits_taken: Set[str] = frozenset(field.name for field in fields(ServoLimits))
    limit_places: Mapping[str, str] | None = None
    prepared: bool = False

    @abstractmethod
    def state(self) -> ServoState:
        """Read the drive's state from the device, not from a cached frame."""

    def sent_state(self) -> ServoState | None:
        """Return the state in the last exchange, or None if it contained none. Nothing is sent."""
        return None

    @abstractmethod
    def read_limits(self) -> ServoLimits:
        """Read the limits that are stored in the drive."""

    def limit_steps(self) -> LimitSteps | None:
        """Return the resolution of the stored limits, or None if unknown. Nothing is sent."""
        return None

    def limit_problems(self, limits: ServoLimits) -> Iterator[DeviceError]:
        """Yield the errors that :meth:`write_limits` would raise, without sending anything."""
        yield from ()

    @abstractmethod
    def write_limits(self, limits: ServoLimits) -> None:
        """Write limits into the drive and verify them by reading back.

        Raises:
            ConfigurationError: A value that is read back differs from the written value.
        """

    def readings(self) -> ServoReadings:
        """Read the drive's values by read requests alone, without preparing it."""
        return ServoReadings()

    def glance(self) -> ServoReadings:
        """Read only the angle of the motor and the current, by read requests; else NaN."""
        return self.readings()

    def measuring(self) -> Measuring:
        """Return how finely the drive measures. Nothing is sent."""
        return Measuring()

    def motion(self) -> ServoMotion:
        """Read angle and speed by as few requests as possible, without preparing the drive."""
        return ServoMotion(velocity_rad_s=self.readings().velocity_rad_s)

    def promised_deceleration(self) -> float:
        """Return the quick stop's deceleration of the joint, rad/s^2, as known; NaN if unknown."""
        return math.nan

    def fault(self) -> DriveFault:
        """Read the cause of the drive's fault; the drive must be in fault."""
        return DriveFault(
            0, "the drive is in fault: look up the fault on its display and in its manual"
        )

    @abstractmethod
    def enable(self) -> None:
        """Energise the drive and hold the present position.

        Raises:
            StateError: The energised state is not reached in time; the drive is then de-energised.
            DriveFault: The drive is in fault.
        """

    @abstractmethod
    def disable(self) -> None:
        """Take the power off, and verify by the drive's state that it is off.

        Raises:
            StateError: The drive still reports an energised state.
        """

    @abstractmethod
    def quick_stop(self, *, at_once: bool = True) -> None:
        """Order the drive to brake with its own ramp, in all further exchanges; with ``at_once``,
        or if these may not reach the drive, also before the next one, where a LinkError states that
        the order was not sent, or not answered. The method does not wait for the standstill.
        """

    @abstractmethod
    def reset_fault(self) -> None:
        """Reset a fault. Afterwards the drive is de-energised and does not move."""

    @abstractmethod
    def set_target(self, angle_rad: float) -> None:
        """Set the joint angle that the next exchange sends."""

    def set_torque_offset(self, torque_N_m: float) -> None:
        """Set a joint torque that the drive adds to the torque of its controller, from the next
        exchange until the value is changed.

        The drive must be prepared for a torque offset, which is zero unless it operates.

        Raises:
            ConfigurationError: The drive was not prepared for a torque offset, or has none.
        """
        raise ConfigurationError(
            f"this drive has no torque offset, but {torque_N_m:g} N m are requested: run without "
            "feed-forward"
        )

    @abstractmethod
    def sample(self) -> ServoSample:
        """Return the sample of the last exchange."""


class Encoder(Device):
    """A joint encoder."""

    def reading(self) -> float:
        """Read the joint angle, rad, by read requests alone; NaN if there is no angle."""
        return math.nan

    def step_rad(self) -> float:
        """Return the joint angle of one count; NaN if it is not known. Nothing is sent."""
        return math.nan

    @abstractmethod
    def sample(self) -> EncoderSample:
        """Return the sample of the last exchange."""


class PressureTransmitter(Device):
    """A pressure transmitter on the chamber of the gas generator."""

    def reading(self) -> float:
        """Read the pressure, Pa, by read requests alone; NaN if there is no pressure."""
        return math.nan

    @abstractmethod
    def sample(self) -> PressureSample:
        """Return the sample of the last exchange."""


EXTENDED_FLAG: Final = 0x80000000
REMOTE_FLAG: Final = 0x40000000
ERROR_FLAG: Final = 0x20000000  # flag of error frames and other frames that are no data frames
SERIAL_FLAG: Final = 0x10000000
"""Flag of bytes of a serial line, whose number is in the low bits. The flag is valid only without
the other flags, because this bit is also a bit of extended identifiers.
"""
IDENTIFIER_BITS: Final = 0x1FFFFFFF
