"""Joint encoder (CiA 406), and pressure transmitter (CiA 404)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from drivers.errors import ConfigurationError, DeviceError, ObjectAccessError
from drivers.interfaces import (
    Encoder,
    EncoderSample,
    Identity,
    Lacks,
    PressureSample,
    PressureTransmitter,
)
from drivers.objects import (
    VENDOR,
    ObjectAddress,
    PdoLayout,
    ProcessChannel,
    access_problems,
    identity_problems,
    optional,
    problem_of,
    read_identity,
)
from drivers.units import EncoderScales, Unwrapper, nearest

_POSITION: Final = 1
ENCODER_FRAMES: Final = ((8, 1),)  # data bytes of the PDO of an encoder and its period in cycles
_US: Final = 1e-6
_RESOLUTION: Final = ((0x6001, 0), (0x6501, 0))
"""Objects with the steps per turn: as configured (class 2), or of the disc (class 1)."""
_RANGE: Final = (0x6002, 0)
_TURNS: Final = (0x6502, 0)
_ALARMS: Final = (0x6503, 0)
_VALUE: Final = (0x6004, 0)
_TIME: Final = (0x1013, 0)
_WHOLE: Final = 1 << 32
_WHOLE_WORDS: Final = (0, _WHOLE - 1)
"""Values of 6002h for a range of 2^32 steps, which does not fit into the object."""


class Cia406Encoder(Encoder):
    """An absolute encoder that answers every SYNC with its position and its time stamp."""

    def __init__(self, channel: ProcessChannel, scales: EncoderScales) -> None:
        self._channel = channel
        self._scales = scales
        self._stamped = True
        self._counter = Unwrapper(_WHOLE, near=scales.middle)
        self._time = Unwrapper(_WHOLE)

    def identity(self) -> Identity:
        return read_identity(self._channel)

    def identity_problems(self) -> Iterator[DeviceError]:
        yield from identity_problems(self._channel)

    def reading(self) -> float:
        try:
            counts = nearest(self._channel.read(*_VALUE), self._modulus(), self._scales.middle)
        except (ConfigurationError, ObjectAccessError):
            return math.nan
        return counts * self._scales.rad_per_count + self._scales.offset_rad

    def description_problems(self) -> Iterator[DeviceError]:
        """Yield an error for each needed object that the EDS lacks. Nothing is sent."""
        yield from problem_of(self._channel.require_fit, *VENDOR, 0)
        yield from problem_of(self._channel.require_mappable, (), [self._inputs(stamped=False)])

    def step_rad(self) -> float:
        return abs(self._scales.rad_per_count)

    def problems(self, cycle_s: float) -> Iterator[DeviceError]:
        yield from problem_of(self._require_resolution)
        yield from problem_of(self._require_no_alarm)
        yield from problem_of(self._modulus)
        yield from access_problems(self._channel, (), [self._inputs(stamped=False)])

    def lacks(self, cycle_s: float) -> Lacks:
        read = self._channel.read

        def absent(*addresses: ObjectAddress) -> bool:
            return all(optional(read, *address) is None for address in addresses)

        rows = (
            (absent(*_RESOLUTION), "not checked: counts per turn (6001h, 6501h)"),
            (
                absent(_RANGE, _TURNS),
                "no range of the position (6002h, 6502h): the position is assumed to start again "
                "at zero after each turn",
            ),
            (absent(_ALARMS), "not monitored: alarms (6503h)"),
            (
                not self._has_stamp(),
                "no time stamp (1013h): samples have the time of the SYNC on this computer",
            ),
        )
        return Lacks(words=tuple(f"joint encoder: {text}" for lacking, text in rows if lacking))

    def prepare(self, cycle_s: float) -> None:
        """Check resolution and alarms, and map process data.

        The time stamp is that of the encoder (1013h), or the host's time of the SYNC if the encoder
        has none.
        """
        self._require_resolution()
        self._require_no_alarm()
        channel = self._channel
        self._stamped = self._has_stamp()
        channel.map_process_data([], [self._inputs(self._stamped)], cycle_s)
        self._counter = Unwrapper(self._modulus(), near=self._scales.middle)
        self._time = Unwrapper(_WHOLE)

    def sample(self) -> EncoderSample:
        position, *stamp = self._channel.latest(_POSITION)
        angle = (
            self._counter.update(position) * self._scales.rad_per_count + self._scales.offset_rad
        )
        time_us = stamp[0] if stamp else self._channel.sync_us
        return EncoderSample(self._time.update(time_us) * _US, angle, self._channel.fresh)

    def _has_stamp(self) -> bool:
        channel = self._channel
        return (
            channel.describes(*_TIME, mappable=True) and optional(channel.read, *_TIME) is not None
        )

    def _inputs(self, stamped: bool) -> PdoLayout:
        return PdoLayout(_POSITION, (_VALUE, _TIME) if stamped else (_VALUE,))

    def _modulus(self) -> int:
        """Return the range of the position in steps.

        For an encoder of class 1, which has no 6002h, the range is the product of the steps and
        turns of its discs. If an encoder has none of these objects, a range of one turn is assumed,
        because every true range is a multiple of one turn.
        """
        channel, turn = self._channel, self._scales.counts_per_turn
        span = optional(channel.read, *_RANGE)
        if span is not None:
            return _WHOLE if span in _WHOLE_WORDS else span
        return min(_WHOLE, turn * max(1, optional(channel.read, *_TURNS) or 1))

    def _require_resolution(self) -> None:
        for address in _RESOLUTION:
            counts = optional(self._channel.read, *address)
            if counts is None:
                continue
            if counts != self._scales.counts_per_turn:
                raise ConfigurationError(
                    f"{self._channel.label}: object {address[0]:04X}h reads {counts} counts per "
                    f"turn, but the bench file states {self._scales.counts_per_turn}; if this is "
                    "the right encoder, correct the bench file"
                )
            return

    def _require_no_alarm(self) -> None:
        if alarms := optional(self._channel.read, *_ALARMS):
            raise ConfigurationError(
                f"{self._channel.label} reports the alarms {alarms:04X}h (object 6503h); see the "
                "encoder's manual"
            )


PRESSURE_FRAMES: Final = ((5, 1),)
"""Data bytes of the PDO of a transmitter and its period in cycles."""
PASCALS: Final = {0x22: 1.0, 0x4E: 1e5, 0xAB: 6894.757293168}
"""Unit codes of CiA 303-2 (bits 16 to 23 of 6131h) for pascal, bar and psi, to the unit in Pa."""

_PRESSURE: Final = 1
_UNIT_TOLERANCE: Final = 1e-6
_UNIT: Final = (0x6131, 1)
_DIGITS: Final = (0x6132, 1)
_STATUS: Final = (0x6150, 1)
_PROCESS_VALUE: Final = (0x9130, 1)
# A CAN controller sends its frames in the order of requests, so that a heartbeat of lowest priority
# may delay the frame with the pressure to the end of the cycle. The pressure hardly changes in this
# time.
_PRESSURE_INPUTS: Final = (PdoLayout(_PRESSURE, (_PROCESS_VALUE, _STATUS), slack=1),)


class Cia404Transmitter(PressureTransmitter):
    """A transmitter that sends process value (9130h) and status (6150h) after every SYNC."""

    def __init__(self, channel: ProcessChannel, unit_Pa: float) -> None:
        self._channel = channel
        self._unit_Pa = unit_Pa

    def identity(self) -> Identity:
        return read_identity(self._channel)

    def reading(self) -> float:
        try:
            status, value = self._channel.read(*_STATUS), self._channel.read(*_PROCESS_VALUE)
        except (ConfigurationError, ObjectAccessError):
            return math.nan
        return math.nan if status else value * self._unit_Pa

    def description_problems(self) -> Iterator[DeviceError]:
        """Yield an error for each needed object that the EDS lacks. Nothing is sent."""
        for address in (VENDOR, _UNIT, _DIGITS):
            yield from problem_of(self._channel.require_fit, *address, 0)
        yield from problem_of(self._channel.require_mappable, (), _PRESSURE_INPUTS)

    def problems(self, cycle_s: float) -> Iterator[DeviceError]:
        yield from problem_of(self._require_unit)
        yield from problem_of(self._require_valid)
        yield from access_problems(self._channel, (), _PRESSURE_INPUTS)

    def prepare(self, cycle_s: float) -> None:
        self._require_unit()
        self._require_valid()
        self._channel.map_process_data([], _PRESSURE_INPUTS, cycle_s)

    def sample(self) -> PressureSample:
        value, status = self._channel.latest(_PRESSURE)
        return PressureSample(value * self._unit_Pa, self._channel.fresh and status == 0)

    def _require_unit(self) -> None:
        channel = self._channel
        code = channel.read(*_UNIT)
        found = unit_of(code, channel.read(*_DIGITS))
        if found is None:
            raise ConfigurationError(
                f"{channel.label}: 6131h reads {code:08X}h, which is no known unit of pressure; "
                "set the transmitter's unit to bar or Pa"
            )
        if abs(found - self._unit_Pa) > _UNIT_TOLERANCE * self._unit_Pa:
            raise ConfigurationError(
                f"{channel.label}: by 6131h and 6132h one unit of the pressure is {found:g} Pa, "
                f"but the bench file states {self._unit_Pa:g} Pa; if this is the right "
                "transmitter, correct unit_Pa"
            )

    def _require_valid(self) -> None:
        if status := self._channel.read(*_STATUS):
            label = self._channel.label
            raise ConfigurationError(
                f"{label}: {status_words(status)} (6150h); check the sensor and its range"
            )


def unit_of(code: int, digits: int) -> float | None:
    """Return the pressure of one count of an integer process value, Pa, or None if its unit is no
    unit of pressure.

    Args:
        code: Value of 6131h: decimal prefix (bits 24 to 31, an exponent), unit, and no denominator.
        digits: Value of 6132h: number of decimal digits.
    """
    pascals = PASCALS.get(code >> 16 & 0xFF)
    if pascals is None or code & 0xFFFF:
        return None
    prefix = code >> 24 & 0xFF
    return float(pascals * 10.0 ** ((prefix - 256 if prefix > 127 else prefix) - digits))


def status_words(status: int) -> str:
    """Return the meaning of 6150h, the status of the process value."""
    bits = {0x01: "not valid", 0x02: "above its range", 0x04: "below its range"}
    said = [words for bit, words in bits.items() if status & bit]
    return f"the pressure is {' and '.join(said) or f'invalid, with the status {status:02X}h'}"
