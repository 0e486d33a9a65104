"""Objects of a CiA 402 drive that its servo uses, and the PDOs with the cyclic ones."""

from __future__ import annotations

from typing import Final

from drivers.canopen import cia402
from drivers.objects import ObjectAddress, PdoLayout
from drivers.units import RATED, ServoScales

OUTPUT_PDO: Final = 1
MOTION_PDO: Final = 1
SPEED_PDO: Final = 2
VOLTAGE_PDO: Final = 3
SUPPLY_PDO: Final = 4
SUPPLY_EVERY: Final = 10
FRAMES: Final = ((6, 1), (8, 1), (8, 1), (2, 1), (6, SUPPLY_EVERY))
"""Data bytes of each PDO, and its period in cycles; for a 16-bit voltage object."""
FRAMES_WITH_OFFSET: Final = ((8, 1), *FRAMES[1:])
"""Data bytes and periods of the PDOs if the torque offset is mapped."""
TORQUE_OFFSET: Final = (0x60B2, 0)
ABORT_IS_FAULT: Final = 1
POSITION: Final = (0x6064, 0)
TARGET: Final = (0x607A, 0)
CURRENT: Final = (0x6078, 0)
SPEED_ACTUAL: Final = (0x606C, 0)
DC_LINK: Final = (0x6079, 0)
TIME: Final = (0x1013, 0)
CYCLE: Final = (0x60C2, 1)
CYCLE_EXPONENT: Final = (0x60C2, 2)
ON_ABORT: Final = (0x6007, 0)
MODE: Final = (0x6060, 0)
MODE_DISPLAY: Final = (0x6061, 0)
MODES: Final = (0x6502, 0)
ERROR_CODE: Final = (0x603F, 0)
SINGLE: Final = (CYCLE, CYCLE_EXPONENT, ON_ABORT, MODE, MODE_DISPLAY, ERROR_CODE, *RATED)
"""Objects read or written singly, other than identity, limits and process data."""


def layouts(scales: ServoScales, torque_offset: bool) -> tuple[list[PdoLayout], list[PdoLayout]]:
    """Return the outputs and the inputs of a control cycle.

    Args:
        scales: Scales that name the voltage and temperature objects.
        torque_offset: Whether 60B2h is mapped as well.
    """
    outputs: tuple[ObjectAddress, ...] = (cia402.CONTROLWORD, TARGET)
    return [PdoLayout(OUTPUT_PDO, (*outputs, TORQUE_OFFSET) if torque_offset else outputs)], [
        PdoLayout(MOTION_PDO, (cia402.STATUSWORD, POSITION, CURRENT)),
        PdoLayout(SPEED_PDO, (SPEED_ACTUAL, TIME)),
        PdoLayout(VOLTAGE_PDO, (scales.voltage_object,)),
        PdoLayout(SUPPLY_PDO, (DC_LINK, scales.temperature_object), SUPPLY_EVERY),
    ]
