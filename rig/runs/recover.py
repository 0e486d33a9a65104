"""Repairs a run whose writer died, and finds the stage with which a stopped run continues."""

from __future__ import annotations

import dataclasses
import heapq
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rig.common.errors import InputError
from rig.common.locks import hold_folder
from rig.common.places import write_json
from rig.common.provenance import sha256_file
from rig.common.text import stored_path
from rig.config.bench import Bench, load_bench
from rig.config.configuration import Document
from rig.config.sequence import Sequence as SequenceFile
from rig.config.sequence import load_sequence
from rig.runs.mcap.layout import EVENT_TOPIC, FRAMES_TOPIC, SAMPLE_TOPIC
from rig.runs.mcap.reader import Log
from rig.runs.recorder import Recorder, open_recorder
from rig.runs.run import RESERVE_FILE, discard, first_unfinished, part_file, read_log
from rig.runs.run_file import read_record
from rig.runs.run_record import (
    ACCEPTANCE_INPUT,
    BENCH_ATTACHMENT,
    DIED,
    RECORDING_FILE,
    RUN_FILE,
    SEQUENCE_ATTACHMENT,
    Ending,
    RunRecord,
)

_ENDINGS = {ending.value for ending in Ending}
_MEDIA = {".json": "application/json", ".yaml": "application/yaml"}


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery."""

    damage: tuple[str, ...]  # message on each damaged file, which begins with the name of the file
    samples: int
    record: RunRecord  # `run.json` after the recovery
    changed: bool  # whether a file was written
    taken_over: str | None = None  # program that had left the folder locked, or None for none


def recover(folder: Path, purpose: str = "rig recover") -> Recovery:
    """Lock a run folder, and repair it with :func:`mend`.

    Raises:
        InUseError: The run is in progress, or another program uses the folder.
        StorageError: The folder cannot be locked.
    """
    with hold_folder(folder, purpose) as lock:
        return dataclasses.replace(mend(folder), taken_over=lock.taken_over)


def mend(folder: Path) -> Recovery:
    """Replace damaged recordings by clean recordings, keep the damaged files, and complete
    ``run.json``.

    A complete run is not changed. The caller must hold the lock of the folder.

    Raises:
        OSError: The folder cannot be written.
    """
    first = read_log(folder / RECORDING_FILE)
    (folder / RESERVE_FILE).unlink(missing_ok=True)
    record, damage = _record(folder)
    while len(record.parts) > 1 and _is_empty(folder / record.parts[-1].file):
        part = record.parts[-1]
        if part.state != "running":
            raise InputError(
                f"{folder / part.file}: the file is missing or empty, but {RUN_FILE} has this "
                f"recording as {part.state}; put the file back"
            )
        # The writer died before the first byte.
        (folder / part.file).unlink(missing_ok=True)
        record.parts.pop()
    logs = [first, *(read_log(folder / part.file) for part in record.parts[1:])]
    for part, log in zip(record.parts, logs, strict=True):
        if log.damage is not None:
            damage.append(f"{part.file}: {log.damage}")
            _mend(folder / part.file, log)
    changed = bool(damage) or record.state == "running"
    if changed:
        _complete(record, logs)
        write_json(folder / RUN_FILE, dataclasses.asdict(record))
    return Recovery(tuple(damage), sum(len(log.samples["time"]) for log in logs), record, changed)


def damaged_name(file: str) -> str:
    """Return the name under which a damaged file is kept."""
    return f"{Path(file).stem}.damaged{Path(file).suffix}"


def _is_empty(path: Path) -> bool:
    return not (path.exists() and path.stat().st_size)


def _mend(path: Path, log: Log) -> None:
    """Replace a damaged recording by a clean recording."""
    damaged = path.with_name(damaged_name(path.name))
    if damaged.exists():
        raise InputError(
            f"{damaged}: this file exists from an earlier recovery; move the file away first"
        )
    clean = path.with_name(f".{path.stem}.new.mcap")
    clean.unlink(missing_ok=True)
    _copy(log, open_recorder(clean))
    os.replace(path, damaged)
    os.replace(clean, path)


def _record(folder: Path) -> tuple[RunRecord, list[str]]:
    """Return ``run.json``, else the copy in the latest recording, and texts on its errors."""
    path = folder / RUN_FILE
    try:
        return read_record(folder), []
    except InputError as error:
        attached = _attached(folder)
        if attached is None:
            raise
        problems = [f"{RUN_FILE}: {error.problems[0]}"] if path.exists() else []
    if problems:
        os.replace(path, path.with_name(damaged_name(RUN_FILE)))
    write_json(path, json.loads(attached))
    return read_record(folder), problems


def _attached(folder: Path) -> bytes | None:
    """Return the ``run.json`` attached to the latest recording that has this attachment."""
    number = 1
    while (folder / part_file(number + 1)).exists():
        number += 1
    for part in range(number, 0, -1):
        with suppress(InputError):
            attached = read_log(folder / part_file(part)).attachments.get(RUN_FILE)
            if attached is not None:
                return attached
    return None


def _copy(log: Log, recorder: Recorder) -> None:
    """Write all readable records into a new recording, in order of time."""
    try:
        for name, values in log.metadata.items():
            recorder.metadata(name, values)
        for name, content in log.attachments.items():
            recorder.attach(
                name, _MEDIA.get(Path(name).suffix, "application/octet-stream"), content
            )
        topics = (SAMPLE_TOPIC, FRAMES_TOPIC, EVENT_TOPIC)
        streams = [
            [(m.time_ns, rank, m.data) for m in log.messages[topic]]
            for rank, topic in enumerate(topics)
        ]
        for time_ns, rank, data in heapq.merge(*streams, key=lambda item: item[:2]):
            recorder.copy(topics[rank], time_ns, data)
    finally:
        recorder.close()


def _complete(record: RunRecord, logs: Sequence[Log]) -> None:
    """Write into the record which excitations were finished and how the run ended."""
    record.segments = []
    for number, log in enumerate(logs, start=1):
        _add_segments(record, number, log)
    for index, stage in enumerate(record.stages):
        mine = [
            segment for segment in record.segments if segment.stage_index == index and segment.kept
        ]
        if len(mine) == stage.repeats and all(segment.end is not None for segment in mine):
            stage.state = "done"
        elif stage.state == "done":
            stage.state = "running"
    for part, log in zip(record.parts, logs, strict=True):
        part.cycles = len(log.samples["time"])
    last = next((e for e in reversed(logs[-1].events) if e["event"] in _ENDINGS), None)
    record.cycles = sum(part.cycles for part in record.parts)
    record.state = last["event"] if last else Ending.FAILED.value
    record.message = (
        last["message"] if last else f"the writer died; {record.cycles} samples recovered"
    )
    part = record.parts[-1]
    part.state, part.message = record.state if last else DIED, record.message
    short = [stage.name for stage in record.stages if stage.state != "done"]
    if record.state == Ending.DONE.value and short:
        record.state = Ending.FAILED.value
        record.message = (
            f"samples of {', '.join(short)} are missing from the recording; `rig resume` "
            "repeats this stage"
        )
    record.stage_ended(record.state)


def _add_segments(record: RunRecord, part: int, log: Log) -> None:
    """Add the excitations and confirmed masses of one recording; an excitation with missing samples
    gets no end.
    """
    index = None
    for event in log.events:
        if event["event"] == "prompt":
            discard(record, event["index"])
            index = event["index"]
        elif event["event"] == "answer" and index is not None:
            record.stages[index].confirmed_kg = event["weight_kg"]
        elif event["event"] == "segment":
            stage = record.stages[event["index"]]
            times = log.samples["time"][log.samples["segment"] == event["number"]]
            start = float(times[0]) if len(times) else float(event["time"])
            segment = stage.segment(event["number"], event["index"], event["repeat"], start, part)
            if len(times) == stage.samples:
                segment.end = float(times[-1]) + record.cycle_s
            record.segments.append(segment)


_ATTACHED = {BENCH_ATTACHMENT, SEQUENCE_ATTACHMENT}


@dataclass(frozen=True)
class Resumption:
    """Inputs of a resumed run."""

    record: RunRecord  # `run.json`, completed
    bench: Document[Bench]  # the bench file of the run, which is unchanged
    sequence: Document[SequenceFile]  # the sequence file of the run, which is unchanged
    stage: int
    mended: tuple[str, ...]  # messages on recordings whose writer died
    # Whether the writer of the last recording died, so that the drive's watchdog stopped the drive.
    died: bool


def prepare(folder: Path) -> Resumption:
    """Repair a run if its writer died, and find the stage with which the run continues.

    Recordings of the unfinished stage are marked as not to be used. The caller must hold the lock
    of the folder until the resumed run has ended.

    Raises:
        OSError: The folder cannot be written.
    """
    recovery = mend(folder)
    record = read_record(folder)
    stage = first_unfinished(record)
    if stage is None:
        raise InputError(
            f"{folder}: all {len(record.stages)} stages are done; there is no stage to resume"
        )
    bench = load_bench(_unchanged(folder, record, BENCH_ATTACHMENT))
    sequence = load_sequence(_unchanged(folder, record, SEQUENCE_ATTACHMENT))
    for name in sorted(set(record.inputs) - _ATTACHED - {ACCEPTANCE_INPUT}):
        _unchanged(folder, record, name)
    discard(record, stage)
    return Resumption(
        record, bench, sequence, stage, recovery.damage, record.parts[-1].state == DIED
    )


def _unchanged(folder: Path, record: RunRecord, name: str) -> Path:
    """Return the path of an input file that is unchanged since the start of the run."""
    entry = record.inputs[name]
    path = stored_path(entry["file"])
    attached = f" (it is attached to the recording as {name})" if name in _ATTACHED else ""
    if name == BENCH_ATTACHMENT and record.simulated:
        attached = attached.replace(")", ", without the simulated machine's true constants)")
    remedy = f"restore the file with which the run began{attached}, or start a new run"
    try:
        digest = sha256_file(path)
    except OSError as error:
        text = (
            f"{path}: {folder} was run with this file, which cannot be read: {error.strerror}; "
            f"{remedy}"
        )
        raise InputError(text) from error
    if digest != entry["sha256"]:
        then, now = entry["sha256"][:12], digest[:12]
        raise InputError(
            f"{path}: changed since {folder} was run with this file (SHA-256 {then}, now "
            f"{now}); {remedy}"
        )
    return path


def stopped_words(record: RunRecord) -> str:
    """Return the state of the run as a sentence."""
    done = sum(stage.state == "done" for stage in record.stages)
    return (
        f"{record.name}: {done} of {len(record.stages)} stages done; {record.state}: "
        f"{record.message}"
    )
