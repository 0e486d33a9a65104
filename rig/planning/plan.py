"""Plans a run from bench and sequence: computes all targets and checks all limits in advance."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.interfaces import ServoLimits
from rig.common.errors import InputError
from rig.common.tables import table
from rig.config.bench import NOT_REPORTED, Bench
from rig.config.configuration import Document
from rig.config.sequence import Array, FirstPass, Sequence, SequenceLimits, StageSection, excitation
from rig.planning.feedforward import Feedforward, Offsets, require_torque_offset, stage_offsets
from rig.planning.first_pass import PlannedPass, plan_passes
from rig.planning.hot_fire import FlowPlan, expected_force, gas_limits, hot_objections, plan_flow
from rig.planning.limits import Limits
from rig.runs.run_record import Load, Role, StageRecord

APPROACH_SPEED_SHARE = 0.25
"""Speed of the move to the start of a stage, as a share of the speed limit."""
HOLD_S = 0.1  # rest at the last target before the drive is de-energised, s
_LIMIT_NAMES = tuple(SequenceLimits.model_fields)
_LOWER_BOUNDS = frozenset({"angle_min_deg", "supply_min_V"})
TIME_LIMIT_SHARE = 1.5
"""Default ratio of the time limit of a stage to its planned time with power on."""


@dataclass(frozen=True)
class PlannedStage:
    """One stage, ready to run. ``targets`` are joint angles in rad, one per cycle, shape (n,).

    ``first_passes`` are run before the stage, in order, until one of them has moved the joint.
    ``offsets`` are torques that the drive adds during the excitation, or None. With a ``flow`` a
    controller moves the valve, and ``targets`` are the expected angles. ``contact_force_N`` is the
    greatest contact force.
    """

    name: str
    stage: Load
    weight_kg: float
    contact_force_N: float
    targets: Array
    repeats: int
    settle_s: float
    duration_s: float
    peak_speed_rad_s: float
    peak_angle_rad: float
    time_limit_s: float
    first_passes: tuple[PlannedPass, ...] = ()
    offsets: Offsets | None = None
    flow: FlowPlan | None = None
    role: Role = "fit"


@dataclass(frozen=True)
class Plan:
    """A whole run, ready to start, with the bench's limits as tightened by the sequence."""

    name: str
    stages: tuple[PlannedStage, ...]
    limits: Limits
    servo_limits: ServoLimits
    approach_speed: float
    cycle_ns: int
    feedforward: Feedforward | None = None

    @property
    def cycle_s(self) -> float:
        """Control cycle, s."""
        return self.cycle_ns * 1e-9

    @property
    def duration_s(self) -> float:
        """Duration of motion and rest, without moves to the start, s."""
        return sum(_under_power_s(s) for s in self.stages)

    @property
    def cycles(self) -> float:
        """Number of control cycles, with an allowance for the moves to the start."""
        return TIME_LIMIT_SHARE * self.duration_s / self.cycle_s


def _under_power_s(stage: PlannedStage, passes: int = 1) -> float:
    before = sum(first.duration_s + stage.settle_s for first in stage.first_passes[:passes])
    return before + stage.repeats * (stage.duration_s + stage.settle_s) + HOLD_S


def make_plan(
    sequence: Document[Sequence],
    bench: Document[Bench],
    first_pass: bool | None = None,
    feedforward: Feedforward | None = None,
) -> Plan:
    """Return the plan of a run: all targets, checked against the limits of the bench."""
    if feedforward is not None:
        require_torque_offset(bench)
    values, problems = _tighten(sequence, bench.value)
    limits = _limits(values, bench.value)
    stages = []
    low = _first_pass(sequence.value, bench.value, first_pass)
    for index, section in enumerate(sequence.value.stages):
        stage = _plan_stage(section, bench.value, limits, low)
        # The feed-forward does not know the load of a hot firing.
        if feedforward is not None and len(stage.targets) and section.stage != "hot_fire":
            offsets = stage_offsets(
                feedforward,
                stage.targets,
                stage.weight_kg,
                bench.value.cycle_s,
                limits.torque,
                limits.speed,
            )
            stage = dataclasses.replace(stage, offsets=offsets)
        stages.append(stage)
        problems.extend(
            sequence.problem(("stages", index, *key), text, value)
            for key, text, value in _objections(section, stage, limits, bench.value)
        )
    if problems:
        raise InputError(problems)
    return Plan(
        name=sequence.value.name,
        stages=tuple(stages),
        limits=limits,
        servo_limits=servo_limits(limits, bench.value),
        approach_speed=APPROACH_SPEED_SHARE * limits.speed,
        cycle_ns=bench.value.cycle_ns,
        feedforward=feedforward,
    )


