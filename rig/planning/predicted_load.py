"""Predicts peak torque and current of a plan (eq. 9 to 13), and judges them before any motion."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identification.model.friction import load_coefficient, system_friction
from identification.model.parameters import NOMINAL
from identification.recording import Bench as BenchConstants
from rig.common.errors import InputError
from rig.common.provenance import RESULT_FILE
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.config.sequence import Array, Sequence, approach
from rig.planning.hot_fire import steady_force
from rig.planning.limits import Limits
from rig.planning.plan import Plan, PlannedStage
from rig.planning.reference import moment_per_kg, read_values
from rig.runs.run_file import read_record, recorded_bench

NOMINAL_ALPHA = 2.0
RUNS = Path("runs")

_UNLOADED_FRICTION = ("Mc", "Ms")
_LOAD_FRICTION = ("mu_c", "mu_s")


@dataclass(frozen=True)
class FrictionModel:
    """Friction and inertia of a bench, SI, at the joint; ``from_paper`` lists what is assumed."""

    values: Mapping[str, float]
    alpha: float
    moment_arm_m: float
    moment_per_kg: float
    source: str
    measured: bool
    from_paper: tuple[str, ...] = ()

    def friction_measured(self, loaded: bool) -> bool:
        """Return whether the friction of a stage, ``loaded`` or not, was measured on this bench."""
        needed = _UNLOADED_FRICTION + (_LOAD_FRICTION if loaded else ())
        return self.measured and not set(needed) & set(self.from_paper)


def friction_model(
    bench: BenchConstants,
    named: Path | None = None,
    runs: Path = RUNS,
    option: str = "--identification",
) -> FrictionModel:
    """Return the friction ``named`` with an ``option`` of a command, else the newest in ``runs`` of
    the bench, or the paper's.
    """
    if named is not None:
        return _identified(named, bench)
    newest: list[tuple[float, Path]] = []
    with suppress(OSError):
        newest += sorted((p.stat().st_mtime, p) for p in runs.glob(f"*/{RESULT_FILE}"))
    for _, path in reversed(newest):
        try:
            if recorded_bench(read_record(path.parent)) == bench:
                return _identified(path, bench)
        except InputError:
            continue  # an incomplete run folder does not state its bench
    words = (
        f"the paper's friction and the inertia {NOMINAL['J']:g} kg m^2 of the packaged benches, "
        f"because there is no identification of this bench; give a result with {option}"
    )
    return _model(bench, {}, NOMINAL_ALPHA, words, measured=False)


def of_another_bench(path: Path, bench: BenchConstants) -> str | None:
    """Return a warning if an identification is of a run on a bench with other constants."""
    try:
        recorded = recorded_bench(read_record(path.parent))
    except InputError:
        return None  # outside a run folder the bench is unknown
    if recorded == bench:
        return None
    differing = [
        f"{field.name} {_shown(getattr(recorded, field.name))}, here "
        f"{_shown(getattr(bench, field.name))}"
        for field in dataclasses.fields(bench)
        if getattr(recorded, field.name) != getattr(bench, field.name)
    ]
    return (
        f"{path}: identified on a bench with other constants ({'; '.join(differing)}); check the "
        "bench file and, if it is right, identify a run on this bench"
    )


def _shown(value: object) -> str:
    return (
        f"{value:g}" if isinstance(value, float | int) else "other" if value is not None else "none"
    )


def _identified(path: Path, bench: BenchConstants) -> FrictionModel:
    known, alpha = read_values(path, NOMINAL)
    missing = [name for name in NOMINAL if name not in known]
    words = f"the identification {path}"
    if missing:
        words += f"; {', '.join(missing)}, not determined by the result, from the paper"
    return _model(bench, known, alpha, words, measured=True)


def _model(
    bench: BenchConstants, known: Mapping[str, float], alpha: float, source: str, measured: bool
) -> FrictionModel:
    missing = tuple(name for name in NOMINAL if name not in known)
    values, arm = {**NOMINAL, **known}, bench.moment_arm or 0.0
    return FrictionModel(values, alpha, arm, moment_per_kg(bench), source, measured, missing)


WARNING_SHARE = 0.8  # predicted peak, as a share of its limit, above which the program warns
LOOP_S = 0.005  # time in which a drive with stiff gains follows a step of the speed, s
FIRST_PASS = "first pass"
LESS = "use less weight, or a slower or smaller motion"
_HIGHER = "a greater limit_share of first_pass in the sequence"
LESS_ANYWHERE = f"{LESS}; in a first pass, also {_HIGHER} helps"
"""Remedy for a peak above its limit in a part of a stage that is not known."""
_FROM_PAPER = (
    "predicted from the paper's friction, which may differ from this bench's: run a small, slow "
    "motion, `rig identify` it, then give --identification RESULT"
)


@dataclass(frozen=True)
class PredictedPeak:
    """The greatest torque of one part of a stage, and its limits."""

    stage: str
    part: str
    torque_N_m: float
    torque_limit_N_m: float
    current_A: float
    current_limit_A: float

    @property
    def torque_share(self) -> float:
        """Peak torque as a share of its limit."""
        return self.torque_N_m / self.torque_limit_N_m

    @property
    def current_share(self) -> float:
        """Peak current as a share of its limit."""
        return self.current_A / self.current_limit_A

    @property
    def share(self) -> float:
        """The greater of peak torque over its limit and peak current over its limit."""
        return max(self.torque_share, self.current_share)


@dataclass(frozen=True)
class PredictedLoad:
    """The predicted peaks of a plan, and what they mean before the run."""

    plan: Plan
    model: FrictionModel
    peaks: list[PredictedPeak]

    @classmethod
    def of(cls, plan: Plan, bench: Bench, model: FrictionModel) -> PredictedLoad:
        """Predict the peaks of a plan on a bench."""
        return cls(plan, model, predicted_peaks(plan, bench, model))

    @property
    def problems(self) -> list[str]:
        """Messages on peaks that are predicted from measured friction and exceed their limits."""
        return [text for _, text in self._above_limits()]

    @property
    def warnings(self) -> list[str]:
        """Messages on peaks near limits, or above them by the paper's friction, by remedy."""
        found: dict[tuple[str, str], list[str]] = {}
        for peak in self.peaks:
            measured, above = self._measured(peak), peak.share > 1.0
            if above and measured:
                continue
            share, words = (
                (1.0, "above") if above else (WARNING_SHARE, f"above {WARNING_SHARE:.0%} of")
            )
            less = _remedy(peak) if measured else f"{_remedy(peak)}; {_FROM_PAPER}"
            if exceeding := ", ".join(_exceeding(peak, share)):
                found.setdefault((words, less), []).append(f"{_where(peak)}: {exceeding}")
        return [
            f"predicted peaks {words} their limits: {'; '.join(peaks)}; {less}"
            for (words, less), peaks in found.items()
        ]

    def require_within(self, sequence: Document[Sequence]) -> None:
        """Refuse (InputError) a run with a peak from measured friction above its limit."""
        names = [stage.name for stage in sequence.value.stages]
        problems = [
            sequence.problem(
                ("stages", names.index(peak.stage), "name"),
                f"{text}; predicted from {self.model.source}",
            )
            for peak, text in self._above_limits()
        ]
        if problems:
            raise InputError(problems)

    def peak(self, stage: str, part: str) -> PredictedPeak | None:
        """Return the peak of a part of a stage, or None if it is not predicted."""
        return next((p for p in self.peaks if (p.stage, p.part) == (stage, part)), None)

    def _above_limits(self) -> Iterator[tuple[PredictedPeak, str]]:
        for peak in self.peaks:
            if self._measured(peak) and (exceeding := ", ".join(_exceeding(peak, 1.0))):
                yield (
                    peak,
                    f"{_where(peak)}: predicted peak above its limit: {exceeding}; {_remedy(peak)}",
                )

    def _measured(self, peak: PredictedPeak) -> bool:
        """Return whether the friction of the stage of a peak was measured on this bench."""
        loaded = any(
            stage.weight_kg > 0.0 or stage.stage == "hot_fire"
            for stage in self.plan.stages
            if stage.name == peak.stage
        )
        return self.model.friction_measured(loaded)


