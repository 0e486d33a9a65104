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
from identification.recording import Dataset
from rig.common.errors import InputError
from rig.common.provenance import FRICTION_FIGURE, heading
from rig.common.tables import CHANGED, NO_CHANGE, interval, number, picture
from rig.config.acceptance import MEASURES, UNITS
from rig.results.catalogue.listing import (
    COLUMNS,
    cells,
    copies_of,
    place,
    side_by_side,
    stored_picture,
)
from rig.results.catalogue.listing import courses as drawn
from rig.results.document import (
    Block,
    Document,
    Note,
    Picture,
    Section,
    SideBySide,
    Table,
    Verdict,
    columns,
)
from rig.results.measured import clock_words, measured
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
    stages_done: str = "-"
    weight_checks: str = "-"
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
    value = measured(measure, record, dataset, statistic)
    scale = UNITS[MEASURES[measure].dimension][unit]
    remark = clock_words(measure, record).removeprefix(", ")
    name = f"{measure} {statistic}".strip()
    return Figure(name, None if value is None else value / scale, unit, remark)


def _cell(figure: Figure) -> str:
    shown = number(figure.value, 4)
    return f"{shown} {figure.remark}" if figure.remark and figure.value is not None else shown


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
    found = []
    for name, one in first.constants.items():
        another = other.constants.get(name)
        change = joint = None
        if another is not None and another.unit == one.unit:
            if one.value is not None and another.value is not None:
                change = another.value - one.value
            if change is not None and one.half_width is not None and another.half_width is not None:
                joint = math.hypot(one.half_width, another.half_width)
        found.append(Difference(name, one, another, change, joint))
    return found


def compare_document(runs: Sequence[Compared]) -> Document:
    """Return measured values side by side, and constants against the first identified run."""
    names, measured = _short(runs), [each.measured for each in runs]
    rows = [
        ("stages done", "", *(each.stages_done for each in measured)),
        ("weight checks", "", *(each.weight_checks for each in measured)),
        *(
            (found[0].name, found[0].unit, *map(_cell, found))
            for found in zip(*(each.figures for each in measured), strict=True)
        ),
    ]
    table = Table(("quantity", "unit", *names), tuple(rows), tuple(range(2, 2 + len(names))))
    sections = [
        Section("", (_facts(runs),)),
        Section("Measured values", (table, *_remarks(runs))),
    ]
    identified = [each for each in runs if each.identified]
    sections += [_against(identified[0], other) for other in identified[1:]]
    lead, beside = [], []
    if len(identified) > 1:
        constants = [each.details.constants for each in identified]
        made = side_by_side(
            list(constants[0]), dict(zip(_short(identified), constants, strict=True))
        )
        caption = "Constants of the identified runs, in percent of the first"
        lead.append(Section("", (Picture.of("constants", caption, made, lead=True),)))
        first, *others = (Section(str(each.run), _stored(each)) for each in identified)
        beside.append(Section("Figures", tuple(SideBySide(first, other) for other in others)))
    return Document(
        "Comparison of runs",
        " | ".join(str(each.run) for each in runs),
        tuple(sections),
        (*lead, *sections, *beside),
    )


def _remarks(runs: Sequence[Compared]) -> Iterator[Note]:
    """Yield which runs lack values, and which are not compared by their constants."""
    for each in runs:
        if each.measured.problem:
            yield Note(f"no values of the excitations: {each.measured.problem}", "warning")
    bare = [str(each.run) for each in runs if not each.identified]
    for run in bare:
        yield Note(
            f"{run}: the constants of this run are not compared, because the run is not "
            f"identified; identify it with `rig identify {run}`"
        )
    if bare and len(runs) - len(bare) == 1:
        yield Note("constants are compared when two or more of the runs are identified")


def _against(first: Compared, other: Compared) -> Section:
    """Return the constants of a run against those of the first identified run."""
    found = differences(first.details, other.details)
    verdicts = {True: CHANGED, False: NO_CHANGE, None: "not known"}
    table = columns(
        found,
        (1, 2, 3, 4, 5, 6),
        ("constant", lambda d: d.name),
        ("first", lambda d: number(d.first.value)),
        ("90 % interval", lambda d: interval(d.first.low, d.first.high)),
        ("other", lambda d: number(d.other.value if d.other else None)),
        ("90 % interval", lambda d: interval(d.other.low, d.other.high) if d.other else "-"),
        ("change", lambda d: number(d.change, 3)),
        ("uncertainty", lambda d: "-" if d.joint is None else f"+-{number(d.joint, 2)}"),
        ("unit", lambda d: d.first.unit),
        ("finding", lambda d: verdicts[d.moved]),
    )
    return Section(f"{other.run} against {first.run}", (table, *_notes(found, first, other)))


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


def _notes(found: Sequence[Difference], first: Compared, other: Compared) -> Iterator[Note]:
    moved = [each.name for each in found if each.moved]
    known = sum(each.moved is not None for each in found)
    yield Note(f"{CHANGED} by more than their uncertainty: {', '.join(moved) or 'none'}")
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


