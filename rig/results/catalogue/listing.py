"""Output of ``rig runs list``."""

from __future__ import annotations

import dataclasses
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from identification.plots.style import BLACK, BLUE, CYCLE, GREY, VERMILION, Figure, figure
from rig.common.errors import InputError
from rig.common.places import is_file
from rig.common.provenance import FRICTION_FIGURE, heading
from rig.common.tables import interval, number
from rig.results.document import Block, Document, Items, Note, Picture, Section, Table, columns
from rig.runs.catalogue.entry import Constant, Details, Entry, state_of
from rig.runs.run_file import read_record
from rig.runs.run_record import RunRecord

COLUMNS = ("run", "begun, UTC", "bench", "sequence", "operator", "kg", "state", "verdict")
"""Columns of every table of runs."""


def cells(root: Path, entry: Entry) -> dict[str, str]:
    """Return the facts of a run by :data:`COLUMNS`; without a run, its kind as state."""
    head = entry.head
    state = state_of(root, entry) if head.kind == "run" else head.kind.upper()
    if head.kind == "commissioning":
        state = f"commissioning {head.state}"
    verdicts = [head.acceptance, head.diagnosis.replace("_", " ")]
    verdicts += [f"weight {word}" for word in head.weights]
    values = (
        place(root, entry),
        head.created[:16].replace("T", " "),
        head.bench + ("" if head.simulated in (True, None) else " (REAL)"),
        head.sequence,
        ", ".join(head.operators),
        ", ".join(f"{mass:g}" for mass in head.masses_kg),
        state,
        ", ".join(filter(None, verdicts)),
    )
    return {name: value or "-" for name, value in zip(COLUMNS, values, strict=True)}


def place(root: Path, entry: Entry) -> str:
    """Return the path of a run folder in the form that other commands accept."""
    return str(root / entry.folder)


LIST_SCHEMA = "loadrig.runs/1"
_MOST_PROBLEMS = 10


def listing_document(
    root: Path, entries: Sequence[Entry], hidden: int = 0, earlier: int = 0
) -> Document:
    """Return runs as a table, and the problems of folders that contain no complete run.

    Args:
        root: Folder of the runs.
        entries: The listed runs.
        hidden: Number of runs that do not match the options.
        earlier: Number of runs that match and are not listed.
    """
    rows = tuple(tuple(cells(root, entry).values()) for entry in entries)
    listed = Table(COLUMNS, rows, ())
    more = f"; {earlier} earlier" if earlier else ""
    more += f"; {hidden} more do not match" if hidden else ""
    count = Note(f"{len(entries)} run{'' if len(entries) == 1 else 's'}{more}")
    problems = [
        Note(f"{place(root, e)}: {text}", "warning")
        for e in entries
        for text in ([e.head.problem] if e.head.problem else e.head.notes)
    ]
    copies = [
        Note(f"{', '.join(others)}: a copy of {first}", "aside")
        for each in copies_of(entries).values()
        for first, *others in [[place(root, entry) for entry in each]]
    ]
    few = problems[:_MOST_PROBLEMS]
    if len(problems) > len(few):
        few.append(Note(f"{len(problems) - len(few)} more problems; --json lists all", "warning"))
    shown = (listed,) if rows else (Note(f"{root}: no runs"),)
    all_ = tuple((*problems, *copies))
    return Document(
        f"Runs in {root}",
        "",
        (Section("", shown), Section("", (count, *few, *copies))),
        (
            Section("Runs", (listed, count)),
            *([Section("Problems and copies", all_)] if all_ else []),
        ),
    )


