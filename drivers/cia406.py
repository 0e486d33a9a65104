"""A joint encoder behind the CiA 406 profile."""

from __future__ import annotations

from typing import Final

from drivers.errors import ConfigurationError
from drivers.interfaces import Encoder, EncoderSample, Identity
from drivers.objects import PdoLayout, ProcessChannel, read_identity
from drivers.units import EncoderScales, Unwrapper

_POSITION: Final = 1
FRAMES: Final = ((8, 1),)
"""As for the drive."""
_US: Final = 1e-6


class Cia406Encoder(Encoder):
    """An absolute encoder that answers every SYNC with its position and its own time.

    Args:
        channel: The device.
        scales: Its resolution, sense and zero, from the bench file.
    """

    def __init__(self, channel: ProcessChannel, scales: EncoderScales) -> None:
        self._channel = channel
        self._scales = scales
        self._counter = Unwrapper(1 << 32, signed=True)
        self._time = Unwrapper(1 << 32)

    def identity(self) -> Identity:
        """Read who it is."""
        return read_identity(self._channel)

    def prepare(self, cycle_s: float) -> None:
        """Check resolution and alarms, and map process data.

        Raises:
            ConfigurationError: 6001h differs from the bench file, or the encoder reports an alarm.
        """
        channel = self._channel
        counts = channel.read(0x6001)
        if counts != self._scales.counts_per_turn:
            raise ConfigurationError(
                f"{channel.label}: 6001h says {counts} counts per turn, the bench file "
                f"{self._scales.counts_per_turn}; correct the bench file, or check that this is the right encoder"
            )
        if alarms := channel.read(0x6503):
            raise ConfigurationError(f"{channel.label} reports alarms {alarms:04X}h (6503h); see the encoder's manual")
        channel.map_process_data([], [PdoLayout(_POSITION, ((0x6004, 0), (0x1013, 0)))], cycle_s)
        # Positions in the upper half of the range are read as just below zero.
        self._counter = Unwrapper(channel.read(0x6002), signed=True)
        self._time = Unwrapper(1 << 32)

    def sample(self) -> EncoderSample:
        """Return the sample of the last exchange."""
        position, time_us = self._channel.latest(_POSITION)
        angle = self._counter.update(position) * self._scales.rad_per_count + self._scales.offset_rad
        return EncoderSample(self._time.update(time_us) * _US, angle, self._channel.fresh)
