"""Stores dates and durations apart from results, so that repeated results have equal bytes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.common.input_files import is_file, read_json

TIMES = "times"
"""Folder of a proof with date and durations of every trial, which differ if a proof is repeated."""
FIELDS = ("created", "seconds", "baseline_seconds")


def without_times(record: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a record without date and durations, and a record of date and durations alone."""
    kept = {name: value for name, value in record.items() if name not in FIELDS}
    return kept, {name: record[name] for name in FIELDS if name in record}


def timed_row(out: Path, name: str) -> dict[str, Any]:
    """Return the row of a trial with its durations.

    Args:
        out: Folder of the proof.
        name: Name of the trial's files.

    Raises:
        InputError: A file is missing or damaged.
    """
    row = dict(read_json(out / "rows" / f"{name}.json"))
    beside = out / TIMES / f"{name}.json"
    spent = read_json(beside) if is_file(beside) else {}
    return row | {key: spent.get(key, row.get(key, 0.0)) for key in FIELDS if key != "created"}
