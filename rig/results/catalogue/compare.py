"""Output of ``rig runs compare``: measured values of several runs and, of the identified runs, the
identified parameters that changed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.tables import CHANGED, NO_CHANGE, interval, number
from rig.config.acceptance import MEASURES, UNITS
from rig.results.catalogue.listing import (
    COLUMNS,
    FIGURE,
    cells,
    head_record,
    side_by_side,
    stored_picture,
)
from rig.results.document import Block, Document, Note, Picture, Section, SideBySide, Table
from rig.results.measured import QUANTITIES, clock_words
from rig.runs.catalogue.entry import Constant, Details, Entry
from rig.runs.run import load_run
from rig.runs.run_file import read_record
from rig.runs.run_record import RunRecord

_SHOWN: Final = (
    ("tracking error", "rms"),
    ("tracking error", "worst"),
    ("disagreement", "worst"),
    ("current", "worst"),
    ("temperature", "worst"),
    ("lateness", "p99"),
    ("lateness", "worst"),
    ("answer", "p99"),
    ("lost samples", ""),
    ("missed SYNCs", ""),
)
"""Quantities and statistics, in the order of the table."""
_UNITS: Final = {
    "angle": "deg", "time": "ms", "current": "A", "temperature": "deg C", "torque": "N m", "": "",
}  # fmt: skip
"""Unit of display of each dimension."""


@dataclass(frozen=True)
class Figure:
    """One measured value.

    Attributes:
        name: Quantity with its statistic.
        value: Value in ``unit``, or None if it was not recorded.
        unit: Unit; empty for a count.
        remark: Remark on the value; empty for no remark.
    """

    name: str
    value: float | None
    unit: str
    remark: str


@dataclass(frozen=True)
class RunFigures:
    """Measured values of one run.

    Attributes:
        figures: The values, in the same order for every run.
        done: Number of stages that are done, of all stages.
        weights: Verdicts of the weight checks, by stage.
        problem: Reason why the excitations cannot be read; empty if they were read.
    """

    figures: tuple[Figure, ...] = ()
    done: str = "-"
    weights: str = "-"
    problem: str = ""


def figures_of(folder: Path) -> RunFigures:
    """Return the measured values of a run. Values of excitations are None if no excitation was
    finished.

    Raises:
        InputError: The folder is not a run folder.
    """
    record = read_record(folder)
    dataset, problem = None, ""
    try:
        dataset = load_run(folder)
    except InputError as error:
        problem = error.problems[0]
    done = sum(stage.state == "done" for stage in record.stages)
    weights = ", ".join(f"{each['stage']}: {each['verdict']}" for each in record.weights)
    return RunFigures(
        tuple(_figure(record, dataset, *each) for each in _SHOWN),
        f"{done} of {len(record.stages)}",
        weights or "none made",
        problem,
    )


def _figure(record: RunRecord, dataset: Dataset | None, measure: str, statistic: str) -> Figure:
    unit = _UNITS[MEASURES[measure].dimension]
    value = QUANTITIES[measure](record, dataset, statistic)
    scale = UNITS[MEASURES[measure].dimension][unit]
    remark = clock_words(measure, record).removeprefix(", ")
    name = f"{measure} {statistic}".strip()
    return Figure(name, None if value is None else value / scale, unit, remark)


def figures_table(names: Sequence[str], runs: Sequence[RunFigures]) -> Table:
    """Return the measured values side by side, one column for each run.

    Args:
        names: Names of the runs.
        runs: The values of the runs.
    """
    rows = [
        ("stages done", "", *(each.done for each in runs)),
        ("weight checks", "", *(each.weights for each in runs)),
    ]
    for found in zip(*(each.figures for each in runs), strict=True):
        rows.append((found[0].name, found[0].unit, *map(_cell, found)))
    return Table(("quantity", "unit", *names), tuple(rows), tuple(range(2, 2 + len(names))))


def _cell(figure: Figure) -> str:
    shown = number(figure.value, 4)
    return f"{shown} {figure.remark}" if figure.remark and figure.value is not None else shown


def figures_record(run: Path, found: RunFigures) -> dict[str, Any]:
    """Return the measured values of a run as JSON values."""
    return {
        "run": str(run),
        "stages_done": found.done,
        "weight_checks": found.weights,
        "problem": found.problem,
        "figures": [
            {"name": f.name, "value": f.value, "unit": f.unit, "remark": f.remark}
            for f in found.figures
        ],
    }


COMPARE_SCHEMA = "loadrig.compare/1"


@dataclass(frozen=True)
class Compared:
    """One run of a comparison.

    Attributes:
        run: Run folder, as given.
        entry: Entry of the run in the catalogue of runs.
        details: Identified constants of the run.
        measured: Measured values of the run.
    """

    run: Path
    entry: Entry
    details: Details
    measured: RunFigures = field(default_factory=RunFigures)

    @property
    def identified(self) -> bool:
        """Whether the run has identified constants."""
        return bool(self.details.constants)


@dataclass(frozen=True)
class Difference:
    """Difference of a parameter of a later run from the same parameter of the first run.

    Attributes:
        name: Name of the constant.
        first: Value in the first run.
        other: Value in the later run, or None if that run did not identify the parameter.
        change: Difference, or None if one of the values is not known.
        joint: Half width of the 90 % interval of the difference of two independent estimates, or
            None if one of the values has no interval.
    """

    name: str
    first: Constant
    other: Constant | None
    change: float | None
    joint: float | None

    @property
    def moved(self) -> bool | None:
        """Whether the difference of the parameters exceeds its uncertainty, or None if the
        uncertainty is not known.
        """
        if self.change is None or self.joint is None:
            return None
        return abs(self.change) > self.joint


def require_comparable(runs: Sequence[Compared]) -> None:
    """Check that every run can be read, and that all benches have the same kind of motion.

    Raises:
        InputError: A run cannot be read, or the kinds of motion differ.
    """
    bad = [f"{each.run}: {each.entry.head.problem}" for each in runs if each.entry.head.problem]
    if bad:
        raise InputError(bad)
    motions = {each.details.motion for each in runs}
    if len(motions) > 1:
        raise InputError(f"a rotary and a linear bench have no constants in common: {motions}")


def differences(first: Details, other: Details) -> list[Difference]:
    """Return the difference of every parameter of the first run."""
    return [_difference(name, each, other) for name, each in first.constants.items()]


def _difference(name: str, first: Constant, details: Details) -> Difference:
    other = details.constants.get(name)
    if other is None or other.unit != first.unit or first.value is None or other.value is None:
        return Difference(name, first, other, None, None)
    halves = first.half_width, other.half_width
    joint = None if halves[0] is None or halves[1] is None else math.hypot(halves[0], halves[1])
    return Difference(name, first, other, other.value - first.value, joint)


def compare_document(runs: Sequence[Compared]) -> Document:
    """Return a comparison as a document: the measured values of all runs side by side, and the
    constants of each later identified run with those of the first identified run.
    """
    table = figures_table(_short(runs), [each.measured for each in runs])
    head = [
        Section("", (_facts(runs),)),
        Section("Measured values", (table, *_unread(runs), *_not_identified(runs))),
    ]
    identified = [each for each in runs if each.identified]
    sections = [*head, *_constants(identified)]
    return Document(
        "Comparison of runs",
        " | ".join(str(each.run) for each in runs),
        tuple(sections),
        (*_pictures(identified), *sections, *_beside(identified)),
    )


def _unread(runs: Sequence[Compared]) -> Iterator[Note]:
    for each in runs:
        if each.measured.problem:
            yield Note(f"no values of the excitations: {each.measured.problem}", "warning")


def _not_identified(runs: Sequence[Compared]) -> Iterator[Note]:
    bare = [str(each.run) for each in runs if not each.identified]
    for run in bare:
        yield Note(
            f"{run}: the constants of this run are not compared, because the run is not "
            f"identified; identify it with `rig identify {run}`"
        )
    if bare and len(runs) - len(bare) == 1:
        yield Note("constants are compared when two or more of the runs are identified")


def _constants(identified: Sequence[Compared]) -> Iterator[Section]:
    for other in identified[1:]:
        first = identified[0]
        found = differences(first.details, other.details)
        title = f"{other.run} against {first.run}"
        yield Section(title, (_table(found), *_notes(found, first, other)))


def _pictures(identified: Sequence[Compared]) -> Iterator[Section]:
    if len(identified) > 1:
        constants = [each.details.constants for each in identified]
        drawn = side_by_side(
            list(constants[0]), dict(zip(_short(identified), constants, strict=True))
        )
        caption = "Constants of the identified runs, in percent of the first"
        yield Section("", (Picture.of("constants", caption, drawn, lead=True),))


def _beside(identified: Sequence[Compared]) -> Iterator[Section]:
    if len(identified) > 1:
        first, *others = identified
        yield Section("Figures", tuple(_figures(first, other) for other in others))


def _short(runs: Sequence[Compared]) -> list[str]:
    """Return the folders of runs without the common first part of their paths, each folder once."""
    above = os.path.commonpath([each.run.absolute().parent for each in runs])
    short = [os.path.relpath(each.run.absolute(), above) for each in runs]
    if len(set(short)) == len(short):
        return short
    return [f"{number}: {name}" for number, name in enumerate(short, start=1)]


def _facts(runs: Sequence[Compared]) -> Table:
    rows = []
    for each in runs:
        *facts, state, verdict = list(cells(each.run, each.entry).values())[1:]
        error = f"{number(each.details.fit_rms, 3)} {each.details.fit_unit}".strip()
        rows.append((str(each.run), *facts, error, state, verdict))
    *names, state, verdict = COLUMNS
    return Table((*names, "torque error", state, verdict), tuple(rows), ())


def _table(found: Sequence[Difference]) -> Table:
    rows = tuple(_row(each) for each in found)
    header = (
        "constant",
        "first",
        "90 % interval",
        "other",
        "90 % interval",
        "change",
        "uncertainty",
        "unit",
        "finding",
    )
    return Table(header, rows, (1, 2, 3, 4, 5, 6))


def _row(each: Difference) -> tuple[str, ...]:
    other = each.other
    verdicts = {True: CHANGED, False: NO_CHANGE, None: "not known"}
    return (
        each.name,
        number(each.first.value),
        interval(each.first.low, each.first.high),
        number(other.value if other else None),
        interval(other.low, other.high) if other else "-",
        number(each.change, 3),
        "-" if each.joint is None else f"+-{number(each.joint, 2)}",
        each.first.unit,
        verdicts[each.moved],
    )


def _notes(found: Sequence[Difference], first: Compared, other: Compared) -> Iterator[Note]:
    moved = [each.name for each in found if each.moved]
    known = sum(each.moved is not None for each in found)
    words = f"{CHANGED} by more than their uncertainty: {', '.join(moved) or 'none'}"
    yield Note(words)
    yield Note(
        f"without any change, {0.1 * known:.2g} of {known} constants differ by more than their "
        "uncertainty by chance (one in ten)",
        "aside",
    )
    for role, name in first.details.devices.items():
        now = other.details.devices.get(role, "none")
        if now != name:
            yield Note(f"the {role} was replaced: {name} before, {now} now", "warning")
    if first.entry.head.bench != other.entry.head.bench:
        yield Note("the runs are of different benches", "warning")
    if first.entry.head.digest and first.entry.head.digest == other.entry.head.digest:
        yield Note("the second run is a copy of the first run", "warning")


def _figures(first: Compared, other: Compared) -> SideBySide:
    left, right = (Section(str(each.run), _stored(each)) for each in (first, other))
    return SideBySide(left, right)


def _stored(each: Compared) -> tuple[Block, ...]:
    """Return the figures of a run's own report, if their files exist."""
    picture = stored_picture(each.run, FIGURE, f"Friction against speed, {each.run}")
    missing = Note(
        f"{each.run / FIGURE} does not exist; draw it with `rig identify {each.run}`", "aside"
    )
    shown: list[Block] = [picture or missing]
    for file in sorted((each.run / "figures").glob("response_*.png"))[:4]:
        name = file.stem.removeprefix("response_")
        response = stored_picture(each.run, f"figures/{file.name}", f"{name}, {each.run}")
        if response is not None:
            shown.append(response)
    return tuple(shown)


def compare_record(runs: Sequence[Compared]) -> dict[str, Any]:
    """Return the record of ``rig runs compare --json``."""
    identified = [each for each in runs if each.identified]
    first = identified[0] if identified else runs[0]
    return {
        **head_record(COMPARE_SCHEMA),
        "first": str(first.run),
        "measured": [figures_record(each.run, each.measured) for each in runs],
        "not_identified": [str(each.run) for each in runs if not each.identified],
        "compared": [
            {
                "run": str(other.run),
                "constants": {
                    each.name: _difference_record(each)
                    for each in differences(first.details, other.details)
                },
            }
            for other in identified[1:]
        ],
    }


def _difference_record(each: Difference) -> dict[str, Any]:
    other = each.other
    return {
        "unit": each.first.unit,
        "first": {"value": each.first.value, "low": each.first.low, "high": each.first.high},
        "other": None
        if other is None
        else {"value": other.value, "low": other.low, "high": other.high},
        "change": each.change,
        "joint": each.joint,
        "moved": each.moved,
    }
