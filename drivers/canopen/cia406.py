"""A joint encoder behind the CiA 406 profile."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from drivers.errors import ConfigurationError, DeviceError, ObjectAccessError
from drivers.interfaces import Encoder, EncoderSample, Identity
from drivers.objects import VENDOR, PdoLayout, ProcessChannel, read_identity, refusal
from drivers.units import EncoderScales, Unwrapper

_POSITION: Final = 1
FRAMES: Final = ((8, 1),)
"""As for the drive."""
_US: Final = 1e-6
_RESOLUTION: Final = (0x6001, 0)
_RANGE: Final = (0x6002, 0)
_ALARMS: Final = (0x6503, 0)
_VALUE: Final = (0x6004, 0)
_INPUTS: Final = (PdoLayout(_POSITION, (_VALUE, (0x1013, 0))),)


class Cia406Encoder(Encoder):
    """An absolute encoder that answers every SYNC with its position and its own time.

    Args:
        channel: The device.
        scales: Its resolution, direction and zero, from the bench file.
    """

    def __init__(self, channel: ProcessChannel, scales: EncoderScales) -> None:
        self._channel = channel
        self._scales = scales
        self._counter = Unwrapper(1 << 32, signed=True)
        self._time = Unwrapper(1 << 32)

    def identity(self) -> Identity:
        """Read the encoder's identity."""
        return read_identity(self._channel)

    def reading(self) -> float:
        """Read the position (6004h); NaN where the encoder refuses it."""
        try:
            counts = Unwrapper(self._channel.read(*_RANGE), signed=True).update(
                self._channel.read(*_VALUE)
            )
        except (ConfigurationError, ObjectAccessError):
            return math.nan
        return counts * self._scales.rad_per_count + self._scales.offset_rad

    def description_refusals(self) -> Iterator[DeviceError]:
        """Yield the objects that this profile needs and the EDS lacks. Sends nothing."""
        for address in (VENDOR, _RESOLUTION, _RANGE, _ALARMS):
            yield from refusal(self._channel.require_fit, *address, 0)
        yield from refusal(self._channel.require_mappable, (), _INPUTS)

    def refusals(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield a resolution that differs from the bench file, alarms, and missing objects."""
        yield from refusal(self._require_resolution)
        yield from refusal(self._require_no_alarm)
        unmappable = list(refusal(self._channel.require_mappable, (), _INPUTS))
        yield from unmappable
        for address in (_RANGE, *(() if unmappable else _INPUTS[0].objects)):
            yield from refusal(self._channel.read, *address)

    def prepare(self, cycle_s: float) -> None:
        """Check resolution and alarms, and map process data.

        Raises:
            ConfigurationError: 6001h differs from the bench file, or the encoder reports an alarm.
        """
        self._require_resolution()
        self._require_no_alarm()
        channel = self._channel
        channel.map_process_data([], _INPUTS, cycle_s)
        # Positions in the upper half of the range are read as just below zero.
        self._counter = Unwrapper(channel.read(*_RANGE), signed=True)
        self._time = Unwrapper(1 << 32)

    def sample(self) -> EncoderSample:
        """Return the sample of the last exchange."""
        position, time_us = self._channel.latest(_POSITION)
        angle = (
            self._counter.update(position) * self._scales.rad_per_count + self._scales.offset_rad
        )
        return EncoderSample(self._time.update(time_us) * _US, angle, self._channel.fresh)

    def _require_resolution(self) -> None:
        counts = self._channel.read(*_RESOLUTION)
        if counts != self._scales.counts_per_turn:
            raise ConfigurationError(
                f"{self._channel.label}: 6001h says {counts} counts per turn, the bench file "
                f"{self._scales.counts_per_turn}; correct the bench file, or check that this is "
                f"the right encoder"
            )

    def _require_no_alarm(self) -> None:
        if alarms := self._channel.read(*_ALARMS):
            raise ConfigurationError(
                f"{self._channel.label} reports alarms {alarms:04X}h (6503h); see the encoder's "
                f"manual"
            )
