"""Reads description and unit of a record's fields from its docstring, for the reference pages.

A record lists its fields under ``Attributes:``. The unit of a field is the ending of its name
(``speed_deg_s``) or follows the last comma of its first sentence ("Winding resistance, ohm.").
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import NamedTuple

SUFFIXES: Mapping[str, str] = {
    "N_m_s_rad": "N m s/rad",
    "V_s_rad": "V s/rad",
    "N_m_A": "N m/A",
    "kg_m2": "kg m^2",
    "kg_m3": "kg/m^3",
    "deg_s2": "deg/s^2",
    "rad_s2": "rad/s^2",
    "m_s2": "m/s^2",
    "deg_s": "deg/s",
    "rad_s": "rad/s",
    "s_rad": "s/rad",
    "kg_s": "kg/s",
    "mm_s": "mm/s",
    "m_s": "m/s",
    "J_kg": "J/kg",
    "V_A": "V/A",
    "1_s": "1/s",
    "N_m": "N m",
    "deg": "deg",
    "rad": "rad",
    "ohm": "ohm",
    "MPa": "MPa",
    "Pa": "Pa",
    "Hz": "Hz",
    "kg": "kg",
    "ms": "ms",
    "us": "us",
    "m3": "m^3",
    "A": "A",
    "C": "deg C",
    "H": "H",
    "K": "K",
    "N": "N",
    "V": "V",
    "m": "m",
    "s": "s",
}
"""Unit for each suffix of a field's name, the longest suffix first."""
_NO_UNIT = frozenset({"mu_s"})
"""Names from the paper with an ending that looks like a unit but is not a unit."""
UNITS = frozenset(
    {*SUFFIXES.values(), "kg/m^3", "N m", "deg C", "N s/m", "s/m", "bytes", "ns", "deg/s^2", "Bd"}
)
_ENTRY = re.compile(r"^(\w+):\s+(.*)$")
_SECTION = re.compile(r"^[A-Z]\w+:$")


class Meaning(NamedTuple):
    """Description and unit of one field.

    Attributes:
        text: Description of one or more sentences.
        unit: Unit; empty if the field has none.
    """

    text: str
    unit: str


def summary(record: type) -> str:
    """Return the description of a record: its docstring before the list of fields."""
    lines = inspect.cleandoc(record.__doc__ or "").split("\n")
    end = next((n for n, line in enumerate(lines) if _SECTION.match(line)), len(lines))
    return "\n".join(lines[:end]).strip()


def meanings(record: type) -> dict[str, Meaning]:
    """Return the meanings of a record's fields, including inherited fields, from the docstrings."""
    found: dict[str, Meaning] = {}
    for base in reversed(record.__mro__):
        for name, text in _attributes(base.__dict__.get("__doc__") or "").items():
            found[name] = _meaning(name, text)
    return found


def _attributes(docstring: str) -> dict[str, str]:
    """Return the text of each field in the section ``Attributes:``."""
    found: dict[str, str] = {}
    name, inside = "", False
    for line in inspect.cleandoc(docstring).split("\n"):
        if _SECTION.match(line):
            inside = line == "Attributes:"
        elif inside and line.strip():
            deep = len(line) - len(line.lstrip()) > len("    ")
            entry = None if deep else _ENTRY.match(line.strip())
            if entry is not None:
                name = entry[1]
                found[name] = entry[2]
            elif name:
                found[name] += f" {line.strip()}"
    return found


def _meaning(name: str, text: str) -> Meaning:
    text = text.replace("``", "`")
    first = re.match(r"[^.;]*(?:\.\d[^.;]*)*", text)
    head = "" if first is None else first[0]
    before, _, unit = head.rpartition(", ")
    if unit in UNITS:
        return Meaning(before + text[len(head) :], unit)
    if head in UNITS:
        return Meaning(text, head)
    return Meaning(text, unit_of(name))


def unit_of(name: str) -> str:
    """Return the unit from the suffix of a name; empty if the name states no unit."""
    if name in _NO_UNIT:
        return ""
    return next((unit for ending, unit in SUFFIXES.items() if name.endswith(f"_{ending}")), "")
