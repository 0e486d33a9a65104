"""Tests each identified parameter of a bench for a change over the runs, at a stated false-alarm
rate.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from identification.numerics.change import LEAST_RUNS, Change, ChangeTest
from identification.recording import Array
from rig.common.tables import CHANGED, NO_CHANGE, interval, number
from rig.results.catalogue.listing import copies_of, head_record, place
from rig.results.catalogue.listing import courses as drawn
from rig.results.document import Document, Note, Picture, Section, Table, Verdict
from rig.results.look import picture
from rig.runs.catalogue.entry import Constant, Details, Entry

FALSE_ALARMS = 0.01
"""Greatest share of the histories without change in which a change is reported."""
_HALF_WIDTHS = 1.6448536269514722
"""Ratio of the half width of a 90 % interval to the standard error."""


@dataclass(frozen=True)
class Course:
    """Values of one identified parameter in the runs that determine it, in the order of the runs.

    Attributes:
        name: Name of the constant.
        runs: Index of the run of each value, in the history.
        constants: The values with their intervals.
        change: The step or drift that fits best; None with too few runs.
        p_value: p-value of the change, for all constants of the history together; None without a
            test.
        with_devices: Devices that were replaced at the step.
    """

    name: str
    runs: tuple[int, ...]
    constants: tuple[Constant, ...]
    change: Change | None
    p_value: float | None
    with_devices: tuple[str, ...] = ()

    @property
    def alarm(self) -> bool:
        """Whether the change is reported."""
        return self.p_value is not None and self.p_value <= FALSE_ALARMS


@dataclass(frozen=True)
class History:
    """The runs of one bench in order of time.

    Attributes:
        bench: Name of the bench.
        simulated: Whether the bench is simulated.
        method: Method of the identifications.
        runs: Folders, in the order of time.
        begun: When each run began.
        courses: Every constant over these runs.
        left_out: Messages on the runs that are left out.
    """

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
    """Return the histories of the benches of some runs. Runs without identified parameters are left
    out, and a run and its copies count once.

    Args:
        root: The searched folder.
        entries: The runs, the earliest first.
        seed: Seed of the simulated distribution of the test.
        only: Name of the constant to which histories are restricted, or None for all constants.
            The p-value of this constant also accounts for the tests of all other constants.
    """
    copies = {id(e): each[0] for each in copies_of(entries).values() for e in each[1:]}
    groups: dict[tuple[str, bool | None, str, str], list[tuple[Entry, Details]]] = {}
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
    made = (
        _history(root, key[:3], runs, tuple(left_out.get(key[:2], ())), seed, only)
        for key, runs in groups.items()
    )
    return [each for each in made if each.courses or only is None]


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
            found_change,
            size=scale * found_change.size,
            half_width=scale * found_change.half_width,
        )
        p_value = min(1.0, tested * change.p_value)
        yield Course(name, runs, constants, change, p_value, _devices(history, runs, change.start))


def _test(relative: Array, seed: int, known: dict[bytes, ChangeTest]) -> ChangeTest:
    """Return the test for errors relative to their median; parameters with equal relative errors
    share one test.
    """
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
    """Return the parameters that changed, with the first run after the step, or None for a
    drift.
    """
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
    rows = tuple(_row(course) for course in history.courses)
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
    notes = [*_steps(history), *_left_out(history)]
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


def _row(course: Course) -> tuple[str, ...]:
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


def _left_out(history: History) -> Iterator[Note]:
    for words in history.left_out[:_MOST_LEFT_OUT]:
        yield Note(f"left out: {words}", "aside")
    more = len(history.left_out) - _MOST_LEFT_OUT
    if more > 0:
        yield Note(f"left out: {more} more", "aside")


def trend_record(histories: Sequence[History]) -> dict[str, Any]:
    """Return the record of ``rig runs trend --json``."""
    return {
        **head_record(TREND_SCHEMA),
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
