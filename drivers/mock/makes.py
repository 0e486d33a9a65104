"""EDS files of the simulated drive with the objects that drives of common makes have.

For each make, the module lists the objects of the simulated drive that the EDS file of the make
lacks.

A simulated drive with such an EDS file has only the objects of that file. The lists are from files
of the makers; objects that exist in the simulated drive alone are missing in all of them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from drivers.mock.drive import DRIVE_EDS

_OWN: Final = frozenset({0x2100, 0x2101})
LACKS: Final[Mapping[str, frozenset[int]]] = {
    "EPOS4": _OWN | {0x1009, 0x100A, 0x1013, 0x6072, 0x6073, 0x6075, 0x6078, 0x6079, 0x60C2},
    "Elmo": _OWN | {0x1013, 0x6079},
    "Trinamic": _OWN | {0x1013, 0x6007, 0x603F, 0x6073, 0x6075, 0x6076, 0x6078, 0x6079, 0x607F},
    "Faulhaber": _OWN
    | {0x1013, 0x6007, 0x603F, 0x605A, 0x6065, 0x6072, 0x6073, 0x6075, 0x6076}
    | {0x6078, 0x6079, 0x60C2},
    "Schunk": _OWN
    | {0x1013, 0x6007, 0x603F, 0x605A, 0x6072, 0x6076, 0x6078, 0x6079, 0x607F, 0x6085},
}
"""Indices that are missing, by make."""
_HEAD: Final = re.compile(r"\[([0-9A-Fa-f]{4})(?:sub[0-9A-Fa-f]+)?\]\s*$")


def description(make: str) -> str:
    """Return the text of the EDS file for a make: that of the simulated drive without the missing
    objects.
    """
    kept, keep = [], True
    for line in DRIVE_EDS.read_text(encoding="ascii").splitlines():
        if line.startswith("["):
            head = _HEAD.match(line)
            keep = head is None or int(head[1], 16) not in LACKS[make]
        if keep:
            kept.append(line)
    return "\n".join(kept) + "\n"
