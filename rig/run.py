"""The run folder: ``run.json`` kept true at every moment, and the recordings read back for identification."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from identification.recording import Array, Dataset, Recording, RecordingError
from identification.recording import Bench as BenchConstants
from rig import clocks
from rig.bench import Bench
from rig.errors import InputError
from rig.mcap_reader import Log, NotARecordingError, read_run
from rig.plan import Plan
from rig.provenance import sha256_file
from rig.weight_check import Weighing

SCHEMA = "loadrig.run/1"
RUN_FILE = "run.json"
RECORDING_FILE = "recording.mcap"
BENCH_ATTACHMENT = "bench.yaml"
SEQUENCE_ATTACHMENT = "sequence.yaml"
_CHANNELS = ("command", "motor_angle", "angle", "velocity", "current", "voltage", "supply_voltage", "temperature")


@dataclass
class StageRecord:
    """State of one stage: ``planned``, ``running`` or ``done``."""

    name: str
    stage: str
    weight_kg: float
    repeats: int
    samples: int
    state: str = "planned"
    confirmed_kg: float | None = None

    def segment(self, index: int, stage_index: int, repeat: int, start: float, part: int) -> SegmentRecord:
        """Return the record of one of this stage's excitations, numbered ``repeat`` from 1, as it begins."""
        name = self.name if self.repeats == 1 else f"{self.name}[{repeat}]"
        return SegmentRecord(
            index, name, self.stage, self.weight_kg, start, self.samples, stage_index=stage_index, part=part
        )


@dataclass
class SegmentRecord:
    """One excitation: which stage it belongs to, and when it ran, s since the start of its recording.

    Attributes:
        index: From 1, unique in the run; the samples carry it.
        stage_index: Which stage.
        part: Which recording, from 1.
        kept: False once its stage was begun again.
    """

    index: int
    name: str
    stage: str
    weight_kg: float
    start: float
    samples: int
    end: float | None = None
    stage_index: int = 0
    part: int = 1
    kept: bool = True


