"""Predicts which parameters a sequence would determine on a bench, before it is run."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.amt21.encoder import COUNTS_PER_TURN
from identification.design.simulated import (
    NAMES,
    Intervals,
    PlannedModel,
    PlannedStage,
    Sensors,
    expected,
    with_drives,
)
from identification.model.parameters import NOMINAL
from identification.numerics.arrays import finite
from identification.recording import Recording
from identification.result import WIDEST
from identification.simulation.drive_loop import drive_loop
from rig.common.errors import InputError
from rig.common.provenance import heading, sha256_file
from rig.common.tables import number, percent
from rig.config.bench import Bench
from rig.config.canopen import EncoderSection, ServoSection
from rig.config.configuration import Document
from rig.config.sequence import Sequence, excitation, plain_sequence
from rig.planning.plan import bench_limits, make_plan
from rig.planning.reference import read_identification
from rig.results.document import Document as Page
from rig.results.document import Note, Section, columns
from rig.runs.run import bench_constants, load_run

_SMALLEST = 1e-12  # smallest plausible parameter value, SI units; the largest is its inverse


@dataclass(frozen=True)
class NominalValues:
    """Nominal values of a bench before an experiment."""

    values: dict[str, float]  # the nine parameters, SI
    source: str  # origin of the nominal values, as text
    # The recordings from which the values were identified, if the run can still be read.
    recordings: tuple[Recording, ...] = ()
    torque_noise: float | None = None  # noise of the measured torque, N m rms, or None if unknown


def nominal_values(path: Path | None) -> NominalValues:
    """Return the values of a result of `rig identify --json`; a parameter that the result does not
    determine gets the default nominal value.
    """
    if path is None:
        return NominalValues(
            dict(NOMINAL), "the paper's friction and the practical bench's inertia"
        )
    raw = read_identification(path)
    try:
        known = {n: raw["parameters"][n]["value"] for n in NAMES if n in raw["parameters"]}
        found = {n: float(v) for n, v in known.items() if v is not None}
        noise = _torque_noise(raw.get("noise"))
        inputs = {Path(entry["file"]): str(entry["sha256"]) for entry in raw.get("inputs", [])}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged: {error}; run `rig identify` again") from error
    problems = [
        f"{path}: parameters.{n}: must be from {_SMALLEST:g} to {1 / _SMALLEST:g} (got {v:g})"
        for n, v in found.items()
        if not _SMALLEST <= v <= 1 / _SMALLEST
    ]
    if problems:
        raise InputError(problems)
    open_names = [n for n in NAMES if n not in found]
    words = f"the identification {path}"
    if open_names:
        words += f"; {', '.join(open_names)}, not determined by the result, at their default values"
    return NominalValues({**NOMINAL, **found}, words, _recordings(inputs), noise)


def _torque_noise(noise: dict[str, Any] | None) -> float | None:
    """Return the total torque noise in a result file, N m rms, or None if not stated."""
    if noise is None or noise["unit"] != "N m":
        return None
    whole = math.hypot(float(noise["torque"]), float(noise["correlated"]))
    if not math.isfinite(whole):
        raise ValueError("the torque noise of the result is not a number")
    return whole or None


def _recordings(inputs: dict[Path, str]) -> tuple[Recording, ...]:
    """Return the recordings of the input runs that are unchanged."""
    out: list[Recording] = []
    for folder in sorted({file.parent for file in inputs}):
        mine = {file: digest for file, digest in inputs.items() if file.parent == folder}
        try:
            if all(sha256_file(file) == digest for file, digest in mine.items()):
                out += load_run(folder).recordings
        except (InputError, OSError):
            continue  # not a run, or no longer there: the drive is then assumed
    return tuple(out)


NOISE_SHARE = 1e-3  # default current noise as a share of the bench's current limit


@dataclass(frozen=True)
class Experiment:
    """A planned experiment, and what it would determine."""

    sequence: Sequence
    nominal: PlannedModel
    nominal_source: str
    current_noise_A: float
    intervals: Intervals
    seconds: float


def plan_experiment(
    sequence: Document[Sequence],
    bench: Document[Bench],
    nominal_file: Path | None,
    current_noise_A: float | None,
) -> Experiment:
    """Predict what a sequence would determine, on the nominal model of a bench.

    ``bench``: bench whose limits, sensors and stated constants are used; the section of the
    simulated machine is not used. ``nominal_file``: result of ``rig identify --json`` on this
    bench, or None for the default nominal values. ``current_noise_A``: noise of the logged current,
    A rms, or None for the value in the nominal file, or a thousandth of the current limit.
    """
    started = time.perf_counter()
    limits = make_plan(sequence, bench).limits
    sequence.require(
        (
            ("stages", k, "stage"),
            "an experiment is planned with weights, not with hot firings; leave this stage out of "
            "the sequence",
        )
        for k, stage in enumerate(sequence.value.stages)
        if stage.stage == "hot_fire"
    )
    known = nominal_values(nominal_file)
    noise = current_noise_A
    if noise is None and known.torque_noise is not None:
        noise = known.torque_noise / limits.torque_per_ampere
    elif noise is None:
        noise = NOISE_SHARE * bench.value.limits.current_A
    value, cycle_s, step = bench.value, bench.value.cycle_s, _joint_step(bench.value)
    # The highest torque allowed by the torque and current limits, N m at the joint.
    torque = min(limits.torque, bench_limits(value).torque_per_ampere * value.limits.current_A)
    nominal = PlannedModel(
        known.values,
        bench_constants(value),
        Sensors(cycle_s, step, noise * limits.torque_per_ampere),
        torque,
        loop=drive_loop(known.recordings, torque, step),
    )
    stages = []
    for stage in sequence.value.stages:
        rest = np.full(round(stage.settle_s / cycle_s), math.radians(stage.center_deg))
        once = np.concatenate([rest, excitation(stage, cycle_s)])
        stages.append(PlannedStage(np.tile(once, stage.repeats), stage.weight_kg))
    found, _ = expected(stages, with_drives(nominal))
    spent = time.perf_counter() - started
    return Experiment(sequence.value, nominal, known.source, noise, found, spent)


def _joint_step(bench: Bench) -> float:
    """Return the joint angle of one step of the finer encoder, rad."""
    encoder = bench.encoder
    counts = [
        float(encoder.counts_per_turn if isinstance(encoder, EncoderSection) else COUNTS_PER_TURN)
    ]
    if isinstance(bench.servo, ServoSection):
        counts.append(bench.servo.counts_per_motor_turn * bench.machine.gear_ratio)
    return 2.0 * math.pi / max(counts)


def plan_document(experiment: Experiment) -> Page:
    """Return what a sequence determines."""
    name, found, loop = experiment.sequence.name, experiment.intervals, experiment.nominal.loop
    head = (
        "90 % interval over the value, half width, from simulated replicates of the nominal model:"
    )
    widths = columns(
        found.half_widths.items(),
        (1, 2),
        ("parameter", lambda w: w[0]),
        ("nominal", lambda w: number(experiment.nominal.values[w[0]])),
        (name, lambda w: percent(100.0 * w[1]) if math.isfinite(w[1]) else "not determined"),
    )
    said = (
        f"determines all {len(found.half_widths)}; the least accurate is "
        f"{found.weakest}, to +-{percent(100.0 * found.worst)}"
    )
    if open_names := [n for n, w in found.half_widths.items() if not w <= WIDEST]:
        said = f"does not determine {', '.join(open_names)}"
    drive = "a stiff drive loop is assumed"
    if loop is not None:
        drive = f"drive loop as recorded: velocity gain {loop.velocity_gain:.3g} N m s/rad"
    last = (
        f"nominal: {experiment.nominal_source}; current noise {experiment.current_noise_A:.3g} A "
        f"rms; {drive}; in {experiment.seconds:.1f} s"
    )
    parts = (Note(head), widths), (Note(f"{name}: {said}"),), (Note(last),)
    return Page(f"What {name} determines", "", tuple(Section("", part) for part in parts))


PLAN_SCHEMA = "loadrig.plan/2"
RESULT_FILE = "plan.json"


def plan_record(experiment: Experiment, bench: str) -> dict[str, Any]:
    """Return the record of ``rig identify --plan --json``."""
    widths = experiment.intervals.half_widths
    return {
        **heading(PLAN_SCHEMA),
        "seconds": experiment.seconds,
        "bench": bench,
        "nominal": {"source": experiment.nominal_source, "values": dict(experiment.nominal.values)},
        "current_noise_A": experiment.current_noise_A,
        "sequence": plain_sequence(experiment.sequence),
        "relative_half_widths": {name: finite(width) for name, width in widths.items()},
        "weakest": experiment.intervals.weakest,
    }
