"""Experiments that an investigation may run: their stages, their cost, and their simulation under a
model of the bench, within all limits of the bench.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import Samples, record
from identification.effects.model import CorrectedModel
from identification.model.parameters import LOAD_PARAMETERS, NOMINAL
from identification.recording import Bench as Constants
from identification.recording import Recording
from identification.views.nominal import SPEEDS
from rig.common.errors import InputError
from rig.common.yaml_tree import parse
from rig.config.bench import Bench, redacted
from rig.config.canopen import ServoSection
from rig.config.configuration import Document, located_text
from rig.config.sequence import (
    Ramp,
    StageSection,
    Tone,
    approach,
    sequence_text,
)
from rig.config.sequence import (
    Sequence as Stages,
)
from rig.config.simulated_machine import derived
from rig.planning.limits import Limits
from rig.planning.plan import HOLD_S, Plan, PlannedStage, make_plan
from rig.planning.predicted_load import FrictionModel, PredictedLoad, moves_to_start
from rig.planning.reference import moment_per_kg
from rig.results.diagnose.model_bench import model_bench
from rig.runs.run import AVERAGED, bench_constants
from rig.runs.run_record import StageRecord

HANG_S, CONFIRM_S, START_S = 60.0, 10.0, 30.0
"""Bench time of a changed weight (the assumption of ``rig run --dry-run`` for a prompt), of a
prompt whose weight already hangs, and of the start of a run with its checks, s.
"""
SHARE = 0.85
"""Share of a limit of angle, speed, current and torque that a simulated experiment may
reach under any hypothesis; that of the planned experiments of ``rig identify --plan``.
"""
FOLLOWING_SHARE = 0.5
"""Share of the limit of the following error, which depends on the drive's loops most."""
TRAVEL_SHARE = 0.8
"""Share of the travel that an experiment uses."""
HEAVY, LIGHT = 0.75, 0.25
"""Weights of an experiment as shares of the heaviest permitted weight, unless the bench file lists
the weights that can be hung.
"""
SLOW, CREEP, MEDIUM, FAST = 0.08, 0.02, 0.2, 0.5
"""Peak speeds as shares of the speed limit."""
LONGEST_S, SHORTEST_S = 40.0, 8.0
SPREAD = 0.1
"""Standard deviation of the logarithm of the factor on amplitudes and speeds: an experiment that is
chosen again is not the same experiment.
"""
OFF_S = 1.0
"""Time without power before a stage in a simulation, s."""
WORK_S = 100.0
"""Duration of the work that warms the machine between two equal stages, s."""


class Part(NamedTuple):
    """A part of an experiment: one stage, or several that belong together.

    Attributes:
        name: Name of the part.
        stages: The stages; their names begin with that of the part.
    """

    name: str
    stages: tuple[StageSection, ...]

    @property
    def weight_kg(self) -> float:
        """Mass on the lever in the first stage."""
        return self.stages[0].weight_kg


def weights(bench: Bench) -> tuple[float, ...]:
    """Return the masses that may be hung, kg, ascending: at most two."""
    per_kg = bench.machine.lever_ratio * bench.machine.gravity_m_s2
    most = min(bench.limits.weight_kg, bench.limits.contact_force_N / per_kg)
    heaviest = SHARE * most
    offered = sorted(w for w in bench.weights_kg if w <= most * (1.0 + 1e-12))
    if not bench.weights_kg:
        offered = [float(f"{share * heaviest:.2g}") for share in (LIGHT, HEAVY)]
    offered = [w for w in offered if w > 0.0]
    return tuple(dict.fromkeys((offered[0], offered[-1]))) if offered else ()


