"""EDS files of drives of common makes, made from that of the simulated drive."""

from __future__ import annotations

import re
from typing import Final

from drivers.mock.drive import DRIVE_EDS
from drivers.mock.traits import MAKES, Shown

LACKS: Final = {name: make.lacks for name, make in MAKES.items()}
"""Make to the indices of the objects that its drives lack."""
_HEAD: Final = re.compile(r"\[([0-9A-Fa-f]{4})(?:sub[0-9A-Fa-f]+)?\]\s*$")
_STANDARD: Final = frozenset({(0x6078, 0)})
"""Objects of CiA 402 that drives of some make have in another unit."""
_TYPES: Final = {"b": 2, "h": 3, "i": 4, "B": 5, "H": 6, "I": 7}
"""Struct code to data type of CiA 301."""


def description(make: str) -> str:
    """Return the EDS of a make: that of the simulated drive with other objects."""
    traits = MAKES[make]
    kept, keep = [], True
    for line in DRIVE_EDS.read_text(encoding="ascii").splitlines():
        if line.startswith("["):
            head = _HEAD.match(line)
            keep = head is None or int(head[1], 16) not in traits.lacks
        if keep:
            kept.append(line)
    text = "\n".join(kept) + "\n"
    text = text.replace("0x000007FF", f"0x{traits.vendor_id:08X}")
    text = text.replace("0x00000402", f"0x{traits.product_code:08X}")
    indices = sorted({own.address[0] for own in traits.own if own.address[1]})
    return (
        text
        + "".join(map(_record, indices))
        + "".join(_section(own) for own in traits.own if own.address not in _STANDARD)
    )


def _record(index: int) -> str:
    return (
        f"\n[{index:04X}]\nParameterName=Record {index:04X}\nObjectType=0x9\nSubNumber=2\n"
        f"\n[{index:04X}sub0]\nParameterName=Highest subindex\nObjectType=0x7\n"
        f"DataType=0x0005\nAccessType=const\nDefaultValue=4\nPDOMapping=0\n"
    )


def _section(shown: Shown) -> str:
    index, subindex = shown.address
    name = f"{index:04X}sub{subindex:X}" if subindex else f"{index:04X}"
    return (
        f"\n[{name}]\nParameterName=Object {name}\nObjectType=0x7\n"
        f"DataType=0x{_TYPES[shown.code]:04X}\nAccessType=ro\n"
        f"PDOMapping={int(shown.mappable)}\n"
    )
