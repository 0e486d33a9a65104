"""Proposes experiments for a bench, and writes the proposals."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.amt21.encoder import COUNTS_PER_TURN
from identification.design.propose import Proposal, propose
from identification.design.search import Bounds, Excitation, Frame, Part
from identification.design.simulated import NAMES, Intervals, PlannedModel, Sensors
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
from rig.config.sequence import (
    SAMPLES_PER_PERIOD,
    Array,
    Ramp,
    Sequence,
    StageSection,
    Tone,
    excitation,
    plain_sequence,
    sequence_text,
)
from rig.planning.limits import Limits
from rig.planning.plan import bench_limits, make_plan
from rig.planning.reference import read_identification
from rig.results.document import Document as Page
from rig.results.document import Note, Section, Table
from rig.runs.run import bench_constants, load_run

_SMALLEST = 1e-12  # smallest plausible parameter value, SI units; the largest is its inverse


@dataclass(frozen=True)
class NominalValues:
    """Nominal values of a bench before an experiment."""

    values: dict[str, float]  # the nine parameters, SI
    source: str  # origin of the nominal values, as text
    weakest: str | None = None  # the least accurate parameter, or None if unknown
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
        widths = {n: _half_width(raw["parameters"][n]) for n in known}
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
    weakest = max(widths, key=lambda n: widths[n]) if widths else None
    return NominalValues({**NOMINAL, **found}, words, weakest, _recordings(inputs), noise)


def _torque_noise(noise: dict[str, Any] | None) -> float | None:
    """Return the total torque noise in a result file, N m rms, or None if not stated."""
    if noise is None or noise["unit"] != "N m":
        return None
    whole = math.hypot(float(noise["torque"]), float(noise["correlated"]))
    if not math.isfinite(whole):
        raise ValueError("the torque noise of the result is not a number")
    return whole or None


def _half_width(parameter: dict[str, Any]) -> float:
    """Return a parameter's relative half width in a result file; infinite if undetermined."""
    value, low, high = (parameter[key] for key in ("value", "low", "high"))
    return math.inf if not value or low is None or high is None else 0.5 * (high - low) / abs(value)


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
WEIGHTS_KG = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
"""Masses, kg, to choose from beside the sequence's, if the bench file lists none."""


@dataclass(frozen=True)
class Experiment:
    """A planned experiment."""

    sequence: Sequence
    nominal: PlannedModel
    nominal_source: str
    current_noise_A: float
    proposal: Proposal
    proposed: Sequence
    seed: int
    seconds: float


def plan_experiment(
    sequence: Document[Sequence],
    bench: Document[Bench],
    nominal_file: Path | None,
    current_noise_A: float | None,
    seed: int,
    progress: Callable[[str, float], None],
) -> Experiment:
    """Assess a sequence on the nominal model of a bench, and search for a better sequence of the
    same duration.

    ``bench``: bench whose limits, sensors and stated constants are used; the section of the
    simulated machine is not used. ``nominal_file``: result of ``rig identify --json`` on this
    bench, or None for the default nominal values. ``current_noise_A``: noise of the logged current,
    A rms, or None for the value in the nominal file, or a thousandth of the current limit.
    """
    started = time.perf_counter()
    limits = make_plan(sequence, bench).limits
    _require_tones_and_weights(sequence)
    known = nominal_values(nominal_file)
    noise = current_noise_A
    if noise is None and known.torque_noise is not None:
        noise = known.torque_noise / limits.torque_per_ampere
    elif noise is None:
        noise = NOISE_SHARE * bench.value.limits.current_A
    nominal = _nominal(bench.value, known, limits, noise)
    bounds = Bounds(
        angle_min=limits.angle_min,
        angle_max=limits.angle_max,
        speed=limits.speed,
        torque=_torque(bench.value, limits),
        following=limits.following_error,
        highest_Hz=min(bench.value.cycle_Hz / SAMPLES_PER_PERIOD, 20.0),
        weights=_weights(bench.value, [s for s in sequence.value.stages if s.stage == "loaded"]),
    )
    frames = [_frame(stage, bench.value.cycle_s) for stage in sequence.value.stages]
    found = propose(frames, nominal, bounds, np.random.default_rng(seed), progress, known.weakest)
    stages = _stages(sequence.value.stages, frames, found.stages)
    proposed = sequence.value.model_copy(
        update={"name": f"{sequence.value.name}-proposed", "stages": stages}
    )
    return Experiment(
        sequence.value,
        nominal,
        known.source,
        noise,
        found,
        proposed,
        seed,
        time.perf_counter() - started,
    )