def family(bench: Bench, rng: np.random.Generator, sessions: bool = False) -> list[Part]:
    """Return the parts of which experiments are composed, within the limits of angle and speed.

    Slow, medium and fast sines over large and small travel, two tones, creeping ramps over the
    travel, steady speeds, loops below breakaway, breakaways after several rests; without load, and
    with each weight. With ``sessions``, further parts repeat a slow and a fast stage after work,
    for effects that change as the machine runs.
    """
    limits = bench.limits
    half = 0.5 * TRAVEL_SHARE * (limits.angle_max_deg - limits.angle_min_deg)
    middle = 0.5 * (limits.angle_max_deg + limits.angle_min_deg)
    top = limits.speed_deg_s

    def about(value: float) -> float:
        return float(f"{value * math.exp(SPREAD * rng.standard_normal()):.4g}")

    def sine(share: float, speed: float, periods: float = 3.0, **more: Any) -> dict[str, Any]:
        amplitude = min(about(share * half), half)
        frequency = min(
            about(speed * top / (2.0 * math.pi * amplitude)), 0.5 * bench.cycle_Hz / 20.0
        )
        duration = min(max(periods / frequency, SHORTEST_S), LONGEST_S)
        tone = Tone(amplitude_deg=amplitude, frequency_Hz=frequency)
        return {"tones": (tone,), "duration_s": round(duration, 2), "center_deg": middle, **more}

    def ramp(speed: float, times: int, share: float = 0.9) -> dict[str, Any]:
        pace = about(speed * top)
        reach = round(min(share * half, 0.25 * LONGEST_S * pace / times), 3)
        found = Ramp(travel_deg=2.0 * reach, speed_deg_s=pace, rest_s=0.2, times=times)
        start = middle - reach
        seconds = math.ceil(100.0 * found.moving_s + 10.0) / 100.0
        return {"ramp": found, "duration_s": seconds, "center_deg": start}

    def tones() -> dict[str, Any]:
        slow, quick = sine(0.55, SLOW), sine(0.12, MEDIUM)
        pair = (*slow["tones"], *quick["tones"])
        return {"tones": pair, "duration_s": 20.0, "center_deg": middle}

    motions: dict[str, list[dict[str, Any]]] = {
        "wide-slow": [sine(1.0, SLOW, 2.0)],
        "wide-fast": [sine(1.0, FAST, 5.0)],
        "medium": [sine(0.5, MEDIUM, 4.0)],
        "small-fast": [sine(0.1, FAST, 12.0)],
        "tones": [tones()],
        "creep": [ramp(CREEP, 2, 0.45)],
        "speeds": [ramp(s, n) for s, n in ((0.05, 1), (0.15, 2), (0.4, 3))],
        "rests": [
            {**sine(0.12, 0.05, 1.0), "duration_s": 4.0, "settle_s": rest, "repeats": 4}
            for rest in (0.2, 1.0, 4.0)
        ],
        "loops": [sine(share, share, 4.0) for share in (0.003, 0.02)],
        "ends": [sine(0.25, SLOW, 3.0, center_deg=middle + s * 0.7 * half) for s in (-1.0, 1.0)],
    }
    work = {**sine(1.0, FAST), "duration_s": WORK_S}
    slow, quick = sine(0.8, SLOW, 2.0), sine(0.8, FAST, 5.0)
    parts = []
    for mass in (0.0, *weights(bench)):
        load = f"{mass:g}kg" if mass else "unloaded"
        session = {"session": [slow, quick, work, slow, quick]} if sessions else {}
        for name, each in (motions | session).items():
            if name == "loops" and mass:
                continue
            parts.append(Part(f"{name}-{load}", tuple(_stages(f"{name}-{load}", each, mass))))
    return parts


def _stages(name: str, motions: Sequence[dict[str, Any]], mass: float) -> Iterator[StageSection]:
    for k, motion in enumerate(motions, 1):
        yield StageSection(
            name=name if len(motions) == 1 else f"{name}-{k}",
            stage="loaded" if mass else "unloaded",
            weight_kg=mass,
            **{"settle_s": 0.5, **motion},
        )


def in_order(parts: Sequence[Part]) -> list[Part]:
    """Return parts sorted by weight, so that each weight is hung once; order is kept otherwise."""
    return sorted(parts, key=lambda part: part.weight_kg)


def as_document(name: str, parts: Sequence[Part]) -> Document[Stages]:
    """Return an experiment as a sequence, as read from its file."""
    stages = tuple(stage for part in in_order(parts) for stage in part.stages)
    text = sequence_text(Stages(sequence=1, name=name, stages=stages))
    return located_text(Path(f"{name}.yaml"), text, Stages)


