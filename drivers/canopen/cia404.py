"""Pressure transmitter with the CANopen profile CiA 404 for measuring devices."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from drivers.errors import ConfigurationError, DeviceError, ObjectAccessError
from drivers.interfaces import Identity, PressureSample, PressureTransmitter
from drivers.objects import (
    VENDOR,
    PdoLayout,
    ProcessChannel,
    access_problems,
    problem_of,
    read_identity,
)

FRAMES: Final = ((5, 1),)
"""Data bytes of the PDO and its period in cycles."""
PASCALS: Final = {0x22: 1.0, 0x4E: 1e5, 0xAB: 6894.757293168}
"""Unit codes of CiA 303-2 (bits 16 to 23 of 6131h) for pascal, bar and psi, to the unit in Pa."""

_PRESSURE: Final = 1
_UNIT_TOLERANCE: Final = 1e-6
_UNIT: Final = (0x6131, 1)
_DIGITS: Final = (0x6132, 1)
_STATUS: Final = (0x6150, 1)
_VALUE: Final = (0x9130, 1)
# A CAN controller sends its frames in the order of requests, so that a heartbeat of lowest priority
# may delay the frame with the pressure to the end of the cycle. The pressure hardly changes in this
# time.
_INPUTS: Final = (PdoLayout(_PRESSURE, (_VALUE, _STATUS), slack=1),)


class Cia404Transmitter(PressureTransmitter):
    """A transmitter that answers every SYNC with process value (9130h) and status (6150h) of its
    first input.

    Args:
        channel: The device.
        unit_Pa: Unit of the process value from the bench file, Pa.
    """

    def __init__(self, channel: ProcessChannel, unit_Pa: float) -> None:
        self._channel = channel
        self._unit_Pa = unit_Pa

    def identity(self) -> Identity:
        return read_identity(self._channel)

    def reading(self) -> float:
        try:
            status, value = self._channel.read(*_STATUS), self._channel.read(*_VALUE)
        except (ConfigurationError, ObjectAccessError):
            return math.nan
        return math.nan if status else value * self._unit_Pa

    def description_problems(self) -> Iterator[DeviceError]:
        """Yield an error for each object that this profile needs and the EDS lacks. Nothing is
        sent.
        """
        for address in (VENDOR, _UNIT, _DIGITS):
            yield from problem_of(self._channel.require_fit, *address, 0)
        yield from problem_of(self._channel.require_mappable, (), _INPUTS)

    def problems(self, cycle_s: float) -> Iterator[DeviceError]:
        yield from problem_of(self._require_unit)
        yield from problem_of(self._require_valid)
        yield from access_problems(self._channel, (), _INPUTS)

    def prepare(self, cycle_s: float) -> None:
        self._require_unit()
        self._require_valid()
        self._channel.map_process_data([], _INPUTS, cycle_s)

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
