"""One complete run: starts the recording, runs the plan, stores the outcome in the run folder."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.clock import NS, RealClock
from identification.recording import Dataset
from rig.common.errors import InputError, StorageError
from rig.common.provenance import sha256, sha256_file, utc_now, versions
from rig.common.sample import Phase
from rig.config.bench import Bench, calibration_records, overdue, redacted
from rig.config.configuration import Document
from rig.config.sequence import Sequence
from rig.control.cycle import Progress
from rig.control.operator import AutomaticOperator, Operator
from rig.control.phase_handlers import Console, StartingPoint
from rig.control.safety import Check, Trip, remedy
from rig.control.sequencer import Outcome, Sequencer
from rig.planning.feedforward import Feedforward
from rig.planning.plan import Plan, make_plan, stage_records
from rig.planning.predicted_load import FIRST_PASS, PredictedLoad
from rig.planning.reference import Reference
from rig.runs.recorded_inputs import GivenFile, input_entry
from rig.runs.recorder import GoneError, Recorder, open_recorder
from rig.runs.run import (
    RunFolder,
    bench_constants,
    create_folder,
    first_unfinished,
    load_run,
    part_file,
)
from rig.runs.run_record import (
    ACCEPTANCE_INPUT,
    BENCH_ATTACHMENT,
    FEEDFORWARD_INPUT,
    SEQUENCE_ATTACHMENT,
    Ending,
    PartRecord,
    RunRecord,
)
from rig.terminal.stop_button import StopButton
from rig.weighing.weight_check import Scale
from rig.wiring.connect import connect, device_files
from rig.wiring.devices import Devices, unprotected
from rig.wiring.drive_limits import only_here

MEDIA_YAML = "application/yaml"
MEDIA_JSON = "application/json"
DEVICES = ("servo", "encoder", "pressure")


@dataclass(frozen=True)
class Inputs:
    """The inputs of a run."""

    bench: Document[Bench]
    sequence: Document[Sequence]
    seed: int
    realtime: bool
    operator: str | None = None  # name of the person who runs the bench, as stated by the user
    reference: Reference | None = None
    reset_fault: bool = False
    # Model of the feed-forward torque that the drive adds, or None for none.
    feedforward: Feedforward | None = None
    # `run.json` of a stopped run to continue at its first unfinished stage, or None for a new run.
    resumed: RunRecord | None = None
    # File of the limits by which the complete run is judged, or None for the limits in the sequence
    # file.
    acceptance: GivenFile | None = None
    load: PredictedLoad | None = None

    def files(self) -> dict[str, bytes]:
        """Return the contents of bench and sequence file, by the names of their attachments."""
        return {
            BENCH_ATTACHMENT: self.bench.path.read_bytes(),
            SEQUENCE_ATTACHMENT: self.sequence.path.read_bytes(),
        }


def new_record(inputs: Inputs, plan: Plan) -> RunRecord:
    """Return the initial ``run.json``, before any motion."""
    paths = (inputs.bench.path, inputs.sequence.path)
    model = inputs.feedforward
    offset = {} if model is None else {FEEDFORWARD_INPUT: input_entry(model.source, model.sha256)}
    calibrations = calibration_records(inputs.bench.value, utc_now().date())
    return RunRecord(
        name=plan.name,
        created=utc_now().isoformat(timespec="seconds"),
        seed=inputs.seed,
        simulated=inputs.bench.value.simulated,
        realtime=inputs.realtime,
        cycle_s=plan.cycle_s,
        versions=versions(),
        inputs={
            name: input_entry(path, sha256(content))
            for (name, content), path in zip(inputs.files().items(), paths, strict=True)
        }
        | {
            name: input_entry(path, sha256_file(path))
            for name, path in device_files(inputs.bench).items()
        }
        | offset,
        bench=dataclasses.asdict(bench_constants(inputs.bench.value)),
        stages=stage_records(plan),
        operator=inputs.operator,
        calibrations=calibrations,
        warnings=[
            f"{warning}; the results depend on this value" for warning in overdue(calibrations)
        ],
    )


def execute(
    inputs: Inputs,
    plan: Plan,
    devices: Devices,
    path: Path,
    operator: Operator,
    stop: StopButton,
    progress: Progress,
    start_recording: Callable[[Path], Recorder] = open_recorder,
) -> tuple[RunFolder, Outcome]:
    """Run a plan into an empty folder, or continue a stopped run.

    The link is open at the call and stays open.

    Raises:
        DeviceError: A device cannot be identified; nothing was energised.
        StorageError: The recording cannot be started; nothing was energised.
    """
    wall = RealClock()
    began_ns = wall.now_ns()
    record = inputs.resumed or new_record(inputs, plan)
    if inputs.acceptance is not None:
        record.inputs = {**record.inputs, ACCEPTANCE_INPUT: inputs.acceptance.entry}
    identities = describe_devices(devices)
    part = _begin_part(record, inputs, identities)
    folder = RunFolder(path, record, _warn(inputs, plan, record, devices, operator))
    folder.save()
    folder.reserve()
    if devices.guard is not None:
        devices.guard.record_in(path)
    recorder = _start_recording(folder, inputs, identities, start_recording)
    outcome = None
    try:
        sequencer = Sequencer(
            plan,
            devices,
            Console(operator, stop, progress),
            recorder,
            folder,
            Scale(inputs.reference),
            StartingPoint(
                stage=first_unfinished(record) or 0,
                segment=max((segment.index for segment in record.segments), default=0),
                reset_fault=inputs.reset_fault,
            ),
        )
        outcome = sequencer.run()
        if outcome.trip is not None:
            record.trip = _trip_record(outcome.trip, inputs.load, sequencer)
        cycle = sequencer.cycle
        part.cycles, part.timing = cycle.count, cycle.timing.record()
        record.cycles += cycle.count
        record.overruns += cycle.overruns
        record.stale += cycle.stale
    finally:
        outcome = _close(recorder, outcome)
        part.seconds = (wall.now_ns() - began_ns) / NS
        _finish(record, part, outcome)
        folder.release()
        outcome = _save(folder, outcome)
    assert outcome is not None
    return folder, outcome


def _warn(
    inputs: Inputs, plan: Plan, record: RunRecord, devices: Devices, operator: Operator
) -> frozenset[str]:
    """Show what nothing protects and what may trip; store it once in the record; return it."""
    servo, told = devices.servo, unprotected(devices)
    if (words := only_here(servo, plan.servo_limits, servo.read_limits())) is not None:
        told.append(words)
    if inputs.load is not None:
        told += inputs.load.warnings
    for words in told:
        operator.tell(words)
        if words not in record.warnings:
            record.warnings.append(words)
    return frozenset(told)


def _start_recording(
    folder: RunFolder, inputs: Inputs, identities: dict[str, Any], start: Callable[[Path], Recorder]
) -> Recorder:
    """Create the recording; if this fails, ``run.json`` says that nothing was energised."""
    recorder = None
    try:
        recorder = start(folder.recording)
        _head(recorder, inputs, folder.record, identities)
    except StorageError as error:
        message = f"{error}; nothing was energised"
        part = folder.record.parts[-1]
        part.state, part.message = Ending.FAILED.value, message
        with suppress(StorageError):
            folder.ended(Ending.FAILED.value, message, de_energised=True)
        if recorder is not None:
            with suppress(StorageError):
                recorder.close()
        raise StorageError(message) from error
    return recorder


def _begin_part(record: RunRecord, inputs: Inputs, identities: Mapping[str, Any]) -> PartRecord:
    record.state, record.message, record.trip, record.de_energised = "running", "", None, None
    record.drive_state = record.drive = None
    part = PartRecord(
        file=part_file(len(record.parts) + 1),
        created=utc_now().isoformat(timespec="seconds"),
        seed=inputs.seed,
        operator=inputs.operator,
        versions=versions(),
        devices=identities,
    )
    record.parts.append(part)
    return part


def describe_devices(devices: Devices) -> dict[str, Any]:
    """Read identities and the limits stored in the drive, or raise a DeviceError."""
    told = {
        "servo": dataclasses.asdict(devices.servo.identity()),
        "encoder": dataclasses.asdict(devices.encoder.identity()),
        "limits": held_limits(devices),
    }
    if devices.pressure is not None:
        told["pressure"] = dataclasses.asdict(devices.pressure.identity())
    return told


def held_limits(devices: Devices) -> dict[str, float | None]:
    """Read the limits stored in the drive; None without an object, or with the window off."""
    limits = dataclasses.asdict(devices.servo.read_limits())
    if not limits["quick_stop_option"] >= 0:
        limits["quick_stop_option"] = None
    return {
        name: None if value is None or math.isnan(value) else value
        for name, value in limits.items()
    }


def _head(
    recorder: Recorder, inputs: Inputs, record: RunRecord, identities: dict[str, Any]
) -> None:
    """Write what explains the samples first, so that a truncated file contains it."""
    part = record.parts[-1]
    run = {
        "name": record.name,
        "created": part.created,
        "seed": str(part.seed),
        "operator": part.operator or "",
    }
    recorder.metadata("run", {**run, "part": str(len(record.parts))})
    recorder.metadata("versions", part.versions)
    recorder.metadata("sha256", {name: entry["sha256"] for name, entry in record.inputs.items()})
    for role in DEVICES:
        if role in identities:
            recorder.metadata(role, {name: str(value) for name, value in identities[role].items()})
    if record.calibrations:
        recorder.metadata(
            "calibrations", {c["device"]: f"{c['id']}, due {c['due']}" for c in record.calibrations}
        )
    for name, content in inputs.files().items():
        recorder.attach(
            name, MEDIA_YAML, redacted(content) if name == BENCH_ATTACHMENT else content
        )
    if inputs.feedforward is not None:
        recorder.attach(FEEDFORWARD_INPUT, MEDIA_JSON, Path(inputs.feedforward.source).read_bytes())
    if inputs.acceptance is not None:
        recorder.attach(ACCEPTANCE_INPUT, MEDIA_YAML, inputs.acceptance.content)
    recorder.attach("devices.json", MEDIA_JSON, json.dumps(identities, indent=1).encode())
    recorder.attach("run.json", MEDIA_JSON, json.dumps(dataclasses.asdict(record)).encode())


def _close(recorder: Recorder, outcome: Outcome | None) -> Outcome | None:
    """Close the recording; a run whose recording cannot be finished has failed."""
    try:
        recorder.close()
    except GoneError as error:
        return _failed(outcome, str(error))
    except StorageError as error:
        return _failed(outcome, f"the recording lacks its end: {error}; then use `rig recover`")
    return outcome


def _save(folder: RunFolder, outcome: Outcome | None) -> Outcome | None:
    """Save ``run.json``; on a full disk the old version remains, which the outcome says."""
    try:
        folder.save()
    except StorageError as error:
        return _failed(outcome, str(error))
    return outcome


def _failed(outcome: Outcome | None, problem: str) -> Outcome | None:
    """Return the outcome of a run with incomplete files; a good ending becomes a failure."""
    if outcome is None:
        return None
    ending = Ending.FAILED if outcome.ending is Ending.DONE else outcome.ending
    return dataclasses.replace(outcome, ending=ending, message=f"{outcome.message}; {problem}")


def _finish(record: RunRecord, part: PartRecord, outcome: Outcome | None) -> None:
    """Write the ending into the record; if there is no outcome, the program failed."""
    record.seconds += part.seconds
    part.ended = utc_now().isoformat(timespec="seconds")
    if outcome is None:
        record.state, record.message = Ending.CRASHED.value, "the program failed"
    else:
        record.state, record.message = outcome.ending.value, outcome.message
        record.de_energised, record.drive_state = outcome.safe.verified, outcome.safe.state
        record.drive = outcome.safe.record()
    part.state, part.message = record.state, record.message
    record.stage_ended(record.state)


def _trip_record(trip: Trip, load: PredictedLoad | None, sequencer: Sequencer) -> dict[str, Any]:
    """Return the record of a trip, with the peak that was predicted for this part of the stage."""
    part = FIRST_PASS if sequencer.phase is Phase.FIRST_PASS else "stage"
    peak = None if load is None else load.peak(sequencer.stage, part)
    peaks = {} if peak is None else {Check.CURRENT: peak.current_A, Check.TORQUE: peak.torque_N_m}
    found = dataclasses.asdict(trip) | {
        "check": trip.check.value,
        "value": trip.value if math.isfinite(trip.value) else None,
        "predicted": peaks.get(trip.check),
    }
    return {**found, "message": f"{trip.event}; {remedy(trip.check, found)}"}


class _Unattended(AutomaticOperator):
    """Operator of a simulated run, who answers every prompt with the plan and shows no messages."""

    def tell(self, words: str, typed: str = "") -> None:
        """Show nothing."""

    def result(self, words: str, good: bool) -> None:
        """Show nothing."""


def run_simulated(
    bench: Document[Bench],
    sequence: Document[Sequence],
    seed: int,
    folder: Path,
    feedforward: Feedforward | None = None,
) -> Dataset:
    """Run a sequence on a simulated bench with the planned weights, and return its recordings."""
    if not bench.value.simulated:
        raise InputError(
            bench.problem(
                ("bus",), "this command runs without an operator, so the bench must be simulated"
            )
        )
    plan = make_plan(sequence, bench, feedforward=feedforward)
    inputs = Inputs(bench, sequence, seed, realtime=False, feedforward=feedforward)
    with (
        create_folder(folder, "rig"),
        connect(bench, seed, realtime=False, torque_offset=feedforward is not None) as devices,
    ):
        _, outcome = execute(
            inputs, plan, devices, folder, _Unattended(), StopButton(), lambda *_: None
        )
    if outcome.error is not None:
        raise outcome.error
    if outcome.ending is Ending.STOPPED:
        raise KeyboardInterrupt
    if outcome.ending is not Ending.DONE:
        raise InputError(f"{sequence.value.name} on {bench.value.name}: {outcome.message}")
    return load_run(folder)
