"""Output of ``rig runs verify``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rig.results.catalogue.words import head_record
from rig.results.document import Document, Note, Section, Table, Verdict
from rig.runs.catalogue.verify import Verification

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