def weight_changes(stages: Sequence[StageSection | PlannedStage | StageRecord]) -> int:
    """Return how often a weight is hung or taken off, from the empty lever on."""
    masses = [0.0, *(stage.weight_kg for stage in stages)]
    return sum(a != b for a, b in pairwise(masses))


def bench_seconds(plan: Plan) -> float:
    """Return the time of bench and operator for a run, up to the empty lever of the next one, s."""
    moves = sum(len(m) for stage in plan.stages for m in moves_to_start(stage, plan))
    changes = weight_changes(plan.stages)
    off = plan.stages[-1].weight_kg > 0.0
    hands = HANG_S * (changes + off) + CONFIRM_S * (len(plan.stages) - changes)
    return START_S + hands + plan.duration_s + moves * plan.cycle_s


# Simulation under a hypothesis.


class Simulated(NamedTuple):
    """Recordings of an experiment that was simulated, and the limit that it comes too near to;
    empty if none.
    """

    recordings: tuple[Recording, ...]
    problem: str


@dataclass(frozen=True)
class SimulatedBench:
    """The bench as it is believed to be, on which models are simulated.

    Attributes:
        document: The bench.
        base: Data of the bench file without the true values of a simulated machine.
        constants: Constants of the machine by the bench file.
    """

    document: Document[Bench]
    base: Mapping[str, Any]
    constants: Constants

    @classmethod
    def of(cls, document: Document[Bench]) -> SimulatedBench:
        """Return the bench; drive loops that the file does not state follow from its other values,
        as for any simulated bench.
        """
        tree, _ = parse(redacted(document.path.read_bytes()).decode("utf-8"))
        plain: Any = tree.plain()
        stated = plain.get("mock") or {}
        mock = {
            name: {**value, **stated.get(name, {})}
            if isinstance(value, dict)
            else stated.get(name, value)
            for name, value in derived(plain).items()
        }
        base = {**plain, "mock": {**stated, **mock}}
        return cls(document, base, bench_constants(document.value))

    def machine(self, model: CorrectedModel) -> Machine:
        """Return the machine of a model, without noise.

        Raises:
            InputError: The machine cannot represent an effect of the model.
        """
        # Friction that does not fall has no Stribeck speed, and a fit that misses physics may leave
        # no inertia; the machine needs both.
        needed = {*SPEEDS, "J"}
        values = {n: v or NOMINAL[n] if n in needed else v for n, v in model.parameters.items()}
        model = dataclasses.replace(model, parameters=values)
        tree, notes = model_bench(self.base, model, self.constants)
        if missing := [name for name in model.effects if name not in tree["mock"]["effects"]]:
            raise InputError(f"{', '.join(missing)} cannot be simulated: {'; '.join(notes)}")
        try:
            machine = Bench.model_validate_json(json.dumps(tree), strict=True).mock
        except ValueError as error:
            raise InputError(f"the model cannot be simulated: {error}") from error
        assert machine is not None
        return dataclasses.replace(
            machine, sensing=dataclasses.replace(machine.sensing, current_noise_A=0.0)
        )

    def machines(self, models: Sequence[CorrectedModel]) -> dict[int, Machine]:
        """Return the machines of models by their place, without those that cannot be simulated."""
        found: dict[int, Machine] = {}
        for k, model in enumerate(models):
            with suppress(InputError):  # an effect that the simulated machine cannot have
                found[k] = self.machine(model)
        return found

    @staticmethod
    def knows_load(model: CorrectedModel) -> bool:
        """Whether the friction under a load was identified."""
        return "mu_c" in model.parameters

    def loaded(self, model: CorrectedModel) -> CorrectedModel:
        """Return a model with the paper's friction under a load, if its own is not known."""
        if self.knows_load(model):
            return model
        known = {n: NOMINAL[n] for n in LOAD_PARAMETERS if n in NOMINAL}
        return dataclasses.replace(model, parameters={**known, **model.parameters})

    def plan(self, sequence: Document[Stages], models: Sequence[CorrectedModel]) -> Plan:
        """Return the plan of an experiment.

        Raises:
            InputError: The plan, or its predicted peak in a stage or a first pass under one of the
                models, exceeds a limit of the bench.
        """
        plan = make_plan(sequence, self.document)
        per_kg = moment_per_kg(self.constants)
        for model in models:
            values = {**NOMINAL, **model.parameters}
            arm = self.constants.moment_arm or 0.0
            friction = FrictionModel(values, model.alpha, arm, per_kg, "a hypothesis", True)
            PredictedLoad.of(plan, self.document.value, friction).require_within(sequence)
        return plan

    def simulate(self, plan: Plan, machine: Machine, seed: int | None = None) -> Simulated:
        """Simulate an experiment on a machine that is cold at its beginning, on one clock.

        Args:
            plan: The experiment.
            machine: The machine.
            seed: Seed of the current noise, or None for none.
        """
        plant = SimulatedMachine(machine, np.random.default_rng(seed or 0))
        found: list[Recording] = []
        squares, samples, problem, clock_s = 0.0, 0, "", 0.0
        for stage in plan.stages:
            plant.power(False)
            plant.hang(stage.weight_kg)
            plant.rest(OFF_S)
            clock_s += OFF_S
            plant.power(True)
            here = plant.truth().angle_rad
            for repeat in range(stage.repeats):
                move = approach(here, float(stage.targets[0]), plan.approach_speed, plan.cycle_s)
                rest = np.full(round(stage.settle_s / plan.cycle_s), stage.targets[0])
                hold = np.full(round(HOLD_S / plan.cycle_s), stage.targets[-1])
                command = np.concatenate([move, rest, stage.targets, hold])
                got = record(plant, command, plan.cycle_s)
                problem = problem or _near_limit(got, plan.limits)
                squares, samples = (
                    squares + float(got.current @ got.current),
                    samples + len(command),
                )
                first = len(move) + len(rest)
                cut = slice(first, first + len(stage.targets))
                got = got._replace(time=got.time + clock_s)
                clock_s += len(command) * plan.cycle_s
                found.append(_recording(stage, repeat, got, cut, self.constants))
                here = float(stage.targets[-1])
        servo = self.document.value.servo
        if isinstance(servo, ServoSection) and not problem:
            rms, rated = math.sqrt(squares / samples), servo.rated_current_A
            if rms > SHARE * rated:
                problem = f"rms current {rms:.3g} A, {SHARE:.0%} of the rated {rated:g} A allowed"
        return Simulated(tuple(found), problem)


