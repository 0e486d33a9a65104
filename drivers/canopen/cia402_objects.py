"""Objects of a CiA 402 drive that its servo uses, and the PDOs with the cyclic ones.

Needed are state, mode, position, target, and a current or a torque. Of the others those are used
that the drive's EDS has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from drivers.canopen import cia402
from drivers.objects import ObjectAddress, PdoLayout, ProcessChannel
from drivers.units import ServoScales

OUTPUT_PDO: Final = 1
SUPPLY_EVERY: Final = 10
FRAMES: Final = ((6, 1), (8, 1), (8, 1), (2, 1), (8, SUPPLY_EVERY))
"""Data bytes of each PDO, and its period in cycles; for a drive with all objects and a 16-bit
voltage object.
"""
FRAMES_WITH_OFFSET: Final = ((8, 1), *FRAMES[1:])
"""Data bytes and periods of the PDOs if the torque offset is mapped."""
TORQUE_OFFSET: Final = (0x60B2, 0)
ABORT_IS_FAULT: Final = 1
POSITION: Final = (0x6064, 0)
TARGET: Final = (0x607A, 0)
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
    cia402.CONTROLWORD: "it takes the power off",
    cia402.STATUSWORD: "it tells whether the power is off",
    MODE: "it selects cyclic synchronous position",
    MODE_DISPLAY: "it tells whether that mode is in force",
    POSITION: "it is what the limits are checked against",
    TARGET: "it is what a run commands",
}
"""Objects without which no drive can be used, and what for."""


@dataclass(frozen=True)
class Cyclic:
    """Objects that the drive tells in every cycle, None for each that it lacks.

    Attributes:
        current: Motor current, or the torque that stands in for it.
        current_unit_A: Current of one unit of that object, without sign.
        speed: Motor speed.
        time: Time stamp.
        voltage: Motor voltage.
        supply: Supply voltage.
        temperature: Temperature.
        torque: Torque, for a drive that tells a current as well.
    """

    current: ObjectAddress | None
    current_unit_A: float
    speed: ObjectAddress | None
    time: ObjectAddress | None
    voltage: ObjectAddress | None
    supply: ObjectAddress | None
    temperature: ObjectAddress | None
    torque: ObjectAddress | None = None


def cyclic(channel: ProcessChannel, scales: ServoScales) -> Cyclic:
    """Return what a drive tells in every cycle, according to its EDS. Sends nothing.

    Objects that the bench file names are taken for there; the checks refuse those that are not.
    """
    named = scales.named_objects

    def told(address: ObjectAddress) -> ObjectAddress | None:
        there = address in named or channel.describes(*address, mappable=True)
        return address if there else None

    current, unit_A = scales.current_object, scales.named_current_unit_A
    if current is None:
        current, unit_A = told(CURRENT), scales.current_unit_A
    if current is None:
        current, unit_A = told(TORQUE), scales.torque_as_current_A
    return Cyclic(
        current,
        unit_A,
        told(SPEED_ACTUAL),
        told(TIME),
        told(scales.voltage_object),
        told(scales.supply_object),
        told(scales.temperature_object),
        told(TORQUE) if channel.latches and current not in (None, TORQUE) else None,
    )


def outputs(torque_offset: bool) -> list[PdoLayout]:
    """Return the outputs of a control cycle; ``torque_offset`` maps 60B2h as well."""
    commanded: tuple[ObjectAddress, ...] = (cia402.CONTROLWORD, TARGET)
    return [PdoLayout(OUTPUT_PDO, (*commanded, TORQUE_OFFSET) if torque_offset else commanded)]


def inputs(told: Cyclic, channel: ProcessChannel) -> list[PdoLayout]:
    """Return the inputs of a control cycle. What does not fit beside the others of its kind goes
    with the next ones.
    """
    motion = (cia402.STATUSWORD, POSITION, told.current)
    layouts: list[PdoLayout] = []
    over: list[ObjectAddress] = []
    for group in (motion, (told.speed, told.time), (told.voltage,), ()):
        together = [*over, *(address for address in group if address is not None)]
        over = []
        while len(together) > 1 and not channel.fit_together(together):
            over.insert(0, together.pop())
        _add(layouts, together, told.current)
    _add(layouts, over, told.current)
    slow = [address for address in (told.supply, told.temperature) if address is not None]
    if slow:
        layouts.append(PdoLayout(len(layouts) + 1, tuple(slow), SUPPLY_EVERY))
    return layouts if told.torque is None else _beside(layouts, told.torque, channel)


def _beside(
    layouts: list[PdoLayout], torque: ObjectAddress, channel: ProcessChannel
) -> list[PdoLayout]:
    """Return the layouts with the torque in the last one with room for it. It is held against the
    current and not needed otherwise, so that it takes no frame of its own.
    """
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
