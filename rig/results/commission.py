"""Protocol of a commissioning as result record and page."""

from __future__ import annotations

import difflib
from typing import Any

from rig.commissioning.commission import Commissioning
from rig.commissioning.record import StepRecord
from rig.commissioning.record import Verdict as Found
from rig.common.provenance import sha256, utc_now, versions
from rig.config.bench import Bench
from rig.config.configuration import Document as Loaded
from rig.results.document import Document, Items, Note, Section, Table
from rig.results.document import Verdict as Headline

COMMISSION_SCHEMA = "loadrig.commission/1"


def commission_record(
    result: Commissioning, bench: Loaded[Bench], seed: int, operator: str | None, new_file: str
) -> dict[str, Any]:
    """Return the record for the result file.

    Args:
        result: The commissioning.
        bench: The bench file at the start of the commissioning.
        seed: Seed of a simulated bench's noise.
        operator: Name of the operator, as given.
        new_file: The bench file that was written; empty for none.
    """
    return {
        "schema": COMMISSION_SCHEMA,
        "created": utc_now().isoformat(timespec="seconds"),
        "versions": versions(),
        "seed": seed,
        "operator": operator,
        "bench": bench.value.name,
        "bench_file": str(bench.path),
        "sha256": sha256(bench.path.read_bytes()),
        "real": not bench.value.simulated,
        "new_bench_file": new_file or None,
        **result.record(),
    }


def difference(before: str, after: str, name: str) -> str:
    """Return the corrections as a unified diff that ``patch`` accepts."""
    old, new = before.splitlines(keepends=True), after.splitlines(keepends=True)
    return "".join(difflib.unified_diff(old, new, fromfile=name, tofile=name))


def commission_document(
    result: Commissioning, bench: Loaded[Bench], operator: str | None, new_file: str
) -> Document:
    """Return the protocol as a document."""
    good = result.ending.value == "done" and not result.not_homed
    drive = "the drive was never energised" if result.safe is None else result.safe.message
    headline = Headline(
        "Every step was good" if good and not result.untried else _headline(result),
        f"{_words(result)} {drive[0].upper()}{drive[1:]}.",
        "good" if good else "found",
    )
    summary = Section("Commissioning", (headline, *_changes(result, new_file)))
    last = len(result.sessions)
    sections = [summary]
    for number, steps in enumerate(result.sessions, start=1):
        title = f"Steps, connection {number} of {last}" if last > 1 else "Steps"
        sections.append(Section(title, tuple(_step(step) for step in steps)))
    kind = "simulated" if bench.value.simulated else "REAL"
    who = f", by {operator}" if operator else ""
    subtitle = f"{kind} bench, {bench.path}{who}, {utc_now():%Y-%m-%d %H:%M} UTC"
    return Document(f"Commissioning of {bench.value.name}", subtitle, (summary,), tuple(sections))


def _words(result: Commissioning) -> str:
    if result.ending.value == "done" and result.not_homed:
        return f"{result.not_homed[0].upper()}{result.not_homed[1:]}."
    return result.words or "All steps are done."


def _headline(result: Commissioning) -> str:
    if result.ending.value == "done" and result.not_homed:
        return "Not as asked for: no homing"
    if result.ending.value == "done":
        return f"Good; not tried: {', '.join(result.untried)}"
    return f"Not finished: {result.ending.value}"


def _changes(result: Commissioning, new_file: str) -> tuple[Items | Note, ...]:
    if not result.changes:
        return (Note("no value of the bench file had to be corrected"),)
    shown = Items(tuple((f"{c.section}.{c.key}", str(c.value)) for c in result.changes))
    place = Note(f"with these values: {new_file}" if new_file else "no new bench file was written")
    return (Note("corrected values:"), shown, place)


def _step(step: StepRecord) -> Section:
    rows = tuple((item.name, item.value, item.unit) for item in step.measured)
    measured = (Table(("measured", "value", "unit"), rows, (1,)),) if rows else ()
    consent = f" Agreed to: {step.consent}." if step.consent else ""
    words = f"{step.verdict.value}: {step.words}"
    wrong = step.verdict is Found.WRONG
    return Section(
        step.name,
        (
            Note(f"{step.announced}{consent}", "aside"),
            *measured,
            Note(words, "warning" if wrong else "plain"),
        ),
    )
