"""Selects the objects of a CiA 402 drive that the servo uses, and divides them among PDOs.

The servo needs the objects of state, mode, position, target, and of a current or a torque. All
other objects are used if the EDS of the drive contains them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

from drivers.canopen import cia402
from drivers.canopen.motion import OUTPUT_PDO, Motion, Observed
from drivers.clock import NS
from drivers.interfaces import ServoSample, ServoState
from drivers.objects import WATCHES, ObjectAddress, PdoLayout, ProcessChannel
from drivers.units import ServoScales, Unwrapper

SUPPLY_EVERY: Final = 10
FRAMES: Final = ((6, 1), (8, 1), (8, 1), (2, 1), (8, SUPPLY_EVERY))
"""Data bytes of each PDO and its period in cycles, for a drive with all objects."""
FRAMES_WITH_OFFSET: Final = ((8, 1), *FRAMES[1:])
"""Data bytes and periods of the PDOs if the torque offset is mapped."""
ABORT_IS_FAULT: Final = 1
POSITION: Final = (0x6064, 0)
CURRENT: Final = (0x6078, 0)
TORQUE: Final = (0x6077, 0)
SPEED_ACTUAL: Final = (0x606C, 0)
TIME: Final = (0x1013, 0)
CYCLE: Final = (0x60C2, 1)
CYCLE_EXPONENT: Final = (0x60C2, 2)
ON_ABORT: Final = (0x6007, 0)
MODE: Final = (0x6060, 0)
MODE_DISPLAY: Final = (0x6061, 0)
MODES: Final = (0x6502, 0)
ERROR_CODE: Final = (0x603F, 0)
NEEDED: Final[Mapping[ObjectAddress, str]] = {
    cia402.CONTROLWORD: "it switches the power off",
    cia402.STATUSWORD: "it shows whether the power is off",
    MODE: "it selects the mode of operation",
    MODE_DISPLAY: "it shows whether the selected mode of operation is active",
    POSITION: "limits are checked with the position",
}
"""Objects that every drive must have, each with its purpose; a mode needs further ones."""


def stops_alone(has: Callable[[int, int], bool]) -> bool:
    """Return whether such a drive monitors its master and takes the power off without it."""
    return has(*ON_ABORT) and any(all(has(*at) for at in needed) for needed in WATCHES)


def settings(channel: ProcessChannel, cycle_s: float) -> list[tuple[ObjectAddress, int]]:
    """Return the objects of the EDS that a preparation sets, with their values."""
    wanted = ((CYCLE, round(cycle_s * 1e3)), (CYCLE_EXPONENT, -3), (ON_ABORT, ABORT_IS_FAULT))
    return [(address, value) for address, value in wanted if channel.describes(*address)]


@dataclass(frozen=True)
class Cyclic:
    """Objects that the drive sends in every cycle, or None for each object that the drive lacks."""

    current: ObjectAddress | None  # motor current, or the torque from which the current is computed
    current_unit_A: float  # current that one unit of `current` means, A, without sign
    speed: ObjectAddress | None  # motor speed
    time: ObjectAddress | None  # time stamp
    voltage: ObjectAddress | None  # motor voltage
    supply: ObjectAddress | None  # supply voltage
    temperature: ObjectAddress | None
    torque: ObjectAddress | None = None  # torque, for a drive that sends a current too


def cyclic(channel: ProcessChannel, scales: ServoScales) -> Cyclic:
    """Return the objects that a drive, by its EDS, can send in every cycle, without sending
    anything.

    Objects that the bench file names for this drive are assumed to exist; the checks before the
    first motion report an error for each named object that the drive lacks.
    """
    named = scales.named_objects

    def sent(address: ObjectAddress | None) -> ObjectAddress | None:
        if address is None or address in named:
            return address
        return address if channel.describes(*address, mappable=True) else None

    current, unit_A = sent(scales.current_object), scales.named_current_unit_A
    if current is None:
        current, unit_A = sent(CURRENT), scales.current_unit_A
    if current is None:
        current, unit_A = sent(TORQUE), scales.torque_as_current_A
    return Cyclic(
        current,
        unit_A,
        sent(SPEED_ACTUAL),
        sent(TIME),
        sent(scales.voltage_object),
        sent(scales.supply_object),
        sent(scales.temperature_object),
        sent(TORQUE) if channel.latches and current not in (None, TORQUE) else None,
    )


def outputs(motion: Motion) -> list[PdoLayout]:
    """Return the outputs of a control cycle in a mode of operation."""
    return [PdoLayout(OUTPUT_PDO, (cia402.CONTROLWORD, *motion.outputs))]


def inputs(sent: Cyclic, channel: ProcessChannel) -> list[PdoLayout]:
    """Return the inputs of a control cycle; what does not fit goes into the next PDO."""
    motion = (cia402.STATUSWORD, POSITION, sent.current)
    layouts: list[PdoLayout] = []
    over: list[ObjectAddress] = []
    for group in (motion, (sent.speed, sent.time), (sent.voltage,), ()):
        together = [*over, *(address for address in group if address is not None)]
        over = []
        while len(together) > 1 and not channel.fit_together(together):
            over.insert(0, together.pop())
        _add(layouts, together, sent.current)
    _add(layouts, over, sent.current)
    slow = [address for address in (sent.supply, sent.temperature) if address is not None]
    if slow:
        layouts.append(PdoLayout(len(layouts) + 1, tuple(slow), SUPPLY_EVERY))
    return layouts if sent.torque is None else _beside(layouts, sent.torque, channel)


def _beside(
    layouts: list[PdoLayout], torque: ObjectAddress, channel: ProcessChannel
) -> list[PdoLayout]:
    """Return the layouts with the torque in the last one with room; without room it is omitted."""
    for at in reversed(range(1, len(layouts))):
        if channel.fit_together([*layouts[at].objects, torque]):
            more = replace(layouts[at], objects=(*layouts[at].objects, torque))
            return [*layouts[:at], more, *layouts[at + 1 :]]
    return layouts


def _add(
    layouts: list[PdoLayout], together: Sequence[ObjectAddress], current: ObjectAddress | None
) -> None:
    if together:
        mean = current if current in together else None
        layouts.append(PdoLayout(len(layouts) + 1, tuple(together), mean=mean))


NEEDED_IN: Final = frozenset({ServoState.SWITCHED_ON, ServoState.OPERATION_ENABLED})
"""States in which the mode must be active; some drives activate it only in SWITCHED ON."""


_US: Final = 1e-6
_SPAN: Final = 8
"""Number of exchanges over which a speed is computed from positions; one is too coarse."""
_NOT_SENT: Final = -1
"""Index of the NaN that is appended to the values, for objects that are not sent."""


class CyclicValues:
    """Converts the values of the last exchange."""

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
        """Return the joint speed, rad/s, from the positions of the last exchanges."""
        cycle, passed = self._channel.cycle, self._passed
        if self._channel.fresh and (not passed or passed[-1][0] != cycle):
            passed.append((cycle, position))
            then, before = passed[0]
            if cycle > then:
                moved = (position - before) * self._scales.joint_rad_per_count
                self._speed = moved * NS / ((cycle - then) * self._cycle_ns)
        return self._speed