def with_mass(plan: Plan, stage: PlannedStage, weight_kg: float) -> PlannedStage:
    """Return a stage with the contact force and feed-forward of the confirmed mass, kg."""
    if weight_kg == stage.weight_kg:
        return stage
    force = stage.contact_force_N * (weight_kg / stage.weight_kg if stage.weight_kg else 1.0)
    stage = dataclasses.replace(stage, weight_kg=weight_kg, contact_force_N=force)
    if stage.offsets is None or plan.feedforward is None:
        return stage
    limits = plan.limits
    offsets = stage_offsets(
        plan.feedforward, stage.targets, weight_kg, plan.cycle_s, limits.torque, limits.speed
    )
    return dataclasses.replace(stage, offsets=offsets)


def bench_limits(bench: Bench) -> Limits:
    """Return the limits of the bench file in SI units."""
    return _limits({name: getattr(bench.limits, name) for name in _LIMIT_NAMES}, bench)


def _first_pass(sequence: Sequence, bench: Bench, asked: bool | None) -> FirstPass | None:
    """Return the settings of the first passes, or None if the run has no first passes."""
    stated = sequence.first_pass
    described = stated if isinstance(stated, FirstPass) else None
    wanted = (
        asked
        if asked is not None
        else described is not None or (stated == "auto" and not bench.simulated)
    )
    return (described or FirstPass()) if wanted else None


def _plan_stage(
    section: StageSection, bench: Bench, limits: Limits, low: FirstPass | None
) -> PlannedStage:
    flow = plan_flow(section, bench, limits.speed)
    targets = excitation(section, bench.cycle_s) if flow is None else flow.angles
    steps = np.diff(targets)
    stage = PlannedStage(
        name=section.name,
        stage=section.stage,
        weight_kg=section.weight_kg,
        contact_force_N=expected_force(targets, bench)
        if section.stage == "hot_fire"
        else bench.machine.lever_ratio * section.weight_kg * bench.machine.gravity_m_s2,
        targets=targets,
        repeats=section.repeats,
        settle_s=section.settle_s,
        duration_s=len(targets) * bench.cycle_s,
        peak_speed_rad_s=min(
            float(np.max(np.abs(steps), initial=0.0)), math.inf if flow is None else flow.law.step
        )
        / bench.cycle_s,
        peak_angle_rad=float(targets[np.argmax(np.abs(targets))]) if len(targets) else 0.0,
        time_limit_s=0.0,
        # A hot firing measures its load; its friction does not depend on a weight.
        first_passes=()
        if low is None or section.stage == "hot_fire"
        else plan_passes(section, low, limits, bench.cycle_s),
        flow=flow,
        role=section.role,
    )
    across_s = (
        0.5
        * math.pi
        * (limits.angle_max - limits.angle_min)
        / (APPROACH_SPEED_SHARE * limits.speed)
    )
    passes = len(stage.first_passes)
    moves_s = across_s * (stage.repeats + passes)
    longest_s = section.time_limit_s or TIME_LIMIT_SHARE * (_under_power_s(stage, passes) + moves_s)
    return dataclasses.replace(stage, time_limit_s=longest_s)


_Objection = tuple[tuple[str | int, ...], str, object]


def _objections(
    section: StageSection, stage: PlannedStage, limits: Limits, bench: Bench
) -> Iterator[_Objection]:
    """Yield key, message and value for each quantity of a stage that exceeds a limit."""
    if len(stage.targets) < 2:
        yield (
            ("duration_s",),
            f"shorter than two control cycles of {bench.cycle_s * 1e3:g} ms",
            section.duration_s,
        )
        return
    yield from hot_objections(section, stage.targets, bench)
    if section.time_limit_s is not None and section.time_limit_s < _under_power_s(stage):
        text = f"below the {_under_power_s(stage):.4g} s that this stage takes; raise the limit"
        yield ("time_limit_s",), text, section.time_limit_s
    if section.weight_kg > bench.limits.weight_kg:
        text = f"above the bench limit weight_kg {bench.limits.weight_kg:g} kg; use less weight"
        yield ("weight_kg",), text, section.weight_kg
    if section.stage != "hot_fire" and stage.contact_force_N > bench.limits.contact_force_N:
        yield (
            ("weight_kg",),
            f"contact force {stage.contact_force_N:.0f} N is above the bench limit contact_force_N "
            f"{bench.limits.contact_force_N:g} N; use less weight",
            section.weight_kg,
        )
    yield from _motion_objections(section, stage, limits)
    if (
        stage.offsets is not None
        and (peak := float(np.max(np.abs(stage.offsets.torque)))) > limits.torque
    ):
        text = (
            f"feed-forward needs {peak:.4g} N m, above the limit torque_N_m "
            f"{limits.torque:g} N m; use less weight"
        )
        yield ("weight_kg",), text, section.weight_kg
    cycles = section.cycles_per_period
    fastest = bench.cycle_Hz / cycles
    for index, tone in enumerate(section.tones):
        if tone.frequency_Hz > fastest:
            text = (
                f"above {fastest:g} Hz, {cycles} control cycles per period; lower the frequency or "
                "raise cycle_Hz"
            )
            yield ("tones", index, "frequency_Hz"), text, tone.frequency_Hz


