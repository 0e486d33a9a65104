"""Collects bench, date and operator of the recordings, for the top of a page."""

from __future__ import annotations

from pathlib import Path

from rig.common.errors import InputError
from rig.common.input_files import is_folder
from rig.runs.catalogue.read import bench_name
from rig.runs.run_file import read_record


def facts_of(source: Path) -> tuple[tuple[str, str], ...]:
    """Return names and values of the known facts of a source: of a run, these are bench, date and
    operator; of a campaign, the file.
    """
    if not is_folder(source):
        return (("campaign", source.name),)
    try:
        record = read_record(source)
    except InputError:
        return (("run", source.name),)
    kind = "simulated" if record.simulated else "REAL BENCH"
    operators = [part.operator for part in record.parts if part.operator]
    return (
        ("bench", f"{bench_name(source, record)} ({kind})"),
        ("begun", record.created.replace("T", " ").replace("+00:00", " UTC")),
        ("operator", ", ".join(dict.fromkeys(operators)) or record.operator or "not given"),
        ("sequence", record.name),
    )