def _near_limit(got: Samples, limits: Limits) -> str:
    """Return the first limit that simulated samples come too near to; empty if none."""
    slack = 0.5 * (1.0 - SHARE) * (limits.angle_max - limits.angle_min)
    gear = got.motor_angle / limits.gear_ratio
    peaks = (
        ("joint angle", float(np.max(got.angle)), limits.angle_max - slack),
        ("joint angle", -float(np.min(got.angle)), slack - limits.angle_min),
        ("joint speed", _peak(got.velocity), SHARE * limits.speed),
        ("current", _peak(got.current), SHARE * limits.current),
        ("torque", _peak(got.current) * limits.torque_per_ampere, SHARE * limits.torque),
        (
            "following error",
            _peak(got.command - got.angle),
            FOLLOWING_SHARE * limits.following_error,
        ),
        ("encoder against drive", _peak(gear - got.angle), SHARE * limits.encoder_disagreement),
        ("supply", -float(np.min(got.supply_voltage)), -limits.supply_min),
        ("supply", float(np.max(got.supply_voltage)), limits.supply_max),
        ("temperature", float(np.max(got.temperature)), limits.temperature),
    )
    for name, value, most in peaks:
        if not value <= most:
            return f"{name} {value:.3g}, at most {most:.3g} in a simulation"
    return ""


def _peak(values: np.ndarray) -> float:
    return float(np.max(np.abs(values)))


def _recording(
    stage: PlannedStage, repeat: int, got: Samples, cut: slice, bench: Constants
) -> Recording:
    channels = {
        name: np.ascontiguousarray(getattr(got, name)[cut])
        for name in Samples._fields
        if name != "pressure"
    }
    return Recording(
        name=f"{stage.name}[{repeat + 1}]",
        channels=channels,
        bench=bench,
        stage="loaded" if stage.weight_kg else "unloaded",
        weight_mass=stage.weight_kg,
        averaged=AVERAGED,
    )
