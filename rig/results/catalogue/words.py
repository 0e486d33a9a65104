"""Words for the properties of a run that several documents show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.common.provenance import utc_now, versions
from rig.runs.catalogue.entry import Entry, Head
from rig.runs.catalogue.select import state_of


def begun(head: Head) -> str:
    """Return the time of the start to the minute, UTC."""
    return head.created[:16].replace("T", " ")


def operators(head: Head) -> str:
    """Return who ran it."""
    return ", ".join(head.operators) or "-"


def masses(head: Head) -> str:
    """Return the masses on the lever, kg."""
    return ", ".join(f"{mass:g}" for mass in head.masses_kg) or "-"


def state(root: Path, entry: Entry) -> str:
    """Return how it ended, or what else the folder is."""
    return state_of(root, entry) if entry.head.kind == "run" else entry.head.kind.upper()


def verdict(head: Head) -> str:
    """Return acceptance, diagnosis and weight checks in a few words."""
    weights = [f"weight {word}" for word in head.weights]
    words = [head.acceptance, head.diagnosis.replace("_", " "), *weights]
    return ", ".join(filter(None, words)) or "-"


def place(root: Path, entry: Entry) -> str:
    """Return the path of the folder, as it can be given to other commands."""
    return str(root / entry.folder)


def head_record(schema: str) -> dict[str, Any]:
    """Return the head of a result file that is made of many runs."""
    known = versions()
    return {
        "schema": schema,
        "version": known["loadrig"],
        "versions": known,
        "created": utc_now().isoformat(timespec="seconds"),
    }
