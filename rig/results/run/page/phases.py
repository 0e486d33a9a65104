"""Finds the stages and phases of a run over the time of one recording, and the time of the end of
the run.

Pure functions.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rig.common.sample import Phase
from rig.planning.plan import HOLD_S
from rig.results.run.page.channels import ENABLED, NAMES, Derived
from rig.runs.run_record import Ending, RunRecord, SegmentRecord

BRAKING = "braking"
MOVING = f"{Phase.APPROACH.value}, {Phase.SETTLE.value}"
"""Label of the move to the start of an excitation and of the rest after the move; the recording
does not contain the boundary between move and rest.
"""
_ENDINGS = frozenset(ending.value for ending in Ending)
_OFF = frozenset(
    {Phase.LOAD.value, Phase.PREPARE.value, Phase.BOUNDARY.value, Phase.FINISHED.value}
)
"""Phases in which the drive is off."""


@dataclass(frozen=True)
class Span:
    """A phase of a stage, from ``start`` to ``stop``, s; ``segment`` is the number of an
    excitation, or 0.
    """

    start: float
    stop: float
    stage: str
    phase: str
    segment: int = 0


@dataclass(frozen=True)
class Moment:
    """End of a run: ``time`` in s, and a short label."""

    time: float
    words: str


def spans(
    events: Iterable[Mapping[str, Any]], segments: Sequence[SegmentRecord], last: float
) -> list[Span]:
    """Return the phases of one recording in order of time; excitations are named as in
    ``run.json``.

    Args:
        events: Events of the recording.
        segments: Excitations of the recording.
        last: Time of its last sample, s.
    """
    known = {segment.index: segment for segment in segments}
    found: list[Span] = []
    current: Span | None = None
    for event in events:
        time, kind = float(event["time"]), event["event"]
        if current is not None and kind in _TURNS:
            found += _closed(current, time, known.get(current.segment))
            current = None
        if kind in _OPENS:
            number = event.get("number", 0)
            segment = known.get(number)
            if segment is None:
                current = Span(time, last, event.get("stage", ""), _OPENS[kind], number)
            else:
                current = Span(segment.start, last, segment.name, _OPENS[kind], number)
    if current is not None:
        found += _closed(current, last, known.get(current.segment))
    cut = (dataclasses.replace(span, stop=min(span.stop, last)) for span in found)
    return [span for span in cut if span.stop > span.start]


_OPENS: Mapping[str, str] = {
    "stage start": MOVING,
    "first pass": Phase.FIRST_PASS.value,
    "weight check": MOVING,
    "segment": Phase.EXCITE.value,
}
"""Phases by the events that begin them."""
_TURNS = frozenset({*_OPENS, *_ENDINGS, "stage end", "prompt"})


def _closed(span: Span, stop: float, segment: SegmentRecord | None) -> list[Span]:
    """Return a span that ends at ``stop``, or earlier if its excitation was complete earlier."""
    end = None if segment is None else segment.end
    if end is None or not span.start <= end < stop:
        return [dataclasses.replace(span, stop=stop)]
    held = min(end + HOLD_S, stop)
    return [
        dataclasses.replace(span, stop=end),
        Span(end, held, span.stage, Phase.HOLD.value),
        Span(held, stop, span.stage, MOVING),
    ]


def moment_of(
    record: RunRecord,
    tail: Derived,
    segments: Sequence[SegmentRecord],
    events: Sequence[Mapping[str, Any]],
) -> Moment:
    """Return the time at which an unfinished run ended, by the clock of its last recording.

    For a trip this is the time of the trip, otherwise the last sample of the current excitation, or
    the last sample under power.

    Args:
        record: ``run.json``.
        tail: The end of the last recording.
        segments: Excitations of the recording.
        events: Events of the last recording.
    """
    last = float(tail.time[-1])
    words = record.state
    if record.trip and isinstance(record.trip.get("time"), int | float):
        return Moment(min(float(record.trip["time"]), last), words)
    if record.parts[-1].state not in _ENDINGS:
        return Moment(last, "recording ends")
    ending: Mapping[str, Any] = next(
        (event for event in reversed(events) if event["event"] in _ENDINGS), {}
    )
    if ending.get("phase") in _OFF:
        words = "last under power"
    going_on = {segment.index for segment in segments if segment.end is None}
    moving = np.flatnonzero(np.isin(tail.segment, list(going_on)))
    powered = np.flatnonzero(tail.values[:, NAMES.index("state")] == ENABLED)
    for found in (moving, powered):
        if len(found):
            return Moment(float(tail.time[found[-1]]), words)
    return Moment(last, words)


def with_braking(found: Sequence[Span], moment: Moment) -> list[Span]:
    """Return the spans; the time after the end of the run is marked as braking."""
    cut: list[Span] = []
    for span in found:
        if span.start < moment.time:
            cut.append(dataclasses.replace(span, stop=min(span.stop, moment.time)))
        if span.stop > moment.time:
            cut.append(dataclasses.replace(span, start=max(span.start, moment.time), phase=BRAKING))
    return cut
