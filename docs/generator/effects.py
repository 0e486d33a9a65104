"""Page of the catalogue of effects: what a diagnosis can identify and a simulated bench can
hide.
"""

from __future__ import annotations

from collections.abc import Iterator

from keys import table

from drivers.mock.plant.effects.gas import GAS_CATALOGUE
from drivers.mock.plant.effects.table import CATALOGUE
from identification.effects import EFFECTS
from identification.effects.effect import Effect

_HIDDEN = {**CATALOGUE, **GAS_CATALOGUE}
_INTRO = """\
Each entry is one kind of physics that the nominal model leaves out. `rig diagnose` tests all
entries; `rig effects NAME` prints one entry.

On a simulated bench the key `mock.effects` of the bench file injects effects, for example
`effects: {backlash: {gap_rad: 0.007}}`. *Plausible* is the range that a diagnosis accepts,
*simulated* the range that a bench file accepts. A parameter without a plausible range is for the
simulated bench only. Sizes are at the joint unless the name states another place; `recording`
counts the power-ons of a simulated bench from 1."""


def page() -> str:
    """Return the page."""
    parts = ["# Catalogue of effects", _INTRO]
    groups = list(dict.fromkeys(entry.group for entry in EFFECTS.values()))
    for group in groups:
        parts.append(f"## {group.capitalize()}")
        for entry in EFFECTS.values():
            if entry.group == group:
                parts += _entry(entry)
    return "\n\n".join(parts) + "\n"


def _entry(entry: Effect) -> Iterator[str]:
    yield f"### {entry.name}"
    yield table(
        ("", ""),
        [
            ("equation", _plain(entry.equation)),
            ("breaks", _plain(entry.assumption)),
            ("shows in", f"the {entry.shows_in} equation, against {_plain(entry.coordinate)}"),
            ("look-alikes", ", ".join(f"[{name}](#{name})" for name in entry.look_alikes)),
            ("separating experiment", _plain(entry.experiment)),
        ],
    )
    simulated = _HIDDEN.get(entry.name, {})
    found = {q.name: q for q in entry.parameters}
    rows = []
    for name in dict.fromkeys((*found, *simulated)):
        quantity, hidden = found.get(name), simulated.get(name)
        rows.append(
            (
                f"`{name}`",
                "" if quantity is None else quantity.unit,
                "" if quantity is None else f"{quantity.low:.4g} to {quantity.high:.4g}",
                "" if hidden is None else f"{hidden.low:.4g} to {hidden.high:.4g}",
            )
        )
    yield table(("parameter", "unit", "plausible", "simulated"), rows)


def _plain(text: str) -> str:
    """Return text whose signs Markdown leaves alone."""
    return text.replace("*", "\\*").replace("_", "\\_").replace("<", "&lt;").replace("$", "\\$")
