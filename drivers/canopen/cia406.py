"""Joint encoder with the CANopen profile CiA 406."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from drivers.errors import ConfigurationError, DeviceError, ObjectAccessError
from drivers.interfaces import Encoder, EncoderSample, Identity, Lacks
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
FRAMES: Final = ((8, 1),)
"""Data bytes of the PDO and its period in cycles."""
_US: Final = 1e-6
_RESOLUTION: Final = ((0x6001, 0), (0x6501, 0))
"""Objects with the steps per turn: the configured number (encoders of class 2), and the number of
the disc (class 1).
"""
_RANGE: Final = (0x6002, 0)
_TURNS: Final = (0x6502, 0)
_ALARMS: Final = (0x6503, 0)
_VALUE: Final = (0x6004, 0)
_TIME: Final = (0x1013, 0)
_WHOLE: Final = 1 << 32
_WHOLE_WORDS: Final = (0, _WHOLE - 1)
"""Values of 6002h that stand for a range of 2^32 steps, because this number does not fit into the
object.
"""


class Cia406Encoder(Encoder):
    """An absolute encoder that answers every SYNC with its position and its time stamp.

    Args:
        channel: The device.
        scales: Resolution, direction and zero of the encoder, from the bench file.
    """

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
        """Yield an error for each object that this profile needs and the EDS lacks. Nothing is
        sent.
        """
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
