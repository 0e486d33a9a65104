"""Shows the catalogue of effects as table, text and JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import Any

from identification.effects import EFFECTS
from identification.effects.effect import Effect, Quantity
from rig.common.errors import InputError
from rig.common.provenance import utc_now, versions
from rig.common.tables import table
from rig.config.configuration import nearest

EFFECTS_SCHEMA = "loadrig.effects/1"
_WIDTH = 100
_LABEL = 18


def entry_of(name: str) -> Effect:
    """Return one entry of the catalogue.

    Raises:
        InputError: The effect does not exist; the message suggests the nearest name.
    """
    if name not in EFFECTS:
        raise InputError(f"{name}: not an effect of the catalogue; {nearest(name, list(EFFECTS))}")
    return EFFECTS[name]


def overview(entries: Iterable[Effect]) -> str:
    """Return one line for each effect: its location and its fitted parameters."""
    rows = [
        (
            e.group,
            e.name,
            e.shows_in,
            e.coordinate.partition(":")[0],
            ", ".join(q.name for q in e.parameters),
        )
        for e in entries
    ]
    return table(("group", "effect", "equation", "against", "parameters"), rows)


def whole(entry: Effect) -> str:
    """Return the whole catalogue entry of one effect."""
    lines = [
        ("effect", f"{entry.name} ({entry.group})"),
        ("equation", entry.equation),
        ("breaks", entry.assumption),
        ("shows in", f"the {entry.shows_in} equation, against {entry.coordinate}"),
        *(("parameter" if k == 0 else "", _quantity(q)) for k, q in enumerate(entry.parameters)),
        ("look-alikes", ", ".join(entry.look_alikes)),
        ("distinguished by", entry.experiment),
        ("finding", entry.sentence),
    ]
    return "\n".join(_wrapped(label, text) for label, text in lines)


def effects_record(entries: Iterable[Effect]) -> dict[str, Any]:
    """Return the record of ``rig effects --json``."""
    known = versions()
    return {
        "schema": EFFECTS_SCHEMA,
        "version": known["loadrig"],
        "versions": known,
        "created": utc_now().isoformat(timespec="seconds"),
        "effects": [_entry_record(e) for e in entries],
    }


def _entry_record(entry: Effect) -> dict[str, Any]:
    return {
        "name": entry.name,
        "group": entry.group,
        "equation": entry.equation,
        "assumption_broken": entry.assumption,
        "shows_in": entry.shows_in,
        "coordinate": entry.coordinate,
        "parameters": {
            q.name: {"unit": q.unit, "low": q.low, "high": q.high} for q in entry.parameters
        },
        "look_alikes": list(entry.look_alikes),
        "separating_experiment": entry.experiment,
        "statement": entry.sentence,
    }


def _quantity(q: Quantity) -> str:
    unit = f" {q.unit}" if q.unit else ""
    return f"{q.name}: plausible from {q.low:.4g} to {q.high:.4g}{unit}"


def _wrapped(label: str, text: str) -> str:
    return textwrap.fill(
        text, _WIDTH, initial_indent=f"{label:<{_LABEL}}", subsequent_indent=" " * _LABEL
    )
