"""Mends a run whose writer died: a clean recording from what is readable, and ``run.json`` completed from it."""

from __future__ import annotations

import dataclasses
import heapq
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rig.errors import InputError
from rig.mcap_layout import EVENT_TOPIC, FRAMES_TOPIC, SAMPLE_TOPIC
from rig.mcap_reader import Log
from rig.recorder import Recorder, open_recorder
from rig.run import (
    RECORDING_FILE,
    RUN_FILE,
    RunRecord,
    SegmentRecord,
    StageRecord,
    read_log,
    read_record,
    write_json,
)
from rig.sequencer import Ending

DAMAGED_FILE = "recording.damaged.mcap"
_ENDINGS = {ending.value for ending in Ending}
_MEDIA = {".json": "application/json", ".yaml": "application/yaml"}


@dataclass(frozen=True)
class Recovery:
    """What was done.

    Attributes:
        damage: What was wrong with the recording, or None.
        samples: How many samples there are now.
        record: ``run.json`` as it stands now.
    """

    damage: str | None
    samples: int
    record: RunRecord


def recover(folder: Path) -> Recovery:
    """Rewrite a damaged recording, keeping the damaged file, and complete ``run.json``. A whole run is left alone.

    Raises:
        InputError: There is no readable recording, or an earlier recovery is in the way.
        OSError: The folder cannot be written.
    """
    path = folder / RECORDING_FILE
    log = read_log(path)
    record = _record(folder, log)
    if log.damage is not None:
        damaged = folder / DAMAGED_FILE
        if damaged.exists():
            raise InputError(f"{damaged}: is there from an earlier recovery; move it away first")
        clean = folder / ".recording.new.mcap"
        clean.unlink(missing_ok=True)
        _copy(log, open_recorder(clean))
        os.replace(path, damaged)
        os.replace(clean, path)
    if log.damage is not None or record.state == "running":
        _complete(record, log)
        write_json(folder / RUN_FILE, dataclasses.asdict(record))
    return Recovery(log.damage, len(log.samples["time"]), record)


def _record(folder: Path, log: Log) -> RunRecord:
    """Return the last ``run.json``, or the one attached to the recording where the file is lost."""
    try:
        return read_record(folder)
    except InputError:
        attached = log.attachments.get(RUN_FILE)
        if attached is None:
            raise
    write_json(folder / RUN_FILE, json.loads(attached))
    return read_record(folder)


def _copy(log: Log, recorder: Recorder) -> None:
    """Write everything readable into a new recording, in order of time."""
    try:
        for name, values in log.metadata.items():
            recorder.metadata(name, values)
        for name, content in log.attachments.items():
            recorder.attach(name, _MEDIA.get(Path(name).suffix, "application/octet-stream"), content)
        topics = (SAMPLE_TOPIC, FRAMES_TOPIC, EVENT_TOPIC)
        streams = [[(m.time_ns, rank, m.data) for m in log.messages[topic]] for rank, topic in enumerate(topics)]
        for time_ns, rank, data in heapq.merge(*streams, key=lambda item: item[:2]):
            recorder.copy(topics[rank], time_ns, data)
    finally:
        recorder.close()


def _complete(record: RunRecord, log: Log) -> None:
    """Work out from the samples which excitations were finished, and from the events how the run ended."""
    record.segments = list(_segments(record.stages, log, record.cycle_s))
    finished = {segment.index for segment in record.segments if segment.end is not None}
    index = 0
    for stage in record.stages:
        numbers = range(index + 1, index + stage.repeats + 1)
        index += stage.repeats
        stage.state = "done" if finished.issuperset(numbers) else stage.state if stage.state == "planned" else "running"
    last = next((e for e in reversed(log.events) if e["event"] in _ENDINGS), None)
    record.state = last["event"] if last else Ending.FAILED.value
    record.message = last["message"] if last else f"the writer died; {len(log.samples['time'])} samples recovered"
    record.cycles = len(log.samples["time"])


def _segments(stages: list[StageRecord], log: Log, cycle_s: float) -> Iterator[SegmentRecord]:
    """Yield the excitations that have samples; one short of samples has no end."""
    index = 0
    for stage in stages:
        for repeat in range(1, stage.repeats + 1):
            index += 1
            times = log.samples["time"][log.samples["segment"] == index]
            if not len(times):
                continue
            segment = stage.segment(index, repeat, float(times[0]))
            if len(times) == stage.samples:
                segment.end = float(times[-1]) + cycle_s
            yield segment
