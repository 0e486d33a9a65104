"""Texts for the properties of a run that several documents show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rig.common.provenance import utc_now, versions
from rig.runs.catalogue.entry import Entry, Head
from rig.runs.catalogue.select import state_of


def begun(head: Head) -> str:
    """Return the start time of a run to the minute, UTC."""
    return head.created[:16].replace("T", " ")


def operators(head: Head) -> str:
    """Return the operators of a run."""
    return ", ".join(head.operators) or "-"


def masses(head: Head) -> str:
    """Return the masses that hung on the lever, kg."""
    return ", ".join(f"{mass:g}" for mass in head.masses_kg) or "-"


def state(root: Path, entry: Entry) -> str:
    """Return how a run ended; for a folder without a complete run, the kind of the folder."""
    if entry.head.kind == "commissioning":
        return f"commissioning {entry.head.state}"
    return state_of(root, entry) if entry.head.kind == "run" else entry.head.kind.upper()


def verdict(head: Head) -> str:
    """Return acceptance, diagnosis and weight checks of a run as a short text."""
    weights = [f"weight {word}" for word in head.weights]
    words = [head.acceptance, head.diagnosis.replace("_", " "), *weights]
    return ", ".join(filter(None, words)) or "-"


def place(root: Path, entry: Entry) -> str:
    """Return the path of a run folder in the form that other commands accept."""
    return str(root / entry.folder)


def head_record(schema: str) -> dict[str, Any]:
    """Return the keys at the start of a result file on several runs."""
    known = versions()
    return {
        "schema": schema,
        "version": known["loadrig"],
        "versions": known,
        "created": utc_now().isoformat(timespec="seconds"),
    }
