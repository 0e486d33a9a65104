"""Reads a recording for its page: channels, limits and phases over time, and its end."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Attachment
from numpy.typing import NDArray

from drivers.canopen.cia402 import decode_state
from drivers.errors import StateError
from drivers.interfaces import ServoState
from identification.model.gas_generator import impacted_area
from identification.recording import Array
from identification.recording import Bench as Constants
from rig.common.errors import InputError
from rig.common.sample import Phase, Sample
from rig.common.yaml_tree import DocumentError, parse
from rig.config.bench import Bench, in_force, without_watch
from rig.config.configuration import Document, Schema, validated
from rig.config.sequence import Sequence as StageSequence
from rig.config.sequence import approach
from rig.config.serial_bus import NO_WATCHDOG_AT_ALL
from rig.control.safety import RUNNING_MASK, Check
from rig.planning.first_pass import PlannedPass
from rig.planning.limits import Limits
from rig.planning.plan import APPROACH_SPEED_SHARE, HOLD_S, Plan, make_plan
from rig.runs.decimation import Decimation
from rig.runs.mcap.reader import Block, Damage, Happening, run_items
from rig.runs.run import readable
from rig.runs.run_file import recorded_bench
from rig.runs.run_record import (
    BENCH_ATTACHMENT,
    SEQUENCE_ATTACHMENT,
    Ending,
    PartRecord,
    RunRecord,
    SegmentRecord,
)

Flags = NDArray[np.bool_]
NAMES = (
    "command",
    "angle",
    "motor",
    "error",
    "following_error",
    "disagreement",
    "velocity",
    "current",
    "torque",
    "voltage",
    "supply_voltage",
    "temperature",
    "pressure",
    "force",
    "state",
    "age",
    "answer",
    "late",
    "drive_clock",
    "encoder_clock",
)
"""Columns of the values, in SI units.

