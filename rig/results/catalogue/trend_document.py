"""Output of ``rig runs trend``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from identification.numerics.change import LEAST_RUNS
from rig.common.tables import CHANGED, NO_CHANGE, interval, number
from rig.results.catalogue.figures import courses as drawn
from rig.results.catalogue.trend import FALSE_ALARMS, Course, History, alarms
from rig.results.catalogue.words import head_record
from rig.results.document import Document, Note, Picture, Section, Table, Verdict
from rig.results.look import picture

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
