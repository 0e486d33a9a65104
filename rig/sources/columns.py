"""Guesses the channel of each column of a recording from the names and units of the columns."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from identification.model.parameters import unit_on
from identification.recording import CHANNELS
from rig.config.campaign_sections import RecordingSection
from rig.sources.table import Table

_DEG, _TURN = math.pi / 180.0, 2.0 * math.pi
_SPELLED: Final[Mapping[str, Mapping[str, float]]] = {
    "s": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "ns": 1e-9}
    | dict.fromkeys(("us", "µs", "\u03bcs"), 1e-6),
    "A": {"a": 1.0, "ma": 1e-3},
    "V": {"v": 1.0, "mv": 1e-3},
    "rad": {"rad": 1.0, "mrad": 1e-3}
    | dict.fromkeys(("deg", "degrees", "°"), _DEG)
    | dict.fromkeys(("rev", "turns"), _TURN),
    "rad/s": {"rad/s": 1.0, "deg/s": _DEG, "°/s": _DEG, "rpm": _TURN / 60.0, "1/min": _TURN / 60.0},
    "m": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "N m": {"nm": 1.0, "mnm": 1e-3},
    "N": {"n": 1.0, "kn": 1e3},
    "deg C": {"c": 1.0, "degc": 1.0, "°c": 1.0},
    "Pa": {"pa": 1.0, "kpa": 1e3, "mpa": 1e6, "bar": 1e5},
}
UNITS: Final[Mapping[str, tuple[str, float]]] = {
    word: (si, scale) for si, words in _SPELLED.items() for word, scale in words.items()
}
"""SI unit and scale for each unit as files write it (lower case, no blanks)."""
_NAMES: Final[Mapping[str, str]] = {
    "time": r"t|time|timestamp|zeit|stamp|seconds|elapsed",
    "supply_voltage": r"supply|u_?dc|v_?dc|vbus|dc_?link|battery",
    "voltage": r"u|v|volt|voltage|u_?m|u_?motor|motor_?voltage|spannung",
    "current": r"i|iq|i_?q|current|i_?meas|i_?m|i_?motor|motor_?current|cur|strom",
    "torque": r"torque|trq|tau|m_?d|moment|drehmoment|force|effort",
    "motor_angle": r"motor_?(angle|pos|position)|phi_?m|theta_?m|(pos|position|angle)_?motor",
    "command": r"command|cmd|target|setpoint|reference|ref|desired|goal"
    r"|(pos|position|angle)_?(ref|cmd|des)",
    "angle": r"angle|pos|position|phi|theta|q|winkel|joint|joint_?angle"
    r"|(pos|position|angle)_?(joint|load)",
    "velocity": r"velocity|vel|speed|omega|dq|qd|dphi|dtheta|drehzahl",
    "load_force": r"load_?force|f_?load",
    "temperature": r"temp|temperature|t_?motor",
    "pressure": r"p|pressure|druck|chamber_?pressure",
}
"""Usual column names of each channel; more specific channels come first."""


class Guess(NamedTuple):
    """Column that is guessed for a channel, and its scale to SI."""

    column: str | int
    scale: float


def split_unit(name: str) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit in lower case; the unit is empty if the
    name has no unit.

    ``current [mA]``, ``current (mA)``, ``current/mA`` and ``current_mA`` name a unit.
    """
    found = re.fullmatch(r"\s*(.*?)\s*[\[(]([^\])]*)[\])]\s*", name)
    if found is None:
        # "i_m" is a motor current: the letter m counts as a unit in brackets only.
        for unit in sorted(UNITS.keys() - {"m"}, key=len, reverse=True):
            tail = re.fullmatch(rf"\s*(.+?)[_/ ]{re.escape(unit)}\s*", name, re.IGNORECASE)
            tail = tail or re.fullmatch(
                rf"\s*(.+?)[_/ ]{re.escape(unit.replace('/', '_'))}\s*", name, re.IGNORECASE
            )
            if tail is not None:
                return tail[1].strip(), unit
        return name.strip(), ""
    unit = found[2].lower().replace(" ", "").replace("*", "").replace("·", "").replace(".", "")
    return found[1].strip(), unit


def channel_unit(channel: str, linear: bool = False) -> str:
    """Return a channel's SI unit; channels of the motor are rotary also on a linear bench."""
    if channel == "motor_angle":
        return CHANNELS[channel]
    return unit_on("linear" if linear else "rotary", CHANNELS[channel])


def scale_of(name: str, channel: str, linear: bool = False) -> float:
    """Return the scale to SI from the unit in a column's name; 1 without a unit."""
    unit, scale = UNITS.get(split_unit(name)[1], ("", 1.0))
    return scale if unit == channel_unit(channel, linear) else 1.0


def guess_channels(names: Iterable[str], linear: bool = False) -> dict[str, Guess]:
    """Return the channels of columns with these names, a column at most once; "" has no name."""
    columns = [(name, *split_unit(name)) for name in names if name]
    found: dict[str, Guess] = {}
    taken: set[str] = set()
    for channel, pattern in _NAMES.items():
        unit = channel_unit(channel, linear)
        for column, bare, stated in columns:
            word = re.sub(r"[\s\-.]+", "_", bare.lower()).strip("_")
            # The scale of an unknown unit is unknown, so that the column is not used.
            si, scale = UNITS.get(stated, ("", 1.0)) if stated else (unit, 1.0)
            if column in taken or not re.fullmatch(f"{channel}|{pattern}", word) or si != unit:
                continue
            found[channel] = Guess(column, scale)
            taken.add(column)
            break
    return found


def is_linear(names: Iterable[str]) -> bool:
    """Return whether a column has a unit of length or of linear speed, as on a linear bench."""
    return any(
        UNITS.get(split_unit(name)[1], ("", 1.0))[0] in ("m", "m/s") for name in names if name
    )


def guess_mass(stem: str) -> float:
    """Return the mass on the lever from a file's name, kg; 0 if the name states no mass."""
    found = re.search(r"(?<![\d.,])(\d+(?:[.,p]\d+)?)\s*_?kg", stem, re.IGNORECASE)
    return float(re.sub("[,p]", ".", found[1])) if found else 0.0


def unit_row_doubts(table: Table, section: RecordingSection, linear: bool = False) -> Iterator[str]:
    """Yield a note for each channel with scale 1 whose unit in the row of units is not SI."""
    if not table.units:
        return
    for name, channel in section.channels.items():
        column = channel.column
        if isinstance(column, str) and column not in table.names:
            continue
        place = column if isinstance(column, int) else table.names.index(column)
        if place >= len(table.units) or channel.scale != 1.0:
            continue
        unit = table.units[place].strip("[]() ")
        si, size = UNITS.get(split_unit(f"x [{unit}]")[1], ("", 1.0))
        if size != 1.0 and name in CHANNELS and si == channel_unit(name, linear):
            yield (
                f"`{name}` is in {unit} by the file's row of units, but its scale is 1: set the "
                f"scale to {size:.10g}"
            )