``motor`` is the joint angle by the motor's encoder, ``error`` the command less the joint angle,
``disagreement`` the joint angle by the motor's encoder less that by the joint encoder, ``torque``
Km i I, ``force`` the contact force computed from the pressure. ``age`` is the time since the last
fresh sample, ``answer`` the time from a cycle's start until its answers had been collected,
``late`` the lateness of a cycle, or zero if it was less than about a period. ``drive_clock`` and
``encoder_clock`` are the times of these devices less the host's, relative to the difference at the
start of the stage.
"""
STATES = ("off", "fault", "quick stop", "enabled")
"""State names of the drive, by the number in ``state``."""
ENABLED = float(STATES.index("enabled"))
PAUSES = frozenset({"stage end", "stage start", "units", "weight check"})
"""Events after which the cycle rests or restarts: the next step is no lateness."""
_GAP_CYCLES = 10.0  # number of consecutive missing cycles from which on the curve is interrupted
_CODES: Mapping[ServoState, str] = {
    ServoState.OPERATION_ENABLED: "enabled",
    ServoState.QUICK_STOP_ACTIVE: "quick stop",
    ServoState.FAULT: "fault",
    ServoState.FAULT_REACTION: "fault",
}


def _code(statusword: int) -> float:
    try:
        return float(STATES.index(_CODES.get(decode_state(statusword), "off")))
    except StateError:
        return math.nan


_STATE = np.array([_code(word) for word in range(RUNNING_MASK + 1)])


class Derived(NamedTuple):
    """Plotted channels of consecutive samples."""

    time: Array  # time, s, shape (n,)
    values: Array  # columns in the order of `NAMES`, shape (n, 20)
    broken: Flags  # whether cycles are missing before a sample, or the drive was off
    segment: Array  # number of the excitation, 0 for none


class Deriver:
    """Function that derives the plotted channels of consecutive blocks of samples."""

    def __init__(self, bench: Constants, cycle_s: float) -> None:
        self._bench = bench
        self._cycle_s = cycle_s
        # State that is carried from one block of samples to the next.
        self._time = -math.inf
        self._fresh = self._drive = self._encoder = math.nan
        # Time, s, and command, rad, of the first sample of each stage under power.
        self.starts: list[tuple[float, float]] = []
        # Start and end of each time under power up to now, s.
        self.powered: list[tuple[float, float]] = []

    def __call__(
        self, samples: Mapping[str, Array], events: Iterable[Mapping[str, Any]]
    ) -> Derived:
        """Derive one block.

        Args:
            samples: Every field of :class:`rig.common.sample.Sample` to its values, shape (n,).
            events: All events recorded up to the end of the block.
        """
        time = samples["time"]
        pauses = self._pauses(time, events, PAUSES)
        stages = self._pauses(time, events, frozenset({"stage start"}))
        step = np.diff(time, prepend=self._time)
        self.starts += [
            (float(time[k]), float(samples["command"][k])) for k in np.flatnonzero(stages)
        ]
        edges = [0, *np.flatnonzero(stages).tolist(), len(time)]
        for begin, end in pairwise(edges):
            if begin < end:
                new = not self.powered or stages[begin]
                start = float(time[begin]) if new else self.powered.pop()[0]
                self.powered.append((start, float(time[end - 1])))
        found = {
            **self._motion(samples),
            **self._gas(samples),
            "state": _STATE[samples["statusword"].astype(np.int64) & RUNNING_MASK],
            **self._times(samples, step, pauses, stages),
        }
        self._time = float(time[-1])
        values = np.column_stack([found.get(name, np.full(len(time), np.nan)) for name in NAMES])
        return Derived(
            time, values, stages | (step > _GAP_CYCLES * self._cycle_s), samples["segment"]
        )

    def _pauses(
        self, time: Array, events: Iterable[Mapping[str, Any]], kinds: frozenset[str]
    ) -> Flags:
        """Return a mask of the samples directly after an event of one of the ``kinds``."""
        flags = np.zeros(len(time), dtype=np.bool_)
        at = [e["time"] for e in events if e["event"] in kinds and e["time"] > self._time]
        index = np.searchsorted(time, np.array(at))
        flags[index[index < len(time)]] = True
        return flags

    def _motion(self, samples: Mapping[str, Array]) -> dict[str, Array]:
        motor = samples["motor_angle"] / self._bench.gear_ratio
        plain = ("command", "angle", "following_error", "velocity", "current", "voltage")
        return {
            **{name: samples[name] for name in (*plain, "supply_voltage", "temperature")},
            "motor": motor,
            "error": samples["command"] - samples["angle"],
            "disagreement": motor - samples["angle"],
            "torque": samples["current"] * self._bench.ampere_torque,
        }

    def _gas(self, samples: Mapping[str, Array]) -> dict[str, Array]:
        pressure, generator = samples["pressure"], self._bench.gas_generator
        if generator is None:
            return {"pressure": pressure}
        area = impacted_area(samples["angle"], generator.valve)
        return {"pressure": pressure, "force": (pressure - generator.p_c0) * area}

    def _times(
        self, samples: Mapping[str, Array], step: Array, pauses: Flags, stages: Flags
    ) -> dict[str, Array]:
        time, fresh = samples["time"], samples["fresh"] != 0.0
        late = np.where(
            (step > 1.99 * self._cycle_s) & ~pauses & np.isfinite(step), step - self._cycle_s, 0.0
        )
        before = time[0] if math.isnan(self._fresh) else self._fresh
        latest = np.maximum.accumulate(np.where(fresh | pauses, time, before))
        self._fresh = float(latest[-1])
        drive, self._drive = _since(samples["device_time"] - time, stages, self._drive)
        encoder, self._encoder = _since(samples["encoder_time"] - time, stages, self._encoder)
        return {
            "age": time - latest,
            "answer": samples["host_time"] - time,
            "late": late,
            "drive_clock": drive,
            "encoder_clock": encoder,
        }


def _since(values: Array, starts: Flags, before: float) -> tuple[Array, float]:
    """Return values less that at the latest start, and the value at the last start."""
    if math.isnan(before):
        before = float(values[0])
    index = np.maximum.accumulate(np.where(starts, np.arange(len(values)), -1))
    zero = np.where(index < 0, before, values[np.maximum(index, 0)])
    return values - zero, float(zero[-1])


TAIL_S = 8.0  # time at the end of a recording that is kept sample by sample, s; braking takes 1 s
COLUMNS = 1000
"""Number of columns for which a recording is reduced: one or two intervals of time a column."""


class Series(NamedTuple):
    """Least and greatest values of every channel over intervals of time, or single samples."""

    time: Array  # middle of each interval, s, shape (n,)
    # Least values in the order of `NAMES`, shape (20, n); NaN where nothing was recorded, so that
    # no line is drawn across.
    low: Array
    high: Array  # greatest values, in the form of `low`
    width_s: float = 0.0  # length of an interval, s; 0 for samples

    def extremes(self, name: str) -> tuple[float, float]:
        """Return the least and the greatest value of a channel; NaN without values."""
        row = NAMES.index(name)
        return float(np.fmin.reduce(self.low[row])), float(np.fmax.reduce(self.high[row]))


@dataclass
class Traces:
    """Content of a recording for plotting."""

    reduced: Series | None = None  # all samples, reduced, or None if no cycle was recorded
    # The last `TAIL_S` of the recording, sample by sample, or None if no cycle was recorded.
    tail: Derived | None = None
    # Start and end of each time under power, s; requires samples.
    powered: list[tuple[float, float]] = field(default_factory=list)
    # Events in order; each has `time` and `event`.
    events: list[Mapping[str, Any]] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)  # name to content
    # Time, s, and command, rad, of the first sample of each stage under power.
    starts: list[tuple[float, float]] = field(default_factory=list)
    count: int = 0  # number of samples
    damage: str | None = None  # none for a complete file, else a message on the damage

    @property
    def end_s(self) -> float:
        """Time of the last sample, s; requires samples."""
        return self.powered[-1][1]

    def samples(self, first_s: float, last_s: float) -> Series:
        """Return the tail between two times, reduced if too long for a chart."""
        assert self.tail is not None
        time, values, broken, _ = self.tail
        inside = (time >= first_s) & (time <= last_s)
        time, low, broken = time[inside], values[inside].T, broken[inside]
        high = low
        size = max(1, len(time) // (2 * COLUMNS))
        if size > 1:
            starts = np.flatnonzero((np.arange(len(time)) % size == 0) | broken)
            low, high = (each.reduceat(low, starts, axis=1) for each in (np.fmin, np.fmax))
            time, broken = time[starts], broken[starts]
        return _with_gaps(Series(time, low, high), np.flatnonzero(broken[1:]) + 1)


def _with_gaps(series: Series, before: NDArray[np.intp]) -> Series:
    """Return a series with an empty column before some of its columns."""
    time, low, high, width_s = series
    middle = 0.5 * (time[before] + time[before - 1])
    low, high = (np.insert(each, before, math.nan, axis=1) for each in (low, high))
    return Series(np.insert(time, before, middle), low, high, width_s)


def read_traces(path: Path, bench: Constants, cycle_s: float) -> Traces:
    """Read one recording of a run, of a damaged one what is left."""
    with readable(path):
        return _gathered(run_items(path, Sample._fields), bench, cycle_s)


def _gathered(
    items: Iterable[Block | Happening | Attachment | Damage], bench: Constants, cycle_s: float
) -> Traces:
    traces, derive = Traces(), Deriver(bench, cycle_s)
    decimation = Decimation(len(NAMES), cycle_s)
    tail: list[Derived] = []
    for item in items:
        if isinstance(item, Happening):
            traces.events.append(item.event)
        elif isinstance(item, Attachment):
            traces.attachments[item.name] = item.data
        elif isinstance(item, Damage):
            traces.damage = item.words
        else:
            derived = derive(item.samples, traces.events)
            traces.count += len(derived.time)
            decimation.add(derived.time, derived.values.T)
            tail.append(derived)
            while len(tail) > 1 and tail[1].time[0] < derived.time[-1] - TAIL_S:
                tail.pop(0)
    traces.starts, traces.powered = derive.starts, derive.powered
    if traces.count:
        joined = Derived(*(np.concatenate(fields) for fields in zip(*tail, strict=True)))
        keep = joined.time >= joined.time[-1] - TAIL_S
        traces.tail = Derived(*(values[keep] for values in joined))
        traces.reduced = _reduced(decimation, traces.powered)
    return traces


def _reduced(decimation: Decimation, powered: Sequence[tuple[float, float]]) -> Series:
    """Return a whole recording, with one empty interval for each time without samples."""
    first, last = powered[0][0], powered[-1][1]
    level = decimation.level(last - first, COLUMNS)
    width_s = decimation.interval_s(level)
    found = decimation.since(level, 0)
    time = np.clip((found.first + np.arange(found.low.shape[1]) + 0.5) * width_s, first, last)
    filled = np.flatnonzero(np.isfinite(found.low[NAMES.index("age")]))
    steps = np.diff(filled)
    gaps = np.flatnonzero((steps > 1) & (steps * 2.0**level > _GAP_CYCLES)) + 1
    series = Series(time[filled], found.low[:, filled], found.high[:, filled], width_s)
    return _with_gaps(series, gaps)


_ENDS_PASS = frozenset({"weight check", "stage start"})
"""Events that end a first pass; without one its limits hold to the end."""
RUN_ATTACHMENT = "run.json"  # name of the attached record of a run, as the record was at the start
_SAME = 1e-9  # relative difference up to which two amplitudes count as equal


@dataclass(frozen=True)
class Attachments:
    """Content of the files attached to a recording."""

    # The bench, with the limits in force, or None if its file is missing or cannot be read.
    bench: Bench | None
    # The plan, with the first passes of each stage, or None if a file is missing or cannot be read.
    plan: Plan | None
    problem: str = ""  # the reason why `bench` or `plan` is None


def read_attachments(attachments: Mapping[str, bytes]) -> Attachments:
    """Read the attached bench and sequence files."""
    try:
        bench = _document(attachments, BENCH_ATTACHMENT, Bench)
        if _unwatched(attachments):
            bench = without_watch(bench)
        bench = in_force(bench)
    except InputError as error:
        return Attachments(None, None, error.problems[0])
    try:
        sequence = _document(attachments, SEQUENCE_ATTACHMENT, StageSequence)
        return Attachments(bench.value, make_plan(sequence, bench, first_pass=True))
    except InputError as error:
        return Attachments(bench.value, None, error.problems[0])


def _unwatched(attachments: Mapping[str, bytes]) -> bool:
    """Return whether the run warned of a drive without watchdog, as its EDS may say."""
    try:
        warned = json.loads(attachments.get(RUN_ATTACHMENT, b"{}")).get("warnings", [])
    except (ValueError, AttributeError):
        return False
    return any(str(words).startswith(NO_WATCHDOG_AT_ALL) for words in warned)


def _document(attachments: Mapping[str, bytes], name: str, schema: type[Schema]) -> Document[Any]:
    """Validate one attachment."""
    if name not in attachments:
        raise InputError(f"{name} is not attached to the recording")
    try:
        root, _ = parse(attachments[name].decode("utf-8"))
    except (DocumentError, UnicodeDecodeError) as error:
        raise InputError(
            f"{name}, as attached to the recording, cannot be read: {error}"
        ) from error
    return validated(Path(name), root, schema)


Step = tuple[float, Limits]  # start time, s, and the limits from this time on


def limit_steps(
    plan: Plan, events: Iterable[Mapping[str, Any]], starts: Sequence[tuple[float, float]]
) -> list[Step]:
    """Return the limits of a run over the time of one recording, including first passes."""
    steps: list[Step] = [(-math.inf, plan.limits)]
    inside = False
    before: PlannedPass | None = None
    for event in events:
        if event["event"] == "first pass":
            passes = [p for s in plan.stages if s.name == event["stage"] for p in s.first_passes]
            alike = (math.isclose(p.amplitude, event["amplitude"], rel_tol=_SAME) for p in passes)
            planned = next((p for p, same in zip(passes, alike, strict=True) if same), None)
            if planned is None:
                continue
            steps += _pass_steps(planned, before, plan, event, starts)
            before, inside = planned, True
        elif inside and event["event"] in _ENDS_PASS:
            steps.append((event["time"], plan.limits))
            inside = False
        if event["event"] == "stage start":
            before = None
    return steps


def _pass_steps(
    planned: PlannedPass,
    before: PlannedPass | None,
    plan: Plan,
    event: Mapping[str, Any],
    starts: Sequence[tuple[float, float]],
) -> Iterator[Step]:
    """Yield the limits of the move to a first pass, and those of the pass."""
    yield event["time"], planned.move_limits
    begun = [command for time, command in starts if time <= event["time"]]
    if before is None and not begun:
        return
    # As in the sequencer: from the present angle of the joint, or from the end of the previous
    # pass.
    at = float(before.targets[-1]) if before is not None else begun[-1]
    speed = min(plan.approach_speed, APPROACH_SPEED_SHARE * planned.move_limits.speed)
    cycles = len(approach(at, float(planned.targets[0]), speed, plan.cycle_s))
    settle_s = next(stage.settle_s for stage in plan.stages if stage.name == event["stage"])
    yield event["time"] + cycles * plan.cycle_s + settle_s, planned.limits


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
    """A phase of a stage, s; ``segment`` is the number of an excitation, or 0."""

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
    """Return the phases of one recording in order, named as in ``run.json``."""
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
            start, name = time, event.get("stage", "")
            if (segment := known.get(number)) is not None:
                start, name = segment.start, segment.name
            current = Span(start, last, name, _OPENS[kind], number)
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


def _moment_of(
    record: RunRecord,
    tail: Derived,
    segments: Sequence[SegmentRecord],
    events: Sequence[Mapping[str, Any]],
) -> Moment:
    """Return when an unfinished run ended: its trip, else its last sample in motion."""
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
    """Return the spans of the phases up to the end of the run, and the braking after it."""
    cut: list[Span] = []
    for span in found:
        if span.start < moment.time:
            cut.append(dataclasses.replace(span, stop=min(span.stop, moment.time)))
        if span.stop > moment.time:
            cut.append(dataclasses.replace(span, start=max(span.start, moment.time), phase=BRAKING))
    return cut


@dataclass(frozen=True)
class Tripped:
    """Trip of a run: value and limit in SI units; a value that is not a number is NaN."""

    check: Check
    value: float
    limit: float


class Recorded:
    """One recording of a run, read in order to draw it."""

    def __init__(self, folder: Path, record: RunRecord, number: int) -> None:
        self.record = record
        self.part: PartRecord = record.parts[number - 1]
        self.traces: Traces = read_traces(
            folder / self.part.file, recorded_bench(record), record.cycle_s
        )
        self.attached: Attachments = read_attachments(self.traces.attachments)
        self.segments: list[SegmentRecord] = [s for s in record.segments if s.part == number]
        plan = self.attached.plan
        self.steps: list[Step] = (
            [] if plan is None else limit_steps(plan, self.traces.events, self.traces.starts)
        )
        self.is_last = number == len(record.parts)

    @property
    def spans(self) -> list[Span]:
        """Phases of the recording; requires samples."""
        return spans(self.traces.events, self.segments, self.traces.end_s)

    @property
    def moment(self) -> Moment | None:
        """Time of the end of a run that stopped in this recording, else None."""
        tail = self.traces.tail
        if not self.is_last or self.record.state == "done" or tail is None:
            return None
        return _moment_of(self.record, tail, self.segments, self.traces.events)

    @property
    def tripped(self) -> Tripped | None:
        """The trip of the run, if the run tripped in this recording; else None."""
        trip = self.record.trip
        check = next((check for check in Check if trip and check.value == trip.get("check")), None)
        if trip is None or check is None or not self.is_last:
            return None
        return Tripped(check, _number(trip.get("value")), _number(trip.get("limit")))


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