def _stored(each: Compared) -> tuple[Block, ...]:
    """Return the figures of a run's own report, if their files exist."""
    picture = stored_picture(each.run, FRICTION_FIGURE, f"Friction against speed, {each.run}")
    missing = Note(
        f"{each.run / FRICTION_FIGURE} does not exist; draw it with `rig identify {each.run}`",
        "aside",
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
        "measured": [{"run": str(each.run), **plain(each.measured)} for each in runs],
        "not_identified": [str(each.run) for each in runs if not each.identified],
        "compared": [
            {
                "run": str(other.run),
                "constants": {
                    each.name: {
                        "unit": each.first.unit,
                        "first": plain(each.first, "unit", "at_bound"),
                        "other": plain(each.other, "unit", "at_bound"),
                        "change": each.change,
                        "joint": each.joint,
                        "moved": each.moved,
                    }
                    for each in differences(first.details, other.details)
                },
            }
            for other in identified[1:]
        ],
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

    @property
    def at(self) -> int | None:
        """Index of the first run after a step in the history; None without a step."""
        if self.change is None or self.change.start is None:
            return None
        return self.runs[self.change.start]


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
        History(
            *key[:3],
            tuple(place(root, entry) for entry, _ in runs),
            tuple(entry.head.created for entry, _ in runs),
            tuple(courses([details for _, details in runs], seed, only)),
            tuple(left_out.get(key[:2], ())),
        )
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
    known: dict[bytes, ChangeTest] = {}  # equal errors share one test
    for name, (runs, constants) in found.items():
        if only is not None and name != only:
            continue
        if len(runs) < LEAST_RUNS:
            yield Course(name, runs, constants, None, None)
            continue
        values = np.array([each.value for each in constants], dtype=np.float64)
        halves = np.array([each.half_width for each in constants], dtype=np.float64)
        scale = float(np.median(halves)) / _HALF_WIDTHS
        relative = halves / np.median(halves)
        key = np.round(relative, 6).tobytes()
        if key not in known:
            known[key] = ChangeTest(relative, np.random.default_rng(seed))
        found_change = known[key](values / scale)
        change = dataclasses.replace(
            found_change, size=scale * found_change.size, half_width=scale * found_change.half_width
        )
        p_value = min(1.0, tested * change.p_value)
        yield Course(name, runs, constants, change, p_value, _devices(history, runs, change.start))


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
    figures: tuple[Picture, ...] = ()
    known = [course for course in history.courses if course.constants]
    if pictures and known:
        points = {c.name: dict(zip(c.runs, c.constants, strict=True)) for c in known}
        caption = f"{known[0].name if len(known) == 1 else 'Constants'} of {history.bench}"
        name, lead = f"trend_{history.bench}", len(known) == 1
        figures = (Picture.of(name, caption, drawn(points, alarms(history)), lead=lead),)
    notes = [*_steps(history), *left_out_notes(history.left_out)]
    alone = history.courses[:1] if pictures and len(history.courses) == 1 else ()
    values = (_values(history, course) for course in alone)
    return Section(title, (*figures, _verdict(history), _trend_table(history), *notes, *values))


def _values(history: History, course: Course) -> Section:
    """Return the values of one constant, run by run; the numbers are those of its figure."""
    cells = columns(
        zip(course.runs, course.constants, strict=True),
        (0, 3, 4),
        ("run", lambda v: str(v[0] + 1)),
        ("folder", lambda v: history.runs[v[0]]),
        ("begun, UTC", lambda v: history.begun[v[0]][:16].replace("T", " ")),
        (course.name, lambda v: number(v[1].value)),
        ("90 % interval", lambda v: interval(v[1].low, v[1].high)),
    )
    return Section(f"{course.name}, run by run", (cells,))


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


def _trend_table(history: History) -> Table:
    def value(course: Course, at: int) -> str:
        known = [each.value for each in course.constants if each.value is not None]
        return number(known[at]) if known else "-"

    def finding(course: Course) -> str:
        if not course.alarm:
            return ""
        return "DRIFT" if course.at is None else f"STEP at run {course.at + 1}"

    return columns(
        history.courses,
        (1, 2, 3, 5, 6, 8),
        ("constant", lambda c: c.name),
        ("runs", lambda c: str(len(c.runs))),
        ("first", lambda c: value(c, 0)),
        ("last", lambda c: value(c, -1)),
        ("course", lambda c: picture([k.value for k in c.constants if k.value is not None][-24:])),
        ("change", lambda c: number(c.change.size if c.change else None, 3)),
        ("uncertainty", lambda c: f"+-{number(c.change.half_width, 2)}" if c.change else "-"),
        ("unit", lambda c: c.constants[0].unit if c.constants else ""),
        ("p", lambda c: "-" if c.p_value is None else f"{c.p_value:.2g}"),
        ("finding", finding),
    )


def _steps(history: History) -> Iterator[Note]:
    for course in history.courses:
        if course.alarm and course.at is not None:
            changed = "; ".join(course.with_devices)
            words = f"with another device ({changed})" if changed else "with the same devices"
            yield Note(f"{course.name}: stepped at {history.runs[course.at]}, {words}")


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
        "histories": [
            {
                "bench": history.bench,
                "simulated": history.simulated,
                "method": history.method,
                "runs": [
                    {"run": run, "begun": begun}
                    for run, begun in zip(history.runs, history.begun, strict=True)
                ],
                "left_out": list(history.left_out),
                "constants": {each.name: course_record(each) for each in history.courses},
            }
            for history in histories
        ],
    }


def course_record(course: Course) -> dict[str, Any]:
    """Return the values of a parameter over a history as JSON values."""
    change = course.change
    return {
        "unit": course.constants[0].unit if course.constants else "",
        "values": [
            {"index": index, "value": each.value, "low": each.low, "high": each.high}
            for index, each in zip(course.runs, course.constants, strict=True)
        ],
        "kind": None if change is None else "drift" if change.start is None else "step",
        "at": course.at,
        "change": None if change is None else change.size,
        "half_width": None if change is None else change.half_width,
        "p_value": course.p_value,
        "alarm": course.alarm,
        "other_devices": list(course.with_devices),
    }
