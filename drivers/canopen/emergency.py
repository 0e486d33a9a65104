"""Meaning and remedy of the error codes in EMCY frames and object 603Fh (CiA 301, CiA 402)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

_MEANINGS: Final[Mapping[int, str]] = {
    0x2310: "continuous over-current: check whether the axis is jammed",
    0x2320: "short circuit at the output: check the motor cable before power is switched on again",
    0x3210: "DC link over-voltage: reduce the deceleration, or install a brake resistor",
    0x3220: "DC link under-voltage: check the supply",
    0x4210: "device over-temperature: let the device cool, check the ventilation",
    0x4310: "drive over-temperature: let the drive cool, check the ventilation",
    0x7320: "position sensor: check the encoder and its cable",
    0x8100: "communication lost: the drive received a stop command, or the bus failed",
    0x8130: (
        "heartbeat lost: the control loop stopped or the bus is overloaded; find the "
        "cause before enabling again"
    ),
    0x8210: (
        "process data frame too short: the mapping in the device differs from that of this "
        "program; prepare the device again"
    ),
    0x8611: "following error: the axis did not keep up with the target; check whether the axis is "
    "jammed, then reset the fault",
}
_CLASSES: Final[Mapping[int, str]] = {
    0x1: "generic error",
    0x2: "current",
    0x3: "voltage",
    0x4: "temperature",
    0x5: "device hardware",
    0x6: "device software",
    0x7: "additional modules",
    0x8: "monitoring",
    0x9: "external error",
    0xF: "additional functions or vendor specific",
}


def explain(code: int) -> str:
    """Return the meaning of an error code and its remedy."""
    if code in _MEANINGS:
        return _MEANINGS[code]
    return f"{_CLASSES.get(code >> 12, 'unknown class')}; see the drive's manual"
