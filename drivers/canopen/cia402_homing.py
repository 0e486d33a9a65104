"""Homing of CiA 402 drives: mode 6, objects 6098h, 6099h, 609Ah, 607Ch and 60E3h, bits 10, 12 and
13 of the statusword.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Final

from drivers import servo_limits
from drivers.canopen import cia402
from drivers.canopen import cia402_objects as objects
from drivers.canopen.cia402_objects import CyclicValues
from drivers.canopen.motion import OUTPUT_PDO, TARGET_POSITION, Motion, Observed
from drivers.errors import ConfigurationError, DeviceError, ObjectAccessError, StateError
from drivers.homing import IN_PLACE, STANDARD, HomingOffer, HomingOrder, HomingState
from drivers.interfaces import Servo
from drivers.objects import ObjectAddress, ProcessChannel, optional, refusal
from drivers.units import ServoScales

HOMING: Final = 6
"""Value of 6060h."""
OFFSET: Final = (0x607C, 0)
METHOD: Final = (0x6098, 0)
SEARCH_SPEED: Final = (0x6099, 1)
ZERO_SPEED: Final = (0x6099, 2)
ACCELERATION: Final = (0x609A, 0)
SUPPORTED: Final = 0x60E3
_START: Final = 1 << 4
_REACHED, _ATTAINED, _ERROR = 1 << 10, 1 << 12, 1 << 13


class Homing(Motion):
    """Homing mode: after the start of a homing the drive moves by itself.

    Args:
        usual: The mode of operation of the bench, whose process data stay mapped during the homing.
    """

    mode = HOMING
    words = "homing"
    target = METHOD
    follows = False

    def __init__(self, usual: Motion) -> None:
        super().__init__()
        self.usual = usual
        self.takes_offset = usual.takes_offset
        self.started = False

    def reset(self) -> None:
        """Clear the state of the motion, including the start of a homing, because switching the
        drive on must never start a homing.
        """
        super().reset()
        self.started = False

    @property
    def outputs(self) -> tuple[ObjectAddress, ...]:
        return self.usual.outputs

    def stage(
        self, channel: ProcessChannel, word: int, counts: int, observe: Callable[[], Observed]
    ) -> None:
        """Put the controlword into the PDO of the next exchange. The homing starts only if the
        drive is energised. The commands of other modes are 0.
        """
        if word == cia402.ENABLE_OPERATION and self.started:
            word |= _START
        values = (counts if address == TARGET_POSITION else 0 for address in self.outputs)
        channel.stage(OUTPUT_PDO, word, *values)


def offer(channel: ProcessChannel) -> HomingOffer:
    """Return whether and how the drive can home, by its EDS and by reading its objects once."""
    try:
        why = _missing(channel, METHOD, OFFSET) or _mode_missing(channel)
        if why:
            return HomingOffer(why_not=why)
        listed = _listed(channel)
        methods = STANDARD if listed is None else listed
        fit = tuple(m for m in methods if not [*refusal(channel.require_fit, *METHOD, m)])
        still = _missing(channel, SEARCH_SPEED, ZERO_SPEED)
    except (ObjectAccessError, ConfigurationError) as refused:
        return HomingOffer(why_not=str(refused))
    if still:
        fit = tuple(m for m in fit if m in IN_PLACE)
    why = still or ("" if fit else "60E3h lists no method that fits into 6098h")
    return HomingOffer(fit, why, listed is not None)


def _missing(channel: ProcessChannel, *addresses: ObjectAddress) -> str:
    """Return the object for homing that the drive lacks; empty if none is missing."""
    for address in addresses:
        name = _name(address)
        if not channel.describes(*address):
            return f"object {name} is not in the device's EDS"
        if optional(channel.read, *address) is None:
            return f"object {name} is in the device's EDS, but not in the device"
    return ""


def _name(address: ObjectAddress) -> str:
    index, subindex = address
    return f"{index:04X}h:{subindex:02X}h" if subindex else f"{index:04X}h"


def _mode_missing(channel: ProcessChannel) -> str:
    modes = None
    if channel.describes(*objects.MODES):
        modes = optional(channel.read, *objects.MODES)
    if modes is None or modes >> HOMING - 1 & 1:
        return ""
    return f"6502h reads {modes:08X}h: bit {HOMING - 1}, homing mode, is 0"


def _listed(channel: ProcessChannel) -> tuple[int, ...] | None:
    """Return the homing methods that object 60E3h lists, or None for a drive without this
    object.
    """
    count = optional(channel.read, SUPPORTED, 0) if channel.describes(SUPPORTED, 0) else None
    if count is None:
        return None
    found = (optional(channel.read, SUPPORTED, at) for at in range(1, min(count, 254) + 1))
    # 60E3h may be unsigned, whereas in 6098h the maker's own methods are negative numbers.
    signed = {m - 256 if m > 127 else m for m in found if m}
    return tuple(sorted(signed))


def settings(
    channel: ProcessChannel, scales: ServoScales, order: HomingOrder
) -> Iterator[tuple[ObjectAddress, int]]:
    """Yield the objects that are written before a homing, and their values; speeds are rounded
    down.

    Raises:
        ConfigurationError: A speed is less than the unit of its object.
    """
    unit = scales.joint_speed_unit_rad_s
    if order.method not in IN_PLACE:
        for address, speed in ((SEARCH_SPEED, order.search_rad_s), (ZERO_SPEED, order.zero_rad_s)):
            value = math.floor(speed / unit + 1e-6)
            if value < 1:
                raise ConfigurationError(
                    f"the homing speed, {speed:g} rad/s at the joint, is less than one unit of "
                    f"object 6099h, {unit:g} rad/s: raise --speed-limit"
                )
            yield address, value
        if channel.describes(*ACCELERATION):
            units = order.acceleration_rad_s2 / scales.joint_acceleration_unit_rad_s2
            yield ACCELERATION, max(1, round(units))
    yield OFFSET, scales.counts(order.home_rad)
    yield METHOD, order.method


class HomingServo(Servo, ABC):
    """The part of a CiA 402 servo that homes."""

    _channel: ProcessChannel
    _scales: ServoScales
    _motion: Motion
    _values: CyclicValues
    _target: int

    @abstractmethod
    def _stage(self, counts: int) -> None:
        """Put controlword and position into the PDO of the next exchange."""

    def homing_offer(self) -> HomingOffer:
        return offer(self._channel)

    def begin_homing(self, order: HomingOrder) -> Mapping[str, int]:
        state = self.state()
        if state.energised or isinstance(self._motion, Homing):
            raise StateError(f"the drive is in state '{state.value}': disable it before homing")
        held: dict[str, int] = {}
        for address, value in settings(self._channel, self._scales, order):
            self._channel.require_fit(*address, value)
            servo_limits.store(self._channel, address, value)
            held[_name(address)] = value
        self._motion = Homing(self._motion)
        try:
            self.enable()
        except DeviceError:
            with suppress(DeviceError):
                self.end_homing()
            raise
        return held

    def start_homing(self) -> None:
        if isinstance(self._motion, Homing):
            self._motion.started = True
            self._stage(self._target)

    def homing_state(self) -> HomingState:
        """Return the state of the homing, from bits 10, 12 and 13 of the statusword."""
        word, _ = self._values.motion()
        if word & _ERROR:
            return HomingState.FAILED
        if not word & _REACHED or not self._channel.fresh:
            return HomingState.RUNNING
        return HomingState.ATTAINED if word & _ATTAINED else HomingState.INTERRUPTED

    def end_homing(self) -> tuple[int, int]:
        state = self.state()
        if state.energised:
            raise StateError(
                f"the drive is in state '{state.value}', in which its mode of operation cannot be "
                "changed from homing: disable it first"
            )
        if isinstance(self._motion, Homing):
            self._motion = self._motion.usual
        mode = self._motion.mode
        self._channel.write(*objects.MODE, mode)
        return self._channel.read(*objects.MODE_DISPLAY), mode