@dataclass
class PartRecord:
    """One recording of a run: the first, or that of a ``rig resume``."""

    file: str
    created: str
    seed: int
    operator: str | None
    versions: Mapping[str, str]
    devices: Mapping[str, Any] = field(default_factory=dict)
    state: str = "running"
    cycles: int = 0
    seconds: float = 0.0
    timing: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class RunRecord:
    """Everything in ``run.json``."""

    name: str
    created: str
    seed: int
    simulated: bool
    realtime: bool
    cycle_s: float
    versions: Mapping[str, str]
    inputs: Mapping[str, Mapping[str, str]]
    bench: Mapping[str, Any]
    stages: list[StageRecord]
    segments: list[SegmentRecord] = field(default_factory=list)
    parts: list[PartRecord] = field(default_factory=list)
    operator: str | None = None
    calibrations: list[Mapping[str, Any]] = field(default_factory=list)
    weights: list[Mapping[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    state: str = "running"
    message: str = ""
    trip: Mapping[str, Any] | None = None
    de_energised: bool | None = None
    cycles: int = 0
    overruns: int = 0
    stale: int = 0
    seconds: float = 0.0
    schema: str = SCHEMA


class RunFolder:
    """A run folder being written; a :class:`rig.sequencer.Journal`.

    Args:
        path: The folder.
        record: What is to be in ``run.json``.
    """

    def __init__(self, path: Path, record: RunRecord) -> None:
        self.path = path
        self.record = record

    @property
    def recording(self) -> Path:
        """The file of the recording being written."""
        return self.path / self.record.parts[-1].file

    def save(self) -> None:
        """Replace ``run.json`` as a whole, so that no reader ever sees half of it.

        Raises:
            OSError: It cannot be written; the last version is kept.
        """
        write_json(self.path / RUN_FILE, dataclasses.asdict(self.record))

    def stage_started(self, index: int) -> None:
        """Note that a stage begins; what it left behind before is not used any more."""
        discard(self.record, index)
        self.record.stages[index].state = "running"
        self.save()

    def weight_confirmed(self, index: int, weight_kg: float) -> None:
        """Note the mass that the operator confirmed."""
        self.record.stages[index].confirmed_kg = weight_kg

    def weighed(self, weighing: Weighing) -> None:
        """Note a weight check."""
        self.record.weights.append({**dataclasses.asdict(weighing), "verdict": weighing.verdict.value})

    def stage_finished(self, index: int) -> None:
        """Note that a stage is complete and the drive de-energised."""
        self.record.stages[index].state = "done"
        self.save()

    def segment_started(self, stage: int, repeat: int, segment: int, time: float) -> None:
        """Note that an excitation begins at ``time`` s of the recording."""
        record = self.record
        record.segments.append(record.stages[stage].segment(segment, stage, repeat, time, len(record.parts)))
        self.save()

    def segment_finished(self, segment: int, time: float) -> None:
        """Note that it is complete."""
        self.record.segments[segment - 1].end = time
        self.save()


def discard(record: RunRecord, stage: int) -> None:
    """Mark what a stage left behind so far as not to be used."""
    for segment in record.segments:
        if segment.stage_index == stage:
            segment.kept = False


def first_unfinished(record: RunRecord) -> int | None:
    """Return the index of the first stage that is not done, or None."""
    return next((index for index, stage in enumerate(record.stages) if stage.state != "done"), None)


def part_file(number: int) -> str:
    """Return the file name of a run's recording, from 1."""
    return RECORDING_FILE if number == 1 else f"recording-{number}.mcap"


def stage_records(plan: Plan) -> list[StageRecord]:
    """Return the stages of a plan as they stand before the run."""
    return [StageRecord(s.name, s.stage, s.weight_kg, s.repeats, len(s.targets)) for s in plan.stages]


def bench_constants(bench: Bench) -> BenchConstants:
    """Return what an identification needs to know of a bench."""
    m = bench.machine
    return BenchConstants(
        motion="rotary",
        torque_constant=m.torque_constant_N_m_A,
        back_emf_constant=m.back_emf_constant_V_s_rad,
        resistance=m.resistance_ohm,
        inductance=m.inductance_H,
        gear_ratio=m.gear_ratio,
        moment_arm=m.moment_arm_m,
        lever_ratio=m.lever_ratio,
        gravity=m.gravity_m_s2,
    )


def create_folder(path: Path) -> None:
    """Make the folder of a new run.

    Raises:
        InputError: It exists and is not empty, or cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        occupied = next(path.iterdir(), None)
    except OSError as error:
        raise InputError(f"{path}: cannot be used as a run folder: {error.strerror}") from error
    if occupied is not None:
        raise InputError(
            f"{path}: not empty (holds {occupied.name}); give --out a new folder, so that no run is overwritten"
        )


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write JSON by replacing the file in one step.

    Raises:
        OSError: It cannot be written; an earlier version is kept.
    """
    draft = path.with_name(f".{path.name}.new")
    try:
        with open(draft, "w", encoding="utf-8") as stream:
            json.dump(record, stream, indent=1)
            stream.write("\n")
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(draft, path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def read_record(folder: Path) -> RunRecord:
    """Read ``run.json``.

    Raises:
        InputError: It is missing, damaged, or of another version.
    """
    path = folder / RUN_FILE
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; is this a run folder?") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    if not isinstance(raw, dict) or raw.get("schema") != SCHEMA:
        found = raw.get("schema") if isinstance(raw, dict) else type(raw).__name__
        raise InputError(f"{path}: schema: this program reads {SCHEMA} (got {found!r})")
    try:
        stages = [StageRecord(**item) for item in raw.pop("stages")]
        segments = [SegmentRecord(**item) for item in raw.pop("segments")]
        parts = [PartRecord(**item) for item in raw.pop("parts")]
        return RunRecord(stages=stages, segments=segments, parts=parts, **raw)
    except (TypeError, KeyError) as error:
        raise InputError(f"{path}: damaged: {error}; `rig recover` rebuilds it from the recording") from error


def load_run(folder: Path) -> Dataset:
    """Read a run folder for identification: one recording per finished excitation.

    Samples whose answer was incomplete are left out, and the recording says so. Of a stage that was done more than
    once, the last counts.

    Raises:
        InputError: The folder is not a run, its recording is unreadable, or no stage was finished.
    """
    record = read_record(folder)
    finished = [segment for segment in record.segments if segment.kept and segment.end is not None]
    if not finished:
        # A recording that cannot be read at all is the better explanation.
        read_log(folder / RECORDING_FILE)
        raise InputError(f"{folder}: no stage was finished (state {record.state}: {record.message or 'writer died'})")
    bench = BenchConstants(**record.bench)
    recordings: list[Recording] = []
    for number in sorted({segment.part for segment in finished}):
        part = record.parts[number - 1]
        path = folder / part.file
        log = read_log(path)
        if log.damage is not None and part.state == "done":
            raise InputError(f"{path}: damaged though the run was finished: {log.damage}; use `rig recover {folder}`")
        digest = sha256_file(path)
        try:
            recordings += [_recording(s, log, bench, path, digest) for s in finished if s.part == number]
        except RecordingError as error:
            raise InputError(f"{path}: {error}") from error
    return Dataset(tuple(recordings))


def read_log(path: Path) -> Log:
    """Read a recording.

    Raises:
        InputError: It cannot be opened or is not a recording.
    """
    try:
        return read_run(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except NotARecordingError as error:
        raise InputError(str(error)) from error


def _recording(segment: SegmentRecord, log: Log, bench: BenchConstants, path: Path, digest: str) -> Recording:
    mine = log.samples["segment"] == segment.index
    stale = mine & (log.samples["fresh"] == 0)
    used = mine & ~stale
    channels: dict[str, Array] = {name: log.samples[name][used] for name in _CHANNELS}
    # The drive stamps its own latch; the host's time carries the jitter of its scheduler.
    device_time = log.samples["device_time"][used]
    notes = []
    if device_time.size > 1 and np.all(np.diff(device_time) > 0):
        offset = log.samples["time"][used][0] - device_time[0]
        channels["time"] = device_time + offset
    else:
        channels["time"] = log.samples["time"][used]
        notes.append("the drive's time stamps do not increase; the host's times are used")
    stamps = (log.samples[name][used] for name in ("time", "host_time", "device_time", "encoder_time"))
    notes += clocks.describe(*stamps)
    if stale.any():
        notes.append(f"{int(stale.sum())} samples left out: the answer of a device was missing")
    return Recording(
        name=segment.name,
        channels=channels,
        bench=bench,
        stage="loaded" if segment.stage == "loaded" else "unloaded",
        weight_mass=segment.weight_kg,
        averaged=frozenset({"current", "voltage"}),
        source=str(path),
        sha256=digest,
        notes=tuple(notes),
    )