def _require_tones_and_weights(sequence: Document[Sequence]) -> None:
    """Raise InputError unless an experiment can be planned from every stage."""
    remedy = "leave this stage out of the sequence"
    for key, wrong, words in (
        ("ramp", lambda stage: stage.ramp is not None, "from tones, not from ramps"),
        ("stage", lambda stage: stage.stage == "hot_fire", "with weights, not with hot firings"),
    ):
        sequence.require(
            (("stages", k, key), f"an experiment is planned {words}; {remedy}")
            for k, stage in enumerate(sequence.value.stages)
            if wrong(stage)
        )


def _torque(bench: Bench, limits: Limits) -> float:
    """Return the highest torque allowed by the torque and current limits, N m at the joint."""
    return min(limits.torque, bench_limits(bench).torque_per_ampere * bench.limits.current_A)


def _nominal(bench: Bench, known: NominalValues, limits: Limits, noise_A: float) -> PlannedModel:
    torque, step = _torque(bench, limits), _joint_step(bench)
    return PlannedModel(
        known.values,
        bench_constants(bench),
        Sensors(bench.cycle_s, step, noise_A * limits.torque_per_ampere),
        torque,
        loop=drive_loop(known.recordings, torque, step),
    )


def _joint_step(bench: Bench) -> float:
    """Return the joint angle of one step of the finer encoder, rad."""
    encoder = bench.encoder
    counts = [
        float(encoder.counts_per_turn if isinstance(encoder, EncoderSection) else COUNTS_PER_TURN)
    ]
    if isinstance(bench.servo, ServoSection):
        counts.append(bench.servo.counts_per_motor_turn * bench.machine.gear_ratio)
    return 2.0 * math.pi / max(counts)


def _weights(bench: Bench, loaded: list[StageSection]) -> tuple[float, ...]:
    """Return the masses that may be hung, kg, within the bench's limits."""
    offered = bench.weights_kg or (*WEIGHTS_KG, *(s.weight_kg for s in loaded))
    m, limits = bench.machine, bench.limits
    heaviest = min(limits.weight_kg, limits.contact_force_N / (m.lever_ratio * m.gravity_m_s2))
    return tuple(sorted({w for w in offered if w <= heaviest} or {s.weight_kg for s in loaded}))


def _frame(stage: StageSection, cycle_s: float) -> Frame:
    tones = tuple((math.radians(t.amplitude_deg), t.frequency_Hz) for t in stage.tones)
    present = Excitation(tones, stage.weight_kg, stage.duration_s)

    def render(e: Excitation) -> Array:
        """Return the joint angles of all repeats; phases of the file are for its own tones only."""
        section = stage if e is present else _with(stage, e, stage.name)
        once = np.concatenate(
            [np.zeros(round(section.settle_s / cycle_s)), excitation(section, cycle_s)]
        )
        once[: round(section.settle_s / cycle_s)] = math.radians(section.center_deg)
        return np.tile(once, section.repeats)

    total = stage.repeats * (stage.settle_s + stage.duration_s)
    return Frame(stage.stage == "loaded", present, total, stage.settle_s, render)


