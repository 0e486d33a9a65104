"""Output of ``rig runs list``."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rig.results.catalogue.words import begun, head_record, masses, operators, place, state, verdict
from rig.results.document import Document, Note, Section, Table
from rig.runs.catalogue.entry import Entry

LIST_SCHEMA = "loadrig.runs/1"
_HEADER = ("run", "begun, UTC", "bench", "sequence", "operator", "kg", "state", "verdict")
_MOST_PROBLEMS = 10


def listing_document(root: Path, entries: Sequence[Entry], hidden: int = 0) -> Document:
    """Return runs as a table, and the problems of folders that contain no complete run.

    Args:
        root: The searched folder.
        entries: The runs to show, the earliest first.
        hidden: Number of runs that the selection leaves out.
    """
    header, rows = _HEADER, [_row(root, entry) for entry in entries]
    cells = Table(header, tuple(rows), ())
    notes = [Note(line) for line in _count(entries, hidden)]
    problems = [
        Note(f"{place(root, e)}: {text}", "warning")
        for e in entries
        for text in ([e.head.problem] if e.head.problem else e.head.notes)
    ]
    copies = [Note(line, "aside") for line in _copies(root, entries)]
    few = problems[:_MOST_PROBLEMS]
    if len(problems) > len(few):
        few.append(Note(f"{len(problems) - len(few)} more problems; --json lists all", "warning"))
    shown = (cells,) if rows else (Note(f"{root}: no runs"),)
    return Document(
        f"Runs in {root}",
        "",
        (Section("", shown), Section("", (*notes, *few, *copies))),
        (Section("Runs", (cells, *notes)), *_problem_section((*problems, *copies))),
    )


def _problem_section(notes: Sequence[Note]) -> list[Section]:
    return [Section("Problems and copies", tuple(notes))] if notes else []


def _row(root: Path, entry: Entry) -> tuple[str, ...]:
    head = entry.head
    return (
        place(root, entry),
        begun(head) or "-",
        head.bench + ("" if head.simulated in (True, None) else " (REAL)") or "-",
        head.sequence or "-",
        operators(head),
        masses(head),
        state(root, entry),
        verdict(head),
    )


def _count(entries: Sequence[Entry], hidden: int) -> Iterator[str]:
    more = f"; {hidden} more do not match" if hidden else ""
    yield f"{len(entries)} run{'' if len(entries) == 1 else 's'}{more}"


def copies_of(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """Return the digest of each record that occurs in several folders, with these folders."""
    counted = Counter(entry.head.digest for entry in entries if entry.head.digest)
    same: dict[str, list[Entry]] = {}
    for entry in entries:
        if counted[entry.head.digest] > 1:
            same.setdefault(entry.head.digest, []).append(entry)
    return same


def _copies(root: Path, entries: Sequence[Entry]) -> Iterator[str]:
    for each in copies_of(entries).values():
        first, *others = (place(root, entry) for entry in each)
        yield f"{', '.join(others)}: a copy of {first}"


def listing_record(root: Path, entries: Sequence[Entry]) -> dict[str, Any]:
    """Return the record of ``rig runs list --json``."""
    return {
        **head_record(LIST_SCHEMA),
        "folder": str(root),
        "runs": [run_record(root, entry) for entry in entries],
    }


def run_record(root: Path, entry: Entry) -> dict[str, Any]:
    """Return the record of one run in a list."""
    head = dataclasses.asdict(entry.head)
    return {"run": place(root, entry), **head, "state": state(root, entry).lower()}