def _motion_objections(
    section: StageSection, stage: PlannedStage, limits: Limits
) -> Iterator[_Objection]:
    """Yield key, message and value if targets exceed the angle range or the speed limit."""
    way: tuple[str, ...] = ("tones",)
    pace: tuple[str, ...] = ("tones",)
    slower = "reduce amplitude or frequency, or lengthen the ramps"
    if section.ramp is not None:
        way, pace, slower = ("ramp", "travel_deg"), ("ramp", "speed_deg_s"), "reduce it"
    elif section.flow is not None:
        way = ("flow", "steps")
    for extreme in (float(stage.targets.min()), float(stage.targets.max())):
        if not limits.angle_min <= extreme <= limits.angle_max:
            yield (
                way,
                f"the joint would go to {math.degrees(extreme):.4g} deg, outside "
                f"{math.degrees(limits.angle_min):.4g} to {math.degrees(limits.angle_max):.4g} "
                "deg; reduce amplitude or travel, or move center_deg",
                math.degrees(extreme),
            )
    if section.flow is not None:
        for key in ("angle_min_deg", "angle_max_deg"):
            angle: float = getattr(section.flow.controller, key)
            if not limits.angle_min <= math.radians(angle) <= limits.angle_max:
                text = (
                    "the controller may command this angle, outside "
                    f"{math.degrees(limits.angle_min):.4g} to "
                    f"{math.degrees(limits.angle_max):.4g} deg; set it within the limits"
                )
                yield ("flow", "controller", key), text, angle
    if stage.peak_speed_rad_s > limits.speed:
        yield (
            pace,
            f"peak speed {math.degrees(stage.peak_speed_rad_s):.4g} deg/s is above the limit "
            f"{math.degrees(limits.speed):.4g} deg/s; {slower}",
            math.degrees(stage.peak_speed_rad_s),
        )


def _tighten(sequence: Document[Sequence], bench: Bench) -> tuple[dict[str, float], list[str]]:
    """Merge the limits of the sequence into those of the bench; collect errors on wider limits."""
    values: dict[str, float] = {}
    problems: list[str] = []
    for name in _LIMIT_NAMES:
        allowed: float = getattr(bench.limits, name)
        asked: float | None = getattr(sequence.value.limits, name)
        values[name] = allowed if asked is None else asked
        if asked is not None and (asked < allowed if name in _LOWER_BOUNDS else asked > allowed):
            text = f"wider than the bench's limit {allowed:g}; a sequence may only tighten a limit"
            problems.append(sequence.problem(("limits", name), text, asked))
        elif asked is not None and name in bench.unreported:
            problems.append(sequence.problem(("limits", name), NOT_REPORTED, asked))
    for what, unit in (("angle", "deg"), ("supply", "V")):
        least, most = f"{what}_min_{unit}", f"{what}_max_{unit}"
        if values[least] >= values[most]:
            text = (
                f"{what} range {values[least]:g} to {values[most]:g} {unit} is empty; {least} must "
                f"be below {most}"
            )
            problems.append(sequence.problem(("limits",), text))
    return values, problems


def _limits(values: dict[str, float], bench: Bench) -> Limits:
    unreported = bench.unreported
    return Limits(
        angle_min=math.radians(values["angle_min_deg"]),
        angle_max=math.radians(values["angle_max_deg"]),
        speed=math.radians(values["speed_deg_s"]),
        torque=values["torque_N_m"],
        current=values["current_A"],
        following_error=math.radians(values["following_error_deg"]),
        encoder_disagreement=math.radians(values["encoder_disagreement_deg"]),
        temperature=math.inf if "temperature_C" in unreported else values["temperature_C"],
        supply_min=-math.inf if "supply_min_V" in unreported else values["supply_min_V"],
        supply_max=math.inf if "supply_max_V" in unreported else values["supply_max_V"],
        sample_age=values["sample_age_ms"] * 1e-3,
        lateness=values["lateness_ms"] * 1e-3,
        torque_per_ampere=bench.machine.torque_constant_N_m_A * bench.machine.gear_ratio,
        gear_ratio=bench.machine.gear_ratio,
        gas=gas_limits(bench),
    )