def _stages(
    stages: tuple[StageSection, ...], frames: list[Frame], parts: tuple[Part, ...]
) -> tuple[StageSection, ...]:
    """Return the stages of a proposal; stages that replace one stage are numbered."""
    out = []
    for k, (stage, frame) in enumerate(zip(stages, frames, strict=True)):
        own = [p.excitation for p in parts if p.frame == k]
        if own == [frame.present]:
            out.append(stage)  # unchanged, with its phases and repeats
        else:
            out += [_with(stage, e, f"{stage.name}-{k}") for k, e in enumerate(own, 1)]
    return tuple(out)


def _with(stage: StageSection, e: Excitation, name: str) -> StageSection:
    """Return a stage with another excitation about its centre, rounded as in a sequence file."""
    changes: dict[str, Any] = {
        "name": name,
        "weight_kg": e.weight,
        "duration_s": e.seconds,
        "repeats": 1,
    }
    # The time limit of the given stage does not apply to the proposed stage; the plan computes a
    # new limit.
    changes["time_limit_s"] = None
    if e.ramps is None:
        tones = tuple(
            Tone(amplitude_deg=round(math.degrees(a), 3) or 0.001, frequency_Hz=round(f, 4))
            for a, f in e.tones
        )
        fades = {"ramp_in_s": e.fade, "ramp_out_s": e.fade}
        return stage.model_copy(update={**changes, "tones": tones, **fades})
    speed = round(math.degrees(e.ramps.speed), 3)
    travel = (
        math.floor(1e3 * speed * e.ramps.away - 1e-6) / 1e3
    )  # so that the motion out and back fits in the duration
    ramp = Ramp(travel_deg=travel, speed_deg_s=speed, rest_s=0.0, times=round(e.seconds / e.step))
    unfaded = {
        name: StageSection.model_fields[name].default for name in ("ramp_in_s", "ramp_out_s")
    }
    return stage.model_copy(update={**changes, "tones": (), "ramp": ramp, **unfaded})


PROPOSAL_FILE = "proposal.yaml"


def proposal_text(experiment: Experiment, bench: str) -> str:
    """Return the sequence file of a proposal; a comment states its purpose."""
    determined = _intervals_words(experiment.proposal.proposed)
    head = (
        f"# Proposed by `rig identify --plan` in place of {experiment.sequence.name}, bench "
        f"{bench}, seed {experiment.seed}.\n"
        f"# Nominal: {experiment.nominal_source}.\n# {determined}.\n"
    )
    return sequence_text(experiment.proposed, head)


def _intervals_words(found: Intervals) -> str:
    """Return how many parameters are determined, and the least accurate."""
    open_names = [n for n, w in found.half_widths.items() if not w <= WIDEST]
    if open_names:
        return f"does not determine {', '.join(open_names)}"
    return (
        f"determines all {len(found.half_widths)}; the least accurate is "
        f"{found.weakest}, to +-{percent(100.0 * found.worst)}"
    )


def plan_document(experiment: Experiment) -> Page:
    """Return what the given and the proposed sequence determine, and the proposed stages."""
    title = f"Experiment in place of {experiment.sequence.name}"
    return Page(title, "", tuple(_summary(experiment)))


def _summary(experiment: Experiment) -> Iterator[Section]:
    now, then = experiment.proposal.present, experiment.proposal.proposed
    sequence, proposed = experiment.sequence.name, experiment.proposed.name
    head = (
        "90 % interval over the value, half width, from simulated replicates of the nominal model:"
    )
    yield Section("", (Note(head),))
    yield Section("", (_widths(experiment),))
    lines = (
        f"{sequence}: {_intervals_words(now)}",
        f"{proposed}: {_intervals_words(then)}",
        _advice(experiment),
    )
    yield Section("", tuple(map(Note, lines)))
    yield Section("", (_stage_table(experiment),))
    last = (
        f"nominal: {experiment.nominal_source}; current noise {experiment.current_noise_A:.3g} A "
        f"rms; {_drive(experiment)}; {experiment.proposal.judged} excitations judged, "
        f"{experiment.proposal.identified} experiments simulated and "
        f"identified, in {experiment.seconds:.1f} s"
    )
    yield Section("", (Note(last),))