def _where(peak: PredictedPeak) -> str:
    return f"{peak.stage}, {peak.part}" if peak.part == FIRST_PASS else peak.stage


def _remedy(peak: PredictedPeak) -> str:
    return f"{LESS}, or {_HIGHER}" if peak.part == FIRST_PASS else LESS


def _exceeding(peak: PredictedPeak, share: float) -> Iterator[str]:
    """Yield the quantities of a peak that exceed a share of their limits."""
    for name, value, limit, unit in (
        ("torque", peak.torque_N_m, peak.torque_limit_N_m, "N m"),
        ("current", peak.current_A, peak.current_limit_A, "A"),
    ):
        if value > share * limit:
            yield f"{name} {value:.4g} {unit} (limit {limit:.4g} {unit})"


def predicted_peaks(plan: Plan, bench: Bench, model: FrictionModel) -> list[PredictedPeak]:
    """Return the predicted peaks of every stage and its first pass, in the order of the run."""
    return [peak for stage in plan.stages for peak in _peaks(stage, plan, bench, model)]


def _peaks(
    stage: PlannedStage, plan: Plan, bench: Bench, model: FrictionModel
) -> Iterator[PredictedPeak]:
    moment = model.moment_per_kg * stage.weight_kg
    if stage.first_passes:
        low = stage.first_passes[0]
        torque = peak_torque(low.targets, plan.cycle_s, np.full(len(low.targets), moment), model)
        yield _peak(stage.name, FIRST_PASS, torque, low.limits)
    hot = stage.stage == "hot_fire"
    moments = (
        model.moment_arm_m * steady_force(stage.targets, bench)
        if hot
        else np.full(len(stage.targets), moment)
    )
    if stage.flow is None:
        torque = peak_torque(stage.targets, plan.cycle_s, moments, model)
    else:
        # A controller may accelerate the joint from rest to its highest speed at any time.
        fastest = stage.peak_speed_rad_s
        breaking = _at_speed(0.0, moments, model) + model.values["J"] * fastest / LOOP_S
        torque = max(breaking, _at_speed(fastest, moments, model))
    for move in moves_to_start(stage, plan):
        held = np.full(len(move), np.max(moments[:1], initial=0.0))
        torque = max(torque, peak_torque(move, plan.cycle_s, held, model))
    yield _peak(stage.name, "stage", torque, plan.limits)