def copies_of(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """Return the digest of each record that occurs in several folders, with these folders."""
    counted = Counter(entry.head.digest for entry in entries if entry.head.digest)
    same: dict[str, list[Entry]] = {}
    for entry in entries:
        if counted[entry.head.digest] > 1:
            same.setdefault(entry.head.digest, []).append(entry)
    return same


def listing_record(root: Path, entries: Sequence[Entry]) -> dict[str, Any]:
    """Return the record of ``rig runs list --json``."""
    return {
        **heading(LIST_SCHEMA),
        "folder": str(root),
        "runs": [run_record(root, entry) for entry in entries],
    }


def run_record(root: Path, entry: Entry) -> dict[str, Any]:
    """Return the record of one run in a list."""
    head = dataclasses.asdict(entry.head)
    return {"run": place(root, entry), **head, "state": cells(root, entry)["state"].lower()}


_COLUMNS = 3
_LEAD_WIDTH = 5.2
"""Width of a figure that a page opens with, inches, at which it can be read on a telephone."""


def side_by_side(names: Sequence[str], runs: Mapping[str, Mapping[str, Constant]]) -> Figure:
    """Draw parameters in percent of the first run's values, with 90 % intervals."""
    height = 0.45 * len(names) + 0.2 * len(runs) + 1.0
    made, (axis,) = figure(1, width=_LEAD_WIDTH, height=height)
    first = next(iter(runs.values()))
    offset = 0.6 / len(runs)
    for k, (run, constants) in enumerate(runs.items()):
        places, values, below, above = [], [], [], []
        for row, name in enumerate(names):
            base, each = first[name].value, constants.get(name)
            if not base or each is None or each.value is None:
                continue
            low = each.value if each.low is None else each.low
            high = each.value if each.high is None else each.high
            places.append(row + (k - 0.5 * (len(runs) - 1)) * offset)
            values.append(100.0 * (each.value / base - 1.0))
            ends = sorted(100.0 * (end / base - 1.0) for end in (low, high))
            below.append(max(0.0, values[-1] - ends[0]))
            above.append(max(0.0, ends[1] - values[-1]))
        colour = CYCLE[k % len(CYCLE)]
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


SHOW_SCHEMA = "loadrig.run_shown/1"
PAGES = (
    ("run.html", "how it ended, and its recordings"),
    ("report.html", "identification"),
    ("diagnosis/report.html", "diagnosis"),
    ("certificate.html", "certificate"),
)
"""Pages that a run folder may contain, and their content."""


def show_document(root: Path, entry: Entry) -> Document:
    """Return all known properties of one run as a document."""
    folder = root / entry.folder
    details, record = entry.parsed(), _record(folder)
    blocks = [Section("", (_facts(root, entry, details),))]
    if record is not None:
        stages = columns(
            record.stages,
            (2, 3),
            ("stage", lambda s: s.name),
            ("load", lambda s: s.stage),
            ("planned kg", lambda s: f"{s.weight_kg:g}"),
            ("confirmed kg", lambda s: number(s.confirmed_kg)),
            ("role", lambda s: s.role),
            ("state", lambda s: s.state),
        )
        blocks.append(Section("Stages", (stages,)))
    if record is not None and record.weights:
        weights = columns(
            record.weights,
            (1, 2),
            ("stage", lambda w: str(w["stage"])),
            ("confirmed kg", lambda w: number(w["confirmed_kg"])),
            ("by friction kg", lambda w: number(w["measured_kg"])),
            ("verdict", lambda w: str(w["verdict"])),
        )
        blocks.append(Section("Weight checks", (weights,)))
    blocks += _identified(entry, details)
    lines = [entry.head.problem, *entry.head.notes, *(record.warnings if record else ())]
    if remarks := tuple(Note(line, "warning") for line in lines if line):
        blocks.append(Section("", remarks))
    if pages := tuple((str(folder / name), text) for name, text in PAGES if is_file(folder / name)):
        blocks.append(Section("Pages", (Items(pages),)))
    figure = stored_picture(folder, FRICTION_FIGURE, "Friction against speed, measured and fitted")
    lead = () if figure is None else (Section("", (figure,)),)
    return Document(f"Run {place(root, entry)}", "", tuple(blocks), (*lead, *blocks))


def _record(folder: Path) -> RunRecord | None:
    try:
        return read_record(folder)
    except InputError:
        return None  # the entry says what the folder is


def stored_picture(folder: Path, name: str, caption: str) -> Picture | None:
    """Return a figure from a file of a run folder, or None if the file cannot be read."""
    try:
        data = (folder / name).read_bytes()
    except OSError:
        return None
    kept = "".join(c if c.isalnum() or c in ".-" else "_" for c in folder.name)
    return Picture(f"{Path(name).stem}_{kept}", caption, data)


def _facts(root: Path, entry: Entry, details: Details) -> Table:
    head, known = entry.head, cells(root, entry)
    kind = {True: " (simulated)", False: " (REAL)", None: ""}[head.simulated]
    rows = [
        ("state", known["state"]),
        ("bench", (head.bench or "-") + kind),
        *((name, known[name]) for name in ("sequence", "begun, UTC", "operator")),
        ("masses, kg", known["kg"]),
        ("verdict", known["verdict"]),
        *((role, name) for role, name in details.devices.items()),
        ("in words", head.message or head.problem or "-"),
        ("run.json, SHA-256", head.digest or "-"),
    ]
    return Table(("fact", "value"), tuple(rows), ())


def _identified(entry: Entry, details: Details) -> Iterator[Section]:
    if not entry.head.identified:
        return
    constants = columns(
        details.constants.items(),
        (1, 2),
        ("constant", lambda c: c[0]),
        ("value", lambda c: number(c[1].value)),
        ("90 % interval", lambda c: interval(c[1].low, c[1].high)),
        ("unit", lambda c: c[1].unit),
        ("note", lambda c: _remark(c[1])),
    )
    blocks: list[Block] = [constants]
    if details.fit_rms is not None:
        blocks.append(Note(f"torque error {number(details.fit_rms, 3)} {details.fit_unit} rms"))
    yield Section(f"Constants, {entry.head.identified} method", tuple(blocks))


def _remark(each: Constant) -> str:
    return "not identifiable" if each.value is None else "at a bound" if each.at_bound else ""


def show_record(root: Path, entry: Entry) -> dict[str, Any]:
    """Return the record of ``rig runs show --json``."""
    record = _record(root / entry.folder)
    return {
        **heading(SHOW_SCHEMA),
        **run_record(root, entry),
        "details": json.loads(entry.details),
        "record": None if record is None else dataclasses.asdict(record),
    }
