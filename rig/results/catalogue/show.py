"""Output of ``rig runs show``."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.places import is_file
from rig.common.tables import interval, number
from rig.results.catalogue.listing import (
    begun,
    head_record,
    masses,
    operators,
    place,
    run_record,
    state,
    verdict,
)
from rig.results.document import Block, Document, Items, Note, Picture, Section, Table, Verdict
from rig.runs.catalogue.entry import Constant, Details, Entry
from rig.runs.catalogue.verify import Verification
from rig.runs.run_file import read_record
from rig.runs.run_record import RunRecord

SHOW_SCHEMA = "loadrig.run_shown/1"
PAGES = (
    ("run.html", "how it ended, and its recordings"),
    ("report.html", "identification"),
    ("diagnosis/report.html", "diagnosis"),
    ("certificate.html", "certificate"),
    ("certificate.pdf", "certificate, for paper"),
)
"""Pages that a run folder may contain, and their content."""
FIGURE = "figures/stribeck_default.png"
"""Name of the figure that shows the result of an identified run."""


def show_document(root: Path, entry: Entry) -> Document:
    """Return all known properties of one run as a document."""
    folder = root / entry.folder
    details, record = entry.parsed(), _record(folder)
    blocks = [
        Section("", (_facts(root, entry, details),)),
        *([Section("Stages", (_stages(record),))] if record else []),
        *_weights(record),
        *_identified(entry, details),
        *_remarks(entry, record),
    ]
    pages = tuple((str(folder / name), text) for name, text in PAGES if is_file(folder / name))
    if pages:
        blocks.append(Section("Pages", (Items(pages),)))
    return Document(f"Run {place(root, entry)}", "", tuple(blocks), (*_figure(folder), *blocks))


def _record(folder: Path) -> RunRecord | None:
    try:
        return read_record(folder)
    except InputError:
        return None  # the entry says what the folder is


def _figure(folder: Path) -> Iterator[Section]:
    picture = stored_picture(folder, FIGURE, "Friction against speed, measured and fitted")
    if picture is not None:
        yield Section("", (picture,))


def stored_picture(folder: Path, name: str, caption: str) -> Picture | None:
    """Return a figure from a file of a run folder, or None if the file cannot be read."""
    try:
        data = (folder / name).read_bytes()
    except OSError:
        return None
    kept = "".join(c if c.isalnum() or c in ".-" else "_" for c in folder.name)
    return Picture(f"{Path(name).stem}_{kept}", caption, data)


def _facts(root: Path, entry: Entry, details: Details) -> Table:
    head = entry.head
    kind = {True: " (simulated)", False: " (REAL)", None: ""}[head.simulated]
    rows = [
        ("state", state(root, entry)),
        ("bench", (head.bench or "-") + kind),
        ("sequence", head.sequence or "-"),
        ("begun, UTC", begun(head) or "-"),
        ("operator", operators(head)),
        ("masses, kg", masses(head)),
        ("verdict", verdict(head)),
        *((role, name) for role, name in details.devices.items()),
        ("in words", head.message or head.problem or "-"),
        ("run.json, SHA-256", head.digest or "-"),
    ]
    return Table(("fact", "value"), tuple(rows), ())


def _stages(record: RunRecord) -> Table:
    rows = tuple(
        (s.name, s.stage, f"{s.weight_kg:g}", number(s.confirmed_kg), s.role, s.state)
        for s in record.stages
    )
    return Table(("stage", "load", "planned kg", "confirmed kg", "role", "state"), rows, (2, 3))


def _weights(record: RunRecord | None) -> Iterator[Section]:
    if record is not None and record.weights:
        rows = tuple(
            (
                str(w["stage"]),
                number(w["confirmed_kg"]),
                number(w["measured_kg"]),
                str(w["verdict"]),
            )
            for w in record.weights
        )
        header = ("stage", "confirmed kg", "by friction kg", "verdict")
        yield Section("Weight checks", (Table(header, rows, (1, 2)),))


def _identified(entry: Entry, details: Details) -> Iterator[Section]:
    if not entry.head.identified:
        return
    rows = tuple((name, *_cells(each)) for name, each in details.constants.items())
    header = ("constant", "value", "90 % interval", "unit", "note")
    blocks: list[Block] = [Table(header, rows, (1, 2))]
    if details.fit_rms is not None:
        blocks.append(Note(f"torque error {number(details.fit_rms, 3)} {details.fit_unit} rms"))
    yield Section(f"Constants, {entry.head.identified} method", tuple(blocks))


def _cells(each: Constant) -> tuple[str, ...]:
    note = "not identifiable" if each.value is None else "at a bound" if each.at_bound else ""
    return number(each.value), interval(each.low, each.high), each.unit, note


def _remarks(entry: Entry, record: RunRecord | None) -> Iterator[Section]:
    lines = [entry.head.problem, *entry.head.notes, *(record.warnings if record else ())]
    notes = tuple(Note(line, "warning") for line in lines if line)
    if notes:
        yield Section("", notes)


def show_record(root: Path, entry: Entry) -> dict[str, Any]:
    """Return the record of ``rig runs show --json``."""
    record = _record(root / entry.folder)
    return {
        **head_record(SHOW_SCHEMA),
        **run_record(root, entry),
        "details": json.loads(entry.details),
        "record": None if record is None else dataclasses.asdict(record),
    }


VERIFY_SCHEMA = "loadrig.verify/1"
_SHORT = 16


def verification_document(found: Sequence[Verification]) -> Document:
    """Return the verification of runs as a document."""
    sections = tuple(_section(each) for each in found)
    bad = [str(each.folder) for each in found if not each.good]
    statement = (
        f"Changed, damaged or incomplete: {', '.join(bad)}."
        if bad
        else "Every file with a recorded digest still has that digest."
    )
    headline = f"{len(found) - len(bad)} of {len(found)} runs are as recorded"
    verdict = Verdict(headline, statement, "open" if bad else "good")
    last = Section("", (verdict,))
    return Document("Verification of runs", "", (*sections, last), (last, *sections))


def _section(found: Verification) -> Section:
    rows = tuple(
        (each.file, each.finding.value, each.sha256[:_SHORT] or "-", each.by or "-", each.words)
        for each in found.files
    )
    cells = Table(("file", "found", "SHA-256 begins", "digest recorded in", "note"), rows, ())
    return Section(
        str(found.folder), (cells, *(Note(problem, "warning") for problem in found.problems))
    )


def verification_record(found: Sequence[Verification]) -> dict[str, Any]:
    """Return the record of ``rig runs verify --json``."""
    return {
        **head_record(VERIFY_SCHEMA),
        "good": all(each.good for each in found),
        "runs": [_run_record(each) for each in found],
    }


def _run_record(found: Verification) -> dict[str, Any]:
    return {
        "run": str(found.folder),
        "good": found.good,
        "problems": list(found.problems),
        "files": [
            {
                "file": each.file,
                "found": each.finding.value,
                "sha256": each.sha256,
                "recorded": each.recorded,
                "recorded_in": each.by,
                "note": each.words,
            }
            for each in found.files
        ],
    }