def servo_limits(limits: Limits, bench: Bench) -> ServoLimits:
    """Return the limits to be written into the drive."""
    return ServoLimits(
        angle_min_rad=limits.angle_min,
        angle_max_rad=limits.angle_max,
        speed_rad_s=limits.speed,
        torque_N_m=limits.torque,
        current_A=limits.current,
        following_error_rad=limits.following_error,
        quick_stop_option=bench.servo.quick_stop_option,
        quick_stop_deceleration_rad_s2=math.radians(bench.servo.quick_stop_deceleration_deg_s2),
    )


def stage_records(plan: Plan) -> list[StageRecord]:
    """Return the records of a plan's stages before the run."""
    return [
        StageRecord(s.name, s.stage, s.weight_kg, s.repeats, len(s.targets), role=s.role)
        for s in plan.stages
    ]


def describe(plan: Plan) -> str:
    """Return the plan as text, with tables of the stages and of the limits that apply."""
    stages = table(
        [
            "stage",
            "load",
            "repeats",
            "duration s",
            "weight kg",
            "force N",
            "peak deg/s",
            "peak deg",
        ],
        [
            [
                s.name,
                s.stage,
                str(s.repeats),
                f"{s.duration_s:g}",
                f"{s.weight_kg:g}",
                f"{s.contact_force_N:.1f}",
                f"{math.degrees(s.peak_speed_rad_s):.2f}",
                f"{math.degrees(s.peak_angle_rad):+z.2f}",
            ]
            for s in plan.stages
        ],
        right=range(2, 8),
    )
    limits, gas = plan.limits, list[list[str]]()
    if limits.gas is not None:
        gas.append(["chamber pressure", f"{limits.gas.pressure * 1e-6:g}", "MPa"])
        gas.append(["contact force", f"{limits.gas.contact_force:g}", "N"])
    low, high = (f"{math.degrees(angle):g}" for angle in (limits.angle_min, limits.angle_max))
    held = table(
        ["limit", "value", "unit"],
        [
            ["joint angle", f"{low} to {high}", "deg"],
            ["joint speed", f"{math.degrees(limits.speed):g}", "deg/s"],
            ["joint torque", f"{limits.torque:g}", "N m"],
            ["motor current", f"{limits.current:g}", "A"],
            ["following error", f"{math.degrees(limits.following_error):g}", "deg"],
            ["encoder against drive", f"{math.degrees(limits.encoder_disagreement):g}", "deg"],
            ["motor temperature", _stated(f"{limits.temperature:g}"), "deg C"],
            ["DC link", _stated(f"{limits.supply_min:g} to {limits.supply_max:g}"), "V"],
            *gas,
            ["sample age", f"{limits.sample_age * 1e3:g}", "ms"],
            ["lateness of a cycle", f"{limits.lateness * 1e3:g}", "ms"],
        ],
    )
    head = (
        f"{plan.name}: {plan.duration_s:.1f} s at {1.0 / plan.cycle_s:g} Hz, and moves to the start"
    )
    passes = "\n".join(
        line
        for stage in plan.stages
        for line in (_plan_text_first_pass(stage), *_feedforward(stage))
    )
    return f"{head}\n\n{stages}\n\n{passes}\n\n{held}"


def _stated(value: str) -> str:
    return "not reported" if "inf" in value else value


def _feedforward(stage: PlannedStage) -> list[str]:
    if stage.offsets is None:
        return []
    peak, damping = max(abs(stage.offsets.torque)), max(stage.offsets.damping)
    held = (
        f"stiffness {max(stage.offsets.stiffness):.4g} N m/rad up to {stage.offsets.reach:.3g} N m"
    )
    return [
        f"{stage.name}: feed-forward up to {peak:.3g} N m, damping {damping:.3g} N m s/rad, {held}"
    ]


def _plan_text_first_pass(stage: PlannedStage) -> str:
    bound = f"at most {stage.time_limit_s:.1f} s under power"
    if stage.stage == "hot_fire":
        return f"{stage.name}: {bound}; the gas generator loads the valve, no weight is hung"
    if not stage.first_passes:
        return (
            f"{stage.name}: {bound}; no first pass at low amplitude, so the weight is not "
            f"checked before the stage"
        )
    low, *larger = stage.first_passes
    limits = low.limits
    again = (
        f" (at {', '.join(f'{p.amplitude:.0%}' for p in larger)} while the joint does not move)"
        if larger
        else ""
    )
    return (
        f"{stage.name}: {bound}; first {low.duration_s:.1f} s at {low.amplitude:.0%} "
        f"amplitude{again} within {math.degrees(limits.angle_min):z.1f} to "
        f"{math.degrees(limits.angle_max):z.1f} deg, {math.degrees(limits.speed):.3g} deg/s, "
        f"{limits.torque:.3g} N m, then the weight is checked"
    )
