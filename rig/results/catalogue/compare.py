"""Output of ``rig runs compare`` and ``rig runs trend``."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from identification.numerics.arrays import plain
from identification.numerics.spread import LEAST_RUNS, Change, ChangeTest
from identification.recording import Array, Dataset
from rig.common.errors import InputError
from rig.common.provenance import heading
from rig.common.tables import CHANGED, NO_CHANGE, interval, number, picture
from rig.config.acceptance import MEASURES, UNITS
from rig.results.catalogue.listing import (
    COLUMNS,
    FIGURE,
    cells,
    copies_of,
    place,
    side_by_side,
    stored_picture,
)
from rig.results.catalogue.listing import courses as drawn
from rig.results.document import Block, Document, Note, Picture, Section, SideBySide, Table, Verdict
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
    """One measured value."""

    name: str
    value: float | None
    unit: str
    remark: str


@dataclass(frozen=True)
class RunFigures:
    """Measured values of one run."""

    figures: tuple[Figure, ...] = ()
    done: str = "-"
    weights: str = "-"
    problem: str = ""


def figures_of(folder: Path) -> RunFigures:
    """Return the measured values of a run; those of excitations are None if none was finished."""
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


def _figures_table(names: Sequence[str], runs: Sequence[RunFigures]) -> Table:
    """Return the measured values side by side, one column for each run."""
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
        "figures": plain(found.figures),
    }


COMPARE_SCHEMA = "loadrig.compare/1"


@dataclass(frozen=True)
class Compared:
    """One run of a comparison."""

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
    """Difference of a parameter of a later run from the same parameter of the first run."""

    name: str
    first: Constant
    other: Constant | None
    change: float | None
    joint: float | None

    @property
    def moved(self) -> bool | None:
        """Whether the difference exceeds its uncertainty, or None if that is not known."""
        if self.change is None or self.joint is None:
            return None
        return abs(self.change) > self.joint


def require_comparable(runs: Sequence[Compared]) -> None:
    """Check that every run can be read, and that all benches have the same kind of motion."""
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
    """Return measured values side by side, and constants against the first identified run."""
    table = _figures_table(_short(runs), [each.measured for each in runs])
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
        **heading(COMPARE_SCHEMA),
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
    return {
        "unit": each.first.unit,
        "first": plain(each.first, "unit", "at_bound"),
        "other": plain(each.other, "unit", "at_bound"),
        "change": each.change,
        "joint": each.joint,
        "moved": each.moved,
    }


FALSE_ALARMS = 0.01  # greatest share of the histories without change in which a change is reported
_HALF_WIDTHS = 1.6448536269514722
"""Ratio of the half width of a 90 % interval to the standard error."""


@dataclass(frozen=True)
class Course:
    """Values of one identified parameter in the runs that determine it, in order of the runs."""

    name: str
    runs: tuple[int, ...]  # index of the run of each value, in the history
    constants: tuple[Constant, ...]  # the values with their intervals
    change: Change | None  # the step or drift that fits best; None with too few runs
    # p-value of the change, for all constants of the history together; None without a test.
    p_value: float | None
    with_devices: tuple[str, ...] = ()  # devices that were replaced at the step

    @property
    def alarm(self) -> bool:
        """Whether the change is reported."""
        return self.p_value is not None and self.p_value <= FALSE_ALARMS


@dataclass(frozen=True)
class History:
    """The runs of one bench in order of time."""

    bench: str
    simulated: bool | None
    method: str
    runs: tuple[str, ...]
    begun: tuple[str, ...]
    courses: tuple[Course, ...]
    left_out: tuple[str, ...] = ()


def histories(
    root: Path, entries: Sequence[Entry], seed: int = 0, only: str | None = None
) -> list[History]:
    """Return the histories of the benches of identified runs; a run and its copies count once."""
    groups, left_out = identified_runs(root, entries)
    made = (
        _history(root, key[:3], runs, tuple(left_out.get(key[:2], ())), seed, only)
        for key, runs in groups.items()
    )
    return [each for each in made if each.courses or only is None]


Groups = dict[tuple[str, bool | None, str, str], list[tuple[Entry, Details]]]
"""Runs by bench, whether the bench is simulated, method of the identification, and motion."""


def identified_runs(
    root: Path, entries: Sequence[Entry]
) -> tuple[Groups, dict[tuple[str, bool | None], list[str]]]:
    """Return the identified runs in groups that can be compared, and the reasons why the others are
    left out, by bench; a run and its copies count once.
    """
    copies = {id(e): each[0] for each in copies_of(entries).values() for e in each[1:]}
    groups: Groups = {}
    left_out: dict[tuple[str, bool | None], list[str]] = {}
    for entry in entries:
        head = entry.head
        if head.kind != "run":
            continue
        if id(entry) in copies:
            words = f"{place(root, entry)}: a copy of {place(root, copies[id(entry)])}"
            left_out.setdefault((head.bench, head.simulated), []).append(words)
        elif not head.identified:
            words = f"{place(root, entry)}: not identified"
            left_out.setdefault((head.bench, head.simulated), []).append(words)
        else:
            details = entry.parsed()
            key = (head.bench, head.simulated, head.identified, details.motion)
            groups.setdefault(key, []).append((entry, details))
    return groups, left_out


def _history(
    root: Path,
    key: tuple[str, bool | None, str],
    runs: Sequence[tuple[Entry, Details]],
    left_out: tuple[str, ...],
    seed: int,
    only: str | None,
) -> History:
    details = [each for _, each in runs]
    return History(
        *key,
        tuple(place(root, entry) for entry, _ in runs),
        tuple(entry.head.created for entry, _ in runs),
        tuple(courses(details, seed, only)),
        left_out,
    )


def courses(history: Sequence[Details], seed: int = 0, only: str | None = None) -> Iterator[Course]:
    """Yield the values of every parameter over a history, with a test for a change; the false-alarm
    rate is that of all parameters together.

    Args:
        history: Details of the runs in the order of time.
        seed: Seed of the simulated distribution of the test.
        only: Name of the constant to yield, or None for all; the false-alarm rate is that of all
            constants in either case.
    """
    found = {name: _determined(name, history) for each in history for name in each.constants}
    tested = sum(len(runs) >= LEAST_RUNS for runs, _ in found.values())
    known: dict[bytes, ChangeTest] = {}
    for name, (runs, constants) in found.items():
        if only is not None and name != only:
            continue
        if len(runs) < LEAST_RUNS:
            yield Course(name, runs, constants, None, None)
            continue
        values = np.array([each.value for each in constants], dtype=np.float64)
        halves = np.array([each.half_width for each in constants], dtype=np.float64)
        scale = float(np.median(halves)) / _HALF_WIDTHS
        found_change = _test(halves / np.median(halves), seed, known)(values / scale)
        change = dataclasses.replace(
            found_change, size=scale * found_change.size, half_width=scale * found_change.half_width
        )
        p_value = min(1.0, tested * change.p_value)
        yield Course(name, runs, constants, change, p_value, _devices(history, runs, change.start))


def _test(relative: Array, seed: int, known: dict[bytes, ChangeTest]) -> ChangeTest:
    """Return the test for errors relative to their median; equal errors share one test."""
    key = np.round(relative, 6).tobytes()
    if key not in known:
        known[key] = ChangeTest(relative, np.random.default_rng(seed))
    return known[key]


def _determined(
    name: str, history: Sequence[Details]
) -> tuple[tuple[int, ...], tuple[Constant, ...]]:
    """Return the runs that determine a parameter with an interval of positive width."""
    first = next(each.constants[name].unit for each in history if name in each.constants)
    kept = [
        (index, each.constants[name])
        for index, each in enumerate(history)
        if name in each.constants and each.constants[name].unit == first
    ]
    kept = [(index, each) for index, each in kept if each.half_width]
    return tuple(index for index, _ in kept), tuple(each for _, each in kept)


def _devices(history: Sequence[Details], runs: Sequence[int], start: int | None) -> tuple[str, ...]:
    """Return the devices that were replaced at a step."""
    if start is None:
        return ()
    before, after = history[runs[start - 1]].devices, history[runs[start]].devices
    return tuple(
        f"{role}: {before.get(role, 'none')}, then {after.get(role, 'none')}"
        for role in {**before, **after}
        if before.get(role) != after.get(role)
    )


def alarms(history: History) -> Mapping[str, int | None]:
    """Return the first run after each step, by parameter; None for a drift."""
    return {each.name: each.change.start for each in history.courses if each.alarm and each.change}


TREND_SCHEMA = "loadrig.trend/1"
_RATE = (
    f"In at most {100 * FALSE_ALARMS:g} of 100 histories without change, a change of one or more "
    f"constants is reported; a test after every further run increases this share. At least "
    f"{LEAST_RUNS} runs are needed."
)
_MOST_LEFT_OUT = 6


def trend_document(histories: Sequence[History]) -> Document:
    """Return the histories of benches as a document."""
    if not histories:
        note = Note("no identified runs; identify runs with `rig identify RUN`")
        return Document("Trend", "", (Section("", (note,)),))
    summary = tuple(_section(each, pictures=False) for each in histories)
    pages = tuple(_section(each, pictures=True) for each in histories)
    rate = Section("", (Note(_RATE, "aside"),))
    names = {course.name for each in histories for course in each.courses}
    title = f"Trend of {min(names)}" if len(names) == 1 else "Trend of the constants"
    return Document(title, "", (*summary, rate), (*pages, rate))


def _section(history: History, *, pictures: bool) -> Section:
    kind = "simulated" if history.simulated else "REAL"
    title = f"{history.bench} ({kind}), {len(history.runs)} runs, {history.method} method"
    found = alarms(history)
    figures: tuple[Picture, ...] = ()
    known = [course for course in history.courses if course.constants]
    if pictures and known:
        points = {c.name: dict(zip(c.runs, c.constants, strict=True)) for c in known}
        caption = f"{known[0].name if len(known) == 1 else 'Constants'} of {history.bench}"
        name, lead = f"trend_{history.bench}", len(known) == 1
        figures = (Picture.of(name, caption, drawn(points, found), lead=lead),)
    rows = tuple(_trend_row(course) for course in history.courses)
    header = (
        "constant",
        "runs",
        "first",
        "last",
        "course",
        "change",
        "uncertainty",
        "unit",
        "p",
        "finding",
    )
    notes = [*_steps(history), *left_out_notes(history.left_out)]
    verdict = _verdict(history)
    cells = Table(header, rows, (1, 2, 3, 5, 6, 8))
    alone = history.courses[:1] if pictures and len(history.courses) == 1 else ()
    values = (_values(history, course) for course in alone)
    return Section(title, (*figures, verdict, cells, *notes, *values))


def _values(history: History, course: Course) -> Section:
    """Return the values of one constant, run by run; the numbers are those of its figure."""
    rows = tuple(
        (
            str(index + 1),
            history.runs[index],
            history.begun[index][:16].replace("T", " "),
            number(each.value),
            interval(each.low, each.high),
        )
        for index, each in zip(course.runs, course.constants, strict=True)
    )
    header = ("run", "folder", "begun, UTC", course.name, "90 % interval")
    return Section(f"{course.name}, run by run", (Table(header, rows, (0, 3, 4)),))


def _verdict(history: History) -> Verdict:
    found = [course.name for course in history.courses if course.alarm]
    tested = any(course.change for course in history.courses)
    if not tested:
        words = f"{len(history.runs)} runs; the test needs {LEAST_RUNS}"
        return Verdict("not tested", words, "open")
    if found:
        return Verdict(
            CHANGED, f"{', '.join(found)} changed by more than the scatter of the runs.", "found"
        )
    known = [course.name for course in history.courses]
    which = f"{known[0]} did not change" if len(known) == 1 else "No constant changed"
    words = f"{which} by more than the scatter of the runs and the intervals."
    return Verdict(NO_CHANGE, words, "good")


def _trend_row(course: Course) -> tuple[str, ...]:
    values = [each.value for each in course.constants if each.value is not None]
    unit = course.constants[0].unit if course.constants else ""
    change = course.change
    known = (number(values[0]), number(values[-1])) if values else ("-", "-")
    return (
        course.name,
        str(len(course.runs)),
        *known,
        picture(values[-24:]),
        number(change.size if change else None, 3),
        f"+-{number(change.half_width, 2)}" if change else "-",
        unit,
        "-" if course.p_value is None else f"{course.p_value:.2g}",
        _word(course),
    )


def _word(course: Course) -> str:
    if not course.alarm or course.change is None:
        return ""
    return "DRIFT" if course.change.start is None else f"STEP at run {_step_at(course) + 1}"


def _step_at(course: Course) -> int:
    """Return the index of the first run after a step in the history."""
    assert course.change is not None
    assert course.change.start is not None
    return course.runs[course.change.start]


def _steps(history: History) -> Iterator[Note]:
    for course in history.courses:
        if course.alarm and course.change is not None and course.change.start is not None:
            run = history.runs[_step_at(course)]
            changed = "; ".join(course.with_devices)
            words = f"with another device ({changed})" if changed else "with the same devices"
            yield Note(f"{course.name}: stepped at {run}, {words}")


def left_out_notes(left_out: Sequence[str]) -> Iterator[Note]:
    """Yield notes on the first runs that do not count, and on the number of the others."""
    for words in left_out[:_MOST_LEFT_OUT]:
        yield Note(f"left out: {words}", "aside")
    more = len(left_out) - _MOST_LEFT_OUT
    if more > 0:
        yield Note(f"left out: {more} more", "aside")


def trend_record(histories: Sequence[History]) -> dict[str, Any]:
    """Return the record of ``rig runs trend --json``."""
    return {
        **heading(TREND_SCHEMA),
        "false_alarms": FALSE_ALARMS,
        "histories": [_history_record(each) for each in histories],
    }


def _history_record(history: History) -> dict[str, Any]:
    return {
        "bench": history.bench,
        "simulated": history.simulated,
        "method": history.method,
        "runs": [
            {"run": run, "begun": begun}
            for run, begun in zip(history.runs, history.begun, strict=True)
        ],
        "left_out": list(history.left_out),
        "constants": {course.name: _course_record(course) for course in history.courses},
    }


def _course_record(course: Course) -> dict[str, Any]:
    change = course.change
    return {
        "unit": course.constants[0].unit if course.constants else "",
        "values": [
            {"index": index, "value": each.value, "low": each.low, "high": each.high}
            for index, each in zip(course.runs, course.constants, strict=True)
        ],
        "kind": None if change is None else "drift" if change.start is None else "step",
        "at": None if change is None or change.start is None else _step_at(course),
        "change": None if change is None else change.size,
        "half_width": None if change is None else change.half_width,
        "p_value": course.p_value,
        "alarm": course.alarm,
        "other_devices": list(course.with_devices),
    }
