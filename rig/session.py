"""One run from opened bus to closed folder: recording started, plan run, everything written down however it ends."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.clock import NS, RealClock
from rig.bench import Bench
from rig.configuration import Document
from rig.cycle import Devices, Progress
from rig.operator import Operator, StopButton
from rig.plan import Plan
from rig.provenance import sha256, utc_now, versions
from rig.recorder import Recorder, open_recorder
from rig.run import (
    BENCH_ATTACHMENT,
    SEQUENCE_ATTACHMENT,
    RunFolder,
    RunRecord,
    bench_constants,
    stage_records,
)
from rig.sequence import Sequence
from rig.sequencer import Ending, Outcome, Sequencer

MEDIA_YAML = "application/yaml"
MEDIA_JSON = "application/json"


@dataclass(frozen=True)
class Inputs:
    """What a run was asked for: the two files, validated, and the seed."""

    bench: Document[Bench]
    sequence: Document[Sequence]
    seed: int
    realtime: bool

    def files(self) -> dict[str, bytes]:
        """Return attachment name to content of both files."""
        return {
            BENCH_ATTACHMENT: self.bench.path.read_bytes(),
            SEQUENCE_ATTACHMENT: self.sequence.path.read_bytes(),
        }


def new_record(inputs: Inputs, plan: Plan) -> RunRecord:
    """Return ``run.json`` as it stands before anything moves."""
    paths = (inputs.bench.path, inputs.sequence.path)
    return RunRecord(
        name=plan.name,
        created=utc_now().isoformat(timespec="seconds"),
        seed=inputs.seed,
        simulated=inputs.bench.value.simulated,
        realtime=inputs.realtime,
        cycle_s=plan.cycle_s,
        versions=versions(),
        inputs={
            name: {"file": str(path), "sha256": sha256(content)}
            for (name, content), path in zip(inputs.files().items(), paths, strict=True)
        },
        bench=dataclasses.asdict(bench_constants(inputs.bench.value)),
        stages=stage_records(plan),
    )


def execute(
    inputs: Inputs, plan: Plan, devices: Devices, path: Path, operator: Operator, stop: StopButton, progress: Progress
) -> tuple[RunFolder, Outcome]:
    """Run a plan into an empty folder. The link is open on entry and left open.

    Raises:
        DeviceError: A device cannot even be identified; nothing was energised.
        OSError: The recording cannot be started; nothing was energised.
    """
    wall = RealClock()
    began_ns = wall.now_ns()
    folder = RunFolder(path, new_record(inputs, plan))
    identities = describe_devices(devices)
    folder.save()
    recorder = open_recorder(folder.recording)
    outcome = None
    try:
        _head(recorder, inputs, folder.record, identities)
        sequencer = Sequencer(plan, devices, operator, recorder, folder, stop, progress)
        try:
            outcome = sequencer.run()
        finally:
            cycle = sequencer.cycle
            folder.record.cycles, folder.record.overruns, folder.record.stale = cycle.count, cycle.overruns, cycle.stale
    finally:
        outcome = _close(recorder, outcome)
        _finish(folder.record, outcome, (wall.now_ns() - began_ns) / NS)
        outcome = _save(folder, outcome)
    assert outcome is not None
    return folder, outcome


def describe_devices(devices: Devices) -> dict[str, Any]:
    """Read identities and the limits that the drive holds.

    Raises:
        DeviceError: A device does not answer.
    """
    return {
        "servo": dataclasses.asdict(devices.servo.identity()),
        "encoder": dataclasses.asdict(devices.encoder.identity()),
        "limits": dataclasses.asdict(devices.servo.read_limits()),
    }


def _head(recorder: Recorder, inputs: Inputs, record: RunRecord, identities: dict[str, Any]) -> None:
    """Put everything that explains the samples at the front, where even a torn file keeps it."""
    recorder.metadata("run", {"name": record.name, "created": record.created, "seed": str(record.seed)})
    recorder.metadata("versions", record.versions)
    for name, content in inputs.files().items():
        recorder.attach(name, MEDIA_YAML, content)
    recorder.attach("devices.json", MEDIA_JSON, json.dumps(identities, indent=1).encode())
    recorder.attach("run.json", MEDIA_JSON, json.dumps(dataclasses.asdict(record)).encode())


def _close(recorder: Recorder, outcome: Outcome | None) -> Outcome | None:
    """Close the recording; a run whose recording cannot be finished has failed."""
    try:
        recorder.close()
    except OSError as error:
        return _failed(outcome, f"the recording's end cannot be written ({error.strerror}); use `rig recover`")
    return outcome


def _save(folder: RunFolder, outcome: Outcome | None) -> Outcome | None:
    """Save ``run.json``; on a full disk the last version stays, and the outcome says so."""
    try:
        folder.save()
    except OSError as error:
        return _failed(outcome, f"run.json cannot be written ({error.strerror}); use `rig recover`")
    return outcome


def _failed(outcome: Outcome | None, problem: str) -> Outcome | None:
    if outcome is None:
        return None
    return dataclasses.replace(outcome, ending=Ending.FAILED, message=f"{outcome.message}; {problem}")


def _finish(record: RunRecord, outcome: Outcome | None, seconds: float) -> None:
    """Write the ending into the record; without an outcome the program itself broke down."""
    record.seconds = seconds
    if outcome is None:
        record.state, record.message = Ending.FAILED.value, "the program broke down; see its traceback"
        return
    record.state, record.message = outcome.ending.value, outcome.message
    record.de_energised = outcome.safe.verified
    if outcome.trip is not None:
        trip = outcome.trip
        value = trip.value if math.isfinite(trip.value) else None
        record.trip = {**dataclasses.asdict(trip), "check": trip.check.value, "value": value, "message": trip.message}
