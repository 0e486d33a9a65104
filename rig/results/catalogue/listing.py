"""Output of ``rig runs list``."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from identification.plots.style import BLACK, BLUE, CYCLE, GREY, VERMILION, Figure, figure
from rig.common.provenance import utc_now, versions
from rig.results.document import Document, Note, Section, Table
from rig.runs.catalogue.entry import Constant, Entry, Head, state_of


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


_COLUMNS = 3
_LEAD_WIDTH = 5.2
"""Width of a figure that a page opens with, inches, at which it can be read on a telephone."""


def side_by_side(names: Sequence[str], runs: Mapping[str, Mapping[str, Constant]]) -> Figure:
    """Draw the parameters of several runs in percent of the first run's values, with 90 %
    intervals.
    """
    height = 0.45 * len(names) + 0.2 * len(runs) + 1.0
    made, (axis,) = figure(1, width=_LEAD_WIDTH, height=height)
    first = next(iter(runs.values()))
    offset = 0.6 / len(runs)
    for number, (run, constants) in enumerate(runs.items()):
        places, values, below, above = [], [], [], []
        for row, name in enumerate(names):
            base, each = first[name].value, constants.get(name)
            if not base or each is None or each.value is None:
                continue
            low = each.value if each.low is None else each.low
            high = each.value if each.high is None else each.high
            places.append(row + (number - 0.5 * (len(runs) - 1)) * offset)
            values.append(100.0 * (each.value / base - 1.0))
            ends = sorted(100.0 * (end / base - 1.0) for end in (low, high))
            below.append(max(0.0, values[-1] - ends[0]))
            above.append(max(0.0, ends[1] - values[-1]))
        colour = CYCLE[number % len(CYCLE)]
        axis.errorbar(
            values, places, xerr=(below, above), fmt="o", color=colour, capsize=3, label=run
        )
    axis.axvline(0.0, color=GREY, linewidth=0.8)
    axis.set_yticks(range(len(names)), names)
    axis.invert_yaxis()
    axis.set_xlabel("difference from the first run (%), 90 % intervals")
    axis.legend(fontsize=8, frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    return made


def courses(
    histories: Mapping[str, Mapping[int, Constant]], alarms: Mapping[str, int | None]
) -> Figure:
    """Draw each parameter over the runs with its intervals; detected changes are red.

    Args:
        histories: Index of a run and value of the constant in that run, in the order of time, by
            the name of the constant.
        alarms: Names of the constants that changed; for a step, the number of the first value
            after the step, for a drift None.
    """
    rows = math.ceil(len(histories) / _COLUMNS)
    size = (_LEAD_WIDTH, 3.4) if len(histories) == 1 else (10.0, 2.3 * rows)
    made, axes = figure(rows, min(_COLUMNS, len(histories)), width=size[0], height=size[1])
    for axis, (name, history) in zip(axes, histories.items(), strict=False):
        places = [index + 1 for index in history]
        constants = list(history.values())
        values = [math.nan if each.value is None else each.value for each in constants]
        halves = [each.half_width or 0.0 for each in constants]
        colour = VERMILION if name in alarms else BLUE
        axis.errorbar(places, values, yerr=halves, fmt="o", color=colour, capsize=2, markersize=4)
        start = alarms.get(name)
        if start is not None:
            axis.axvline(places[start] - 0.5, color=BLACK, linestyle="--", linewidth=0.9)
        words = "" if name not in alarms else ": DRIFT" if start is None else ": STEP"
        axis.set_title(f"{name} ({constants[0].unit}){words}", fontsize=9)
        axis.tick_params(labelsize=8)
        axis.locator_params(axis="x", integer=True)
    for axis in axes[len(histories) :]:
        axis.set_axis_off()
    made.supxlabel("run", fontsize=9)
    return made
