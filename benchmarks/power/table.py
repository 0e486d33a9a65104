"""The map as numbers: least sizes over injected ones, by effect, axis and value, with quartiles
over machines.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.power.axes import AXES, BASE, base_world
from benchmarks.power.sizes import PARAMETER, injected, strength

Machine = dict[str, Any]
Key = tuple[str, str]
"""Axis and value."""


class Spread(NamedTuple):
    """Quartiles over machines; infinity where an effect is not shown."""

    low: float
    middle: float
    high: float


def machines_of(out: Path) -> list[Machine]:
    """Read the machines of a map, in order; the sizes that proofs inject are drawn again."""
    found = []
    for file in sorted(out.glob("*-[0-9][0-9][0-9].json")):
        machine = json.loads(file.read_text())
        base = base_world(machine["seed"], machine["number"])
        found.append({**machine, "injected": injected(base, list(PARAMETER))})
    return found


def ratios(machine: Machine, effect: str) -> dict[Key, float]:
    """Return the least size over the middle injected one, for each axis and value; infinity where
    the recordings cannot show the effect.
    """
    middle = machine["injected"][effect]["strength"][1]
    found = {}
    for cell in machine["cells"]:
        least = (cell["least"] or {}).get(effect)
        size = strength(effect, least, cell["labels"]) if least else math.inf
        found[(cell["axis"], cell["value"])] = size / middle if size == size else math.inf
    for axis, value in BASE.items():
        found[(axis, value)] = found[("base", "base")]
    return found


def spread(values: Sequence[float]) -> Spread:
    """Return quartiles that are values themselves, so that infinity is one of them."""
    return Spread(*np.quantile(values, (0.25, 0.5, 0.75), method="inverted_cdf").tolist())


def table(machines: Sequence[Machine]) -> dict[str, dict[Key, Spread]]:
    """Return the quartiles for each effect, axis and value."""
    found = {}
    for effect in PARAMETER:
        each = [ratios(machine, effect) for machine in machines]
        found[effect] = {key: spread([one[key] for one in each]) for key in each[0]}
    return found


def natural(machines: Sequence[Machine], effect: str) -> tuple[Spread | None, Spread]:
    """Return the least value that the base worlds show, and the one that proofs inject."""
    name = PARAMETER[effect]
    bases = [m["cells"][0]["least"] or {} for m in machines]
    values = [abs(least[effect][name]) for least in bases if least.get(effect)]
    given = [m["injected"][effect]["value"][1] for m in machines]
    return (spread(values) if 2 * len(values) > len(bases) else None), spread(given)


def decisive(cells: dict[Key, Spread]) -> tuple[str, float]:
    """Return the axis over which the median of an effect varies most, among the values at which
    the effect is shown, and the factor.
    """
    factors = {}
    for axis, values in AXES.items():
        middles = [cells[(axis, value)].middle for value in values]
        shown = [m for m in middles if math.isfinite(m)]
        factors[axis] = max(shown) / min(shown) if shown else 1.0
    axis = max(factors, key=lambda a: factors[a])
    return axis, factors[axis]
