"""Limits of acceptance for a finished run, written as text and validated before the run."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator

from identification.model.parameters import LOAD_PARAMETERS, SYSTEM_PARAMETERS

NOTHING_MISSING = "nothing missing"
WEIGHT_CHECK = "weight check passed"
CONSTANTS = (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS)


@dataclass(frozen=True)
class Measure:
    """A quantity of a run that can be limited."""

    statistics: tuple[str, ...]
    dimension: str  # dimension of the quantity, a key of `UNITS`
    meaning: str


MEASURES: Mapping[str, Measure] = {
    "lateness": Measure(
        ("p50", "p99", "worst"), "time", "delay of the start of a control cycle; quantiles to 1 %"
    ),
    "answer": Measure(
        ("p50", "p99", "worst"),
        "time",
        "age of a sample when the program checks it; quantiles to 1 %",
    ),
    "tracking error": Measure(("rms", "worst"), "angle", "command minus joint angle"),
    "disagreement": Measure(("rms", "worst"), "angle", "drive's encoder minus joint encoder"),
    "current": Measure(("rms", "worst"), "current", "magnitude of the motor current"),
    "temperature": Measure(("worst",), "temperature", "motor temperature"),
    "torque error": Measure(("rms",), "torque", "torque error of the identified model"),
    "lost samples": Measure((), "", "samples of drive and encoder that were lost"),
    "missed SYNCs": Measure((), "", "control cycles that were skipped"),
}
"""Quantities by name; tracking error to temperature are measured only during excitations."""
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.radians(1.0)},
    "current": {"A": 1.0, "mA": 1e-3},
    "temperature": {"deg C": 1.0, "C": 1.0},
    "torque": {"N m": 1.0, "mN m": 1e-3, "Nm": 1.0},
    "": {"": 1.0},
}
"""Units of each dimension, with their scale to SI; the first unit is that of results."""


@dataclass(frozen=True)
class Range:
    """A constant whose whole 90 % interval must lie within a range."""

    text: str
    name: str
    low: float  # lower end, in the constant's SI unit; minus infinity if open
    high: float  # upper end; infinity if open


@dataclass(frozen=True)
class Required:
    """A verdict that the run must have: :data:`NOTHING_MISSING` or :data:`WEIGHT_CHECK`."""

    text: str


@dataclass(frozen=True)
class Bound:
    """A quantity that must stay below (or above) a value."""

    text: str
    measure: str  # quantity, a key of `MEASURES`
    statistic: str  # statistic of the measure that is compared; empty for a count
    below: bool  # whether the value is an upper limit
    inclusive: bool  # whether the limit itself is allowed
    value: float
    unit: str

    @property
    def scale(self) -> float:
        """Scale from ``unit`` to SI."""
        return UNITS[MEASURES[self.measure].dimension][self.unit]

    def holds(self, value: float) -> bool:
        """Return whether a value in ``unit`` is within the limit."""
        if self.inclusive and value == self.value:
            return True
        return value < self.value if self.below else value > self.value


Limit = Range | Required | Bound
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})?\s*\.\.\s*({_NUMBER})?")
_BOUND = re.compile(rf"([A-Za-z0-9 ]+?)\s*(<=|>=|<|>)\s*({_NUMBER})\s*(.*)")


def parse_limit(text: str) -> Limit:
    """Return the limit that a line states; the ValueError has the forms and the nearest name."""
    line = " ".join(text.split())
    if line in (NOTHING_MISSING, WEIGHT_CHECK):
        return Required(line)
    name, colon, rest = line.partition(":")
    if colon:
        return _range(line, name.strip(), rest.strip())
    match = _BOUND.fullmatch(line)
    if match is None:
        raise ValueError(
            f"{line!r} is no limit; write `Mc: 6.5..7.1`, `{NOTHING_MISSING}`, "
            f"`{WEIGHT_CHECK}` or `p99 lateness < 1 ms`"
        )
    return _bound(line, *match.groups())


def _range(line: str, name: str, rest: str) -> Range:
    if name not in CONSTANTS:
        raise ValueError(f"{name!r} is no constant; {_nearest(name, CONSTANTS)}")
    match = _RANGE.fullmatch(rest)
    if match is None or not any(match.groups()):
        raise ValueError(
            f"{rest!r} is no range; write for example `{name}: 6.5..7.1`; one end may be left out"
        )
    low, high = (float(end) if end else math.inf for end in match.groups())
    low = low if match[1] else -math.inf
    if not low < high:
        raise ValueError(f"the range {rest} is empty; the lower end must be below the upper end")
    return Range(line, name, low, high)


def _bound(line: str, quantity: str, sign: str, number: str, unit: str) -> Bound:
    words = quantity.split()
    statistic = next((w for w in (words[0], words[-1]) if w in ("p50", "p99", "rms", "worst")), "")
    if statistic:
        words.remove(statistic)
    name = " ".join(words)
    measure = MEASURES.get(name)
    if measure is None:
        raise ValueError(f"{name!r} is no quantity of a run; {_nearest(name, MEASURES)}")
    if statistic not in (measure.statistics or ("",)):
        forms = " or ".join(f"{name} {each}".strip() for each in measure.statistics or ("",))
        raise ValueError(f"{quantity!r} cannot be limited; write {forms}")
    units = UNITS[measure.dimension]
    if unit not in units:
        wanted = " or ".join(filter(None, units)) or "none"
        raise ValueError(f"{unit!r} is no unit of {name}; use {wanted}")
    return Bound(line, name, statistic, sign[0] == "<", len(sign) == 2, float(number), unit)


def _nearest(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), 1)
    return f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"


def _line(item: str | Mapping[str, str]) -> str:
    """Return an item as text; YAML reads `Mc: 6.5..7.1` without quotes as a mapping."""
    if isinstance(item, str):
        return item
    if len(item) != 1:
        raise ValueError(f"{len(item)} limits in one item; begin each limit with a dash")
    ((name, rest),) = item.items()
    return f"{name}: {rest}"


def _acceptable(item: str | Mapping[str, str]) -> str | Mapping[str, str]:
    parse_limit(_line(item))
    return item


LimitLine = Annotated[str | Mapping[str, str], AfterValidator(_acceptable)]
"""Type of a limit as written, after a check that the limit is valid."""


def limits_of(lines: Iterable[str | Mapping[str, str]]) -> tuple[Limit, ...]:
    """Return validated lines as limits."""
    return tuple(parse_limit(_line(line)) for line in lines)