def _widths(experiment: Experiment) -> Table:
    now, then = experiment.proposal.present, experiment.proposal.proposed
    names = (experiment.sequence.name, experiment.proposed.name)
    rows = tuple(
        (
            n,
            number(experiment.nominal.values[n]),
            _width(now, n),
            _width(then, n),
            _gain(now, then, n),
        )
        for n in now.half_widths
    )
    return Table(("parameter", "nominal", *names, "times tighter"), rows, (1, 2, 3, 4))


def _stage_table(experiment: Experiment) -> Table:
    rows = tuple(
        (stage.name, f"{stage.weight_kg:g}", f"{stage.duration_s:g}", excitation_words(stage))
        for stage in experiment.proposed.stages
    )
    return Table(("stage", "kg", "s", "excitation"), rows, (1, 2))


def _advice(experiment: Experiment) -> str:
    """Return the purpose of the proposal, or that no proposal was better."""
    aim = f"aimed at {experiment.proposal.weakest}, so far the least accurate parameter"
    if experiment.proposal.proposed == experiment.proposal.present:
        return (
            f"{aim}: no other experiment had narrower intervals when it was simulated and "
            "identified, so the given sequence is proposed unchanged; with another --seed, other "
            "experiments are tried"
        )
    return (
        f"{aim}; if another parameter gets a wider interval, run both sequences and "
        "identify both runs together"
    )


def _drive(experiment: Experiment) -> str:
    loop = experiment.nominal.loop
    if loop is None:
        return "a stiff drive loop is assumed"
    return f"drive loop as recorded: velocity gain {loop.velocity_gain:.3g} N m s/rad"


def _width(found: Intervals, name: str) -> str:
    width = found.half_widths[name]
    return percent(100.0 * width) if math.isfinite(width) else "not determined"


def _gain(now: Intervals, then: Intervals, name: str) -> str:
    ratio = now.half_widths[name] / then.half_widths[name]
    return f"{ratio:.2g}" if math.isfinite(ratio) else "-"


def excitation_words(stage: StageSection) -> str:
    """Return a description of the excitation of a stage: sines or ramps."""
    if stage.ramp is not None:
        ramp = stage.ramp
        return (
            f"{ramp.times} times {ramp.travel_deg:g} deg out and back at {ramp.speed_deg_s:g} deg/s"
        )
    return ", ".join(f"{t.amplitude_deg:g} deg at {t.frequency_Hz:g} Hz" for t in stage.tones)


PLAN_SCHEMA = "loadrig.plan/1"
RESULT_FILE = "plan.json"


def plan_record(experiment: Experiment, bench: str) -> dict[str, Any]:
    """Return the record of ``rig identify --plan --json``."""
    return {
        **heading(PLAN_SCHEMA),
        "seconds": experiment.seconds,
        "seed": experiment.seed,
        "bench": bench,
        "nominal": {"source": experiment.nominal_source, "values": dict(experiment.nominal.values)},
        "current_noise_A": experiment.current_noise_A,
        "aimed_at": experiment.proposal.weakest,
        "present": _intervals_record(experiment.sequence, experiment.proposal.present),
        "proposed": _intervals_record(experiment.proposed, experiment.proposal.proposed),
        "fisher_half_widths": {
            n: finite(w) for n, w in experiment.proposal.predicted.half_widths.items()
        },
        "judged": experiment.proposal.judged,
        "rehearsed": experiment.proposal.identified,
    }


def _intervals_record(sequence: Sequence, found: Intervals) -> dict[str, Any]:
    return {
        "sequence": plain_sequence(sequence),
        "relative_half_widths": {name: finite(width) for name, width in found.half_widths.items()},
        "weakest": found.weakest,
    }