def moves_to_start(stage: PlannedStage, plan: Plan) -> list[Array]:
    """Return the angles of each move to the start of a part, rad, from 0 on."""
    parts = [first.targets for first in stage.first_passes[:1]] + [stage.targets] * stage.repeats
    moves, here = [], 0.0
    for targets in parts:
        move = approach(here, float(targets[0]), plan.approach_speed, plan.cycle_s)
        moves += [np.concatenate([[here], move])] if len(move) else []
        here = float(targets[-1])
    return moves


def _peak(stage: str, part: str, torque: float, limits: Limits) -> PredictedPeak:
    current = torque / limits.torque_per_ampere
    return PredictedPeak(stage, part, torque, limits.torque, current, limits.current)


def peak_torque(angle: Array, cycle_s: float, moments: Array, model: FrictionModel) -> float:
    """Return the greatest torque, N m, at a joint that follows commanded angles.

    The torque balances static friction at a breakaway, and friction, working load and inertia in
    motion (eq. 15). The prediction does not contain the feedback torque of the drive, which is
    large in stick-slip.

    Args:
        angle: Commanded joint angles, rad, one per cycle, shape (n,), at least two.
        cycle_s: Control cycle, s.
        moments: Contact moment F_P L1 at each angle, N m, shape (n,).
        model: Friction and inertia of the bench.
    """
    speed = np.diff(angle) / cycle_s
    moments = moments[1:]
    sign = np.sign(speed)
    inertia = model.values["J"] * _acceleration(speed, cycle_s)
    following = sign * _friction(np.abs(speed), moments, model) + inertia
    starts = np.flatnonzero((sign != 0.0) & (np.diff(sign, prepend=0.0) != 0.0))
    static = _friction(np.zeros(len(starts)), moments[starts], model)
    return float(
        max(np.max(np.abs(following)), np.max(static + np.abs(inertia[starts]), initial=0.0))
    )


def breakaway_speed(stiffness_N_m_rad: float, command_rad_s: float, model: FrictionModel) -> float:
    """Return the greatest speed, rad/s, of an unloaded joint after it has broken away under a drive
    whose torque grows slowly with the position error.

    Relative to the command, the joint is a damped oscillator of inertia, stiffness of the position
    loop and viscous friction, which starts with the speed of the command and is accelerated by the
    difference of static and sliding friction.
    """
    inertia, damping = model.values["J"], model.values["sigma_2"]
    drop = model.values["Ms"] - model.values["Mc"]
    natural = math.sqrt(stiffness_N_m_rad * inertia)
    ratio = min(0.5 * damping / natural, 0.999)
    decay = math.exp(-ratio * math.acos(ratio) / math.sqrt(1.0 - ratio**2))
    return command_rad_s + decay * math.hypot(command_rad_s, max(0.0, drop) / natural)


def _at_speed(speed: float, moments: Array, model: FrictionModel) -> float:
    """Return the friction at one speed under the greatest of the contact moments, N m."""
    return float(_friction(np.full(1, speed), np.max(moments, keepdims=True), model)[0])


def _friction(speed: Array, moments: Array, model: FrictionModel) -> Array:
    """Return system friction and working load (eq. 9, 13) at speeds >= 0, N m."""
    # The sign function in eq. 9 and 12 is 0 at rest; therefore the smallest speed replaces zero.
    speed = np.maximum(speed, np.finfo(np.float64).tiny)
    return np.asarray(
        system_friction(speed, model.values, model.alpha)
        + moments * load_coefficient(speed, model.values, model.alpha)
    )


def _acceleration(speed: Array, cycle_s: float) -> Array:
    """Return the mean slope of commanded speeds over :data:`LOOP_S`, rad/s^2, shape (n,)."""
    half = max(1, round(0.5 * LOOP_S / cycle_s))
    held = np.concatenate([np.zeros(half), speed, np.zeros(half)])
    return np.asarray((held[2 * half :] - held[: -2 * half]) / (2 * half * cycle_s))
