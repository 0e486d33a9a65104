"""Converts the cyclic values of a CiA 402 drive to SI units, for any set of objects that the drive
has.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import chain
from typing import Final

from drivers.canopen import cia402_objects as objects
from drivers.canopen.cia402_objects import Cyclic
from drivers.canopen.motion import Observed
from drivers.clock import NS
from drivers.errors import ConfigurationError, ObjectAccessError
from drivers.interfaces import ServoReadings, ServoSample
from drivers.objects import ObjectAddress, PdoLayout, ProcessChannel
from drivers.units import ServoScales, Unwrapper

_US: Final = 1e-6
_SPAN: Final = 8
"""Number of exchanges over which a speed is computed from positions; over one exchange the
resolution of one count per cycle would be too coarse.
"""
_NOT_SENT: Final = -1
"""Index of the NaN that is appended to the values, for objects that are not sent."""


class CyclicValues:
    """Converts the values of the last exchange.

    Args:
        channel: The drive.
        scales: Units of the drive.
        sent: The objects that the drive sends.
        layouts: PDOs of these objects; the first two objects are state and position.
    """

    def __init__(
        self,
        channel: ProcessChannel,
        scales: ServoScales,
        sent: Cyclic,
        layouts: Sequence[PdoLayout],
    ) -> None:
        self._channel = channel
        self._scales = scales
        self._sent = sent
        self._numbers = tuple(layout.number for layout in layouts)
        addresses = chain.from_iterable(layout.objects for layout in layouts)
        self._at: dict[ObjectAddress | None, int] = {
            address: at for at, address in enumerate(addresses)
        }
        self._cycle_ns = 0
        self._passed: deque[tuple[int, int]] = deque(maxlen=_SPAN + 1)
        self._speed = 0.0
        self._time = Unwrapper(1 << 32)

    def begin(self, cycle_ns: int) -> None:
        """Start the conversion after the process data were mapped."""
        self._cycle_ns = cycle_ns
        self._speed = 0.0
        self._passed.clear()
        self._time = Unwrapper(1 << 32)

    def motion(self) -> tuple[int, int]:
        """Return statusword and position, counts."""
        statusword, position, *_ = self._channel.latest(self._numbers[0])
        return statusword, position

    def observed(self) -> Observed:
        """Return those values of the last exchange that the position loop in this program needs."""
        channel, scales = self._channel, self._scales
        values: list[int] = []
        for number in self._numbers:
            values += channel.latest(number)
        position, speed = values[1], self._sent.speed
        return Observed(
            values[0],
            scales.joint_angle_rad(position),
            self._change(position)
            if speed is None
            else values[self._at[speed]] * scales.joint_speed_unit_rad_s * scales.sign,
            channel.fresh,
        )

    def sample(self, following_counts: int) -> ServoSample:
        """Return the sample of the last exchange.

        Args:
            following_counts: Target less position, counts.
        """
        channel, scales, sent, at = self._channel, self._scales, self._sent, self._at
        values: list[float] = []
        for number in self._numbers:
            values += channel.latest(number)
        values.append(math.nan)
        position = int(values[1])
        time_us = channel.sync_us if sent.time is None else int(values[at[sent.time]])
        return ServoSample(
            self._time.update(time_us) * _US,
            position * scales.motor_rad_per_count + scales.offset_rad * scales.gear_ratio,
            self._change(position)
            if sent.speed is None
            else values[at[sent.speed]] * scales.joint_speed_unit_rad_s * scales.sign,
            scales.current_A(values[at[sent.current]], sent.current_unit_A),
            values[at.get(sent.voltage, _NOT_SENT)] * scales.voltage_unit_V * scales.sign,
            values[at.get(sent.supply, _NOT_SENT)] * scales.supply_unit_V,
            values[at.get(sent.temperature, _NOT_SENT)] * scales.temperature_unit_C,
            following_counts * scales.joint_rad_per_count,
            int(values[0]),
            channel.fresh,
            values[at.get(sent.torque, _NOT_SENT)]
            * scales.motor_torque_unit_N_m
            * scales.sign
            * scales.current_sign,
        )

    def _change(self, position: int) -> float:
        """Return the joint speed, rad/s, from the change of the position over the last exchanges in
        which new values arrived.
        """
        cycle, passed = self._channel.cycle, self._passed
        if self._channel.fresh and (not passed or passed[-1][0] != cycle):
            passed.append((cycle, position))
            then, before = passed[0]
            if cycle > then:
                moved = (position - before) * self._scales.joint_rad_per_count
                self._speed = moved * NS / ((cycle - then) * self._cycle_ns)
        return self._speed


def read_once(channel: ProcessChannel, scales: ServoScales, sent: Cyclic) -> ServoReadings:
    """Read each value of a drive outside the control cycle; a value that the drive does not have is
    NaN.
    """
    speed, supply, temperature = (
        _read_or_nan(channel, address)
        for address in (objects.SPEED_ACTUAL, scales.supply_object, scales.temperature_object)
    )
    return glance(channel, scales, sent)._replace(
        velocity_rad_s=speed * scales.joint_speed_unit_rad_s * scales.sign,
        supply_voltage_V=supply * scales.supply_unit_V,
        temperature_C=temperature * scales.temperature_unit_C,
    )


def glance(channel: ProcessChannel, scales: ServoScales, sent: Cyclic) -> ServoReadings:
    """Read position and current outside the control cycle; a value that the drive does not have is
    NaN.
    """
    counts = _read_or_nan(channel, objects.POSITION)
    current = _read_or_nan(channel, sent.current)
    return ServoReadings(
        counts * scales.motor_rad_per_count + scales.offset_rad * scales.gear_ratio,
        current_A=scales.current_A(current, sent.current_unit_A),
    )


def _read_or_nan(channel: ProcessChannel, address: ObjectAddress | None) -> float:
    if address is None:
        return math.nan
    try:
        return channel.read(*address)
    except (ConfigurationError, ObjectAccessError):
        return math.nan
