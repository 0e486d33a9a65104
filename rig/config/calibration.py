"""Checks the due dates of a bench's calibrations, and lists the calibrations for the run record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

from rig.config.bench import Bench
from rig.config.configuration import Document


def calibration_records(bench: Bench, today: date) -> list[Mapping[str, Any]]:
    """Return the bench's calibrations for ``run.json``; a calibration is valid on its due day."""
    return [
        {"device": c.device, "id": c.id, "due": c.due.isoformat(), "overdue": c.due < today}
        for c in bench.calibrations
    ]


def overdue(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a message for each overdue calibration."""
    return [
        f"calibration {c['id']} of {c['device']} was due on {c['due']}"
        for c in records
        if c["overdue"]
    ]


def overdue_problems(document: Document[Bench], today: date) -> list[str]:
    """Return the overdue calibrations that prevent a run, each with its place in the bench file.

    The list is empty if the bench file permits runs with overdue calibrations.
    """
    bench = document.value
    if bench.overdue_calibration != "refuse":
        return []
    return [
        document.problem(
            ("calibrations", index, "due"),
            f"calibration {item.id} of {item.device} is overdue, and overdue_calibration is "
            "`refuse`; have the device calibrated",
        )
        for index, item in enumerate(bench.calibrations)
        if item.due < today
    ]
