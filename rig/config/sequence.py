"""Schema of the sequence file: stages with their excitations, and the commanded joint angles."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from rig.config.acceptance import LimitLine
from rig.config.configuration import Document, NonNegative, Positive, Schema, load_located, resolve

Array = NDArray[np.float64]
SAMPLES_PER_PERIOD = 20  # least number of control cycles per period of a tone, for a smooth sine


class FlowStep(Schema):
    """A gas flow that is commanded from a stated time on.

    Attributes:
        at_s: Time since the start of the excitation; the first step is at 0.
        flow_kg_s: Commanded mass flow.
    """

    at_s: NonNegative
    flow_kg_s: Positive


class FlowController(Schema):
    """PI controller of the logarithm of the ratio of measured to desired pressure (Fig. 5, 11). The
    default gains are assumptions, because the paper gives no gains.

    The commanded valve angle stays within the range, and its rate within the speed limit; while one
    of these limits acts, the integral part does not change.

    Attributes:
        gain_deg: Valve angle per unit of the logarithm; a pressure deviation of one percent is
            about 0.01 units.
        integral_1_s: Inverse reset time.
        filter_Hz: Cut-off of the low-pass on the measured pressure.
        angle_min_deg: Lowest valve angle.
        angle_max_deg: Highest valve angle.
        speed_deg_s: Highest valve speed.
    """

    gain_deg: Positive = 8.0
    integral_1_s: NonNegative = 8.0
    filter_Hz: Positive = 10.0
    angle_min_deg: float = 0.0
    angle_max_deg: float = 30.0
    speed_deg_s: Positive = 50.0

    @model_validator(mode="after")
    def _range_is_open(self) -> Self:
        if not self.angle_min_deg < self.angle_max_deg:
            raise ValueError(
                f"angle_min_deg {self.angle_min_deg:g} must be below angle_max_deg "
                f"{self.angle_max_deg:g}; exchange the two values"
            )
        return self


class FlowSection(Schema):
    """A flow command over time.

    Attributes:
        steps: Flow steps, in order.
        ramp_s: Time that each step takes.
        controller: The pressure controller.
    """

    steps: Annotated[tuple[FlowStep, ...], Field(min_length=1)]
    ramp_s: NonNegative = 0.2
    controller: FlowController = FlowController()

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        times = [step.at_s for step in self.steps]
        if times[0] != 0.0:
            raise ValueError(
                f"the first step must be at 0 s, the start of the excitation (got at_s "
                f"{times[0]:g})"
            )
        for earlier, later in pairwise(times):
            if later <= earlier + self.ramp_s:
                raise ValueError(
                    f"the step at {later:g} s begins before the step at {earlier:g} s ends (ramp_s "
                    f"{self.ramp_s:g}); list the steps in order of time, further apart than ramp_s"
                )
        return self

    def command(self, duration_s: float, cycle_s: float) -> Array:
        """Return the commanded flow in each cycle, kg/s, shape (n,)."""
        t = np.arange(round(duration_s / cycle_s)) * cycle_s
        corners = [(0.0, self.steps[0].flow_kg_s)]
        for before, step in pairwise(self.steps):
            corners += [
                (step.at_s, before.flow_kg_s),
                (step.at_s + max(self.ramp_s, cycle_s), step.flow_kg_s),
            ]
        times, flows = np.array(corners).T
        return np.asarray(np.interp(t, times, flows))


class Tone(Schema):
    """One sine of an excitation: amplitude sin(2 pi frequency t + phase).

    Attributes:
        amplitude_deg: Amplitude at the joint.
        frequency_Hz: Frequency.
        phase_deg: Phase at the start of the excitation.
    """

    amplitude_deg: Positive
    frequency_Hz: Positive
    phase_deg: float = 0.0


class Ramp(Schema):
    """A slow ramp: away from the centre at constant speed, and back.

    Attributes:
        travel_deg: Distance from the centre; the sign is the direction.
        speed_deg_s: Speed out and back.
        rest_s: Commanded rest at the far end. For the remaining time of `duration_s`, the joint
            rests at the centre.
        times: Number of repetitions out and back, without a rest at the centre between them.
    """

    travel_deg: float
    speed_deg_s: Positive
    rest_s: NonNegative = 1.0
    times: Annotated[int, Field(ge=1, le=1000)] = 1

    @property
    def period_s(self) -> float:
        """Time to the far end and back, including the rest at the far end, s."""
        return 2.0 * abs(self.travel_deg) / self.speed_deg_s + self.rest_s

    @property
    def moving_s(self) -> float:
        """Total time of all repetitions, s."""
        return self.times * self.period_s


class StageSection(Schema):
    """One stage: a load condition of the valve, and an excitation of the joint by tones or by one
    ramp.

    In a `hot_fire` stage a gas generator loads the valve, and a flow command may replace the
    excitation: a controller then moves the valve.

    Attributes:
        name: Name of the stage, without spaces and different from all other stages.
        stage: The load condition. `unloaded`: the empty lever; `loaded`: a weight on the lever;
            `hot_fire`: the gas generator.
        weight_kg: Mass on the lever of a loaded stage.
        tones: Sines, which are added.
        ramp: A slow ramp instead of tones.
        flow: A flow command instead of tones, in a hot firing.
        duration_s: Length of the excitation, including fade-in and fade-out of the tones.
        ramp_in_s: Fade-in of the tones.
        ramp_out_s: Fade-out of the tones.
        cycles_per_period: Least number of control cycles per period of a tone. With fewer than 20,
            a drive that moves linearly from target to target receives less than the amplitude, and
            images above half of the cycle frequency.
        repeats: Number of times that the excitation is run; each repeat becomes one recording.
        center_deg: Joint angle at the centre of the excitation.
        settle_s: Rest at the starting angle before each repeat.
        time_limit_s: Longest time with power on in this stage; if left out, computed from the plan.
        role: `validate` excludes the stage's recordings from the fit; the identification scores
            them once at the end.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")]
    stage: Literal["unloaded", "loaded", "hot_fire"]
    weight_kg: NonNegative = 0.0
    tones: tuple[Tone, ...] = ()
    ramp: Ramp | None = None
    flow: FlowSection | None = None
    duration_s: Annotated[float, Field(gt=0, le=3600)]
    ramp_in_s: NonNegative = 1.0
    ramp_out_s: NonNegative = 1.0
    cycles_per_period: Annotated[int, Field(ge=4)] = SAMPLES_PER_PERIOD
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    center_deg: float = 0.0
    settle_s: Annotated[float, Field(ge=0, le=600)] = 0.2
    time_limit_s: Positive | None = None
    role: Literal["fit", "validate"] = "fit"

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if sum((bool(self.tones), self.ramp is not None, self.flow is not None)) != 1:
            raise ValueError("a stage needs exactly one excitation: tones, ramp or flow")
        if self.flow is not None and self.stage != "hot_fire":
            raise ValueError(
                f"a flow command needs a gas generator, but the stage is {self.stage}; use stage: "
                "hot_fire"
            )
        given = self.model_fields_set & {"ramp_in_s", "ramp_out_s"}
        if self.ramp is not None and given:
            raise ValueError(
                f"{' and '.join(sorted(given))} fade tones in and out, and a ramp has no tones: "
                f"leave {'it' if len(given) == 1 else 'them'} out"
            )
        if self.ramp is not None and self.ramp.moving_s > self.duration_s:
            raise ValueError(
                f"the ramp takes {self.ramp.moving_s:g} s, longer than duration_s "
                f"{self.duration_s:g} s; increase duration_s"
            )
        if self.tones and self.ramp_in_s + self.ramp_out_s > self.duration_s:
            raise ValueError(
                f"ramp_in_s + ramp_out_s = {self.ramp_in_s + self.ramp_out_s:g} s is longer than "
                f"duration_s {self.duration_s:g} s; increase duration_s"
            )
        if self.stage == "unloaded" and self.weight_kg != 0:
            raise ValueError(
                f"an unloaded stage has no weight, but weight_kg is {self.weight_kg:g}; remove "
                f"weight_kg or, if a weight hangs on the lever, use stage: loaded"
            )
        if self.stage == "loaded" and self.weight_kg == 0:
            raise ValueError(
                "a loaded stage needs weight_kg above 0; state the mass or, for the empty lever, "
                "use stage: unloaded"
            )
        if self.stage == "hot_fire" and self.weight_kg != 0:
            raise ValueError(
                f"a hot firing is loaded by the gas generator and not by a weight, but weight_kg "
                f"is {self.weight_kg:g}; remove weight_kg"
            )
        return self


class SequenceLimits(Schema):
    """Limits of this sequence; a limit must not be wider than that of the bench.

    Attributes:
        angle_min_deg: Lowest joint angle.
        angle_max_deg: Highest joint angle.
        speed_deg_s: Highest joint speed.
        torque_N_m: Highest torque at the joint.
        current_A: Highest motor current.
        following_error_deg: Largest difference between commanded and measured joint angle.
        encoder_disagreement_deg: Largest difference between joint encoder and motor encoder, at the
            joint.
        temperature_C: Highest temperature of the drive.
        supply_min_V: Lowest supply voltage.
        supply_max_V: Highest supply voltage.
        sample_age_ms: Greatest age of a sample with which a cycle may continue.
        lateness_ms: Greatest delay of the start of a cycle.
    """

    angle_min_deg: float | None = None
    angle_max_deg: float | None = None
    speed_deg_s: Positive | None = None
    torque_N_m: Positive | None = None
    current_A: Positive | None = None
    following_error_deg: Positive | None = None
    encoder_disagreement_deg: Positive | None = None
    temperature_C: float | None = None
    supply_min_V: NonNegative | None = None
    supply_max_V: Positive | None = None
    sample_age_ms: Positive | None = None
    lateness_ms: Positive | None = None


class FirstPass(Schema):
    """A short pass at low amplitude before each stage, under tighter limits.

    If the joint does not move, a pass with twice the amplitude follows, until the joint moves.

    Attributes:
        amplitude: Amplitude of the pass, as a share of the stage's amplitude.
        duration_s: Length of the pass; if left out, one period of the slowest tone, fade-in and
            fade-out.
        limit_share: Share of the speed limit that is allowed in the pass. The shares of the limits
            on torque, current and following error are the mean of this share and one.
    """

    amplitude: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    duration_s: Annotated[float, Field(gt=0, le=600)] | None = None
    limit_share: Annotated[float, Field(gt=0, le=1)] = 0.5


class Sequence(Schema):
    """One sequence, as written in its file.

    Attributes:
        sequence: Version of the file format.
        name: Name of the sequence, without spaces; part of the run folder's name.
        stages: The stages, in the order in which they are run.
        limits: Limits of this sequence.
        first_pass: `auto`: a first pass on a real bench and none on a simulated bench.
        acceptance: Limits that a complete run must meet to be accepted, such as `Mc: 6.5..7.1`,
            `nothing missing`, `weight check passed`, `p99 lateness < 1 ms` or
            `tracking error rms < 0.05 deg`.
    """

    sequence: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")]
    stages: Annotated[tuple[StageSection, ...], Field(min_length=1)]
    limits: SequenceLimits = SequenceLimits()
    first_pass: FirstPass | Literal["auto", "never"] = "auto"
    acceptance: tuple[LimitLine, ...] = ()

    @field_validator("stages")
    @classmethod
    def _names_differ(cls, stages: tuple[StageSection, ...]) -> tuple[StageSection, ...]:
        names = [stage.name for stage in stages]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(
                f"stage names must differ, but {', '.join(repeated)} is used more than once"
            )
        return stages

    @model_validator(mode="after")
    def _something_is_fitted(self) -> Self:
        fitted = [stage.stage != "unloaded" for stage in self.stages if stage.role == "fit"]
        if not fitted:
            raise ValueError("every stage has role validate; set role: fit for one stage")
        aside = [
            stage.name
            for stage in self.stages
            if stage.role == "validate" and stage.stage != "unloaded"
        ]
        if aside and not any(fitted):
            raise ValueError(
                f"{', '.join(aside)} is loaded and has role validate, but no loaded stage has "
                "role fit, so that the working load would be unknown; give a loaded stage role fit"
            )
        return self


class AcceptanceFile(Schema):
    """Limits of acceptance in a separate file.

    Attributes:
        acceptance: Version of the file format.
        limits: The limits, in the order in which they are reported.
    """

    acceptance: Literal[1]
    limits: Annotated[tuple[LimitLine, ...], Field(min_length=1)]


def load_acceptance(path: Path) -> Document[AcceptanceFile]:
    """Read a file of limits; the InputError has every problem with its place."""
    return load_located(path, AcceptanceFile)


def load_sequence(name: str | Path) -> Document[Sequence]:
    """Read a sequence by path or packaged name; the InputError has every problem with its place."""
    return load_located(resolve(name, "sequences"), Sequence)


def sequence_text(sequence: Sequence, head: str = "") -> str:
    """Return a sequence as the text of its file, after the lines ``head``."""
    return head + yaml.safe_dump(plain_sequence(sequence), sort_keys=False, allow_unicode=True)


def plain_sequence(sequence: Sequence) -> dict[str, Any]:
    """Return what a sequence states, as plain data."""
    given: dict[str, Any] = sequence.model_dump(mode="json", exclude_defaults=True)
    return {"sequence": sequence.sequence, **given}


def excitation(stage: StageSection, cycle_s: float) -> Array:
    """Return the commanded angles of one repeat, rad, shape (n,), at k ``cycle_s``."""
    t = np.asarray(np.arange(round(stage.duration_s / cycle_s)) * cycle_s, dtype=np.float64)
    if stage.ramp is not None:
        return math.radians(stage.center_deg) + _there_and_back(stage.ramp, t)
    swing = np.zeros_like(t)
    for tone in stage.tones:
        phase = 2.0 * math.pi * tone.frequency_Hz * t + math.radians(tone.phase_deg)
        swing += math.radians(tone.amplitude_deg) * np.sin(phase)
    rise = raised_cosine(t, stage.ramp_in_s)
    fall = raised_cosine(stage.duration_s - t, stage.ramp_out_s)
    return math.radians(stage.center_deg) + rise * fall * swing


def _there_and_back(ramp: Ramp, t: NDArray[np.floating[Any]]) -> Array:
    """Return the angle from the centre, rad, an array of the shape of ``t``."""
    away_s = abs(ramp.travel_deg) / ramp.speed_deg_s
    begun = np.minimum(np.floor(t / ramp.period_s), ramp.times - 1) if ramp.period_s > 0.0 else 0.0
    t = t - begun * ramp.period_s
    share = np.minimum(t, away_s) - np.clip(t - away_s - ramp.rest_s, 0.0, away_s)
    return np.asarray(math.copysign(math.radians(ramp.speed_deg_s), ramp.travel_deg) * share)


def approach(start: float, end: float, peak_speed: float, cycle_s: float) -> Array:
    """Return the angles of a smooth move between rests, rad, (n,), after ``start``."""
    distance = abs(end - start)
    # The peak speed of a raised cosine of duration T is pi/2 times its mean speed, distance / T.
    n = math.ceil(0.5 * math.pi * distance / peak_speed / cycle_s)
    if n == 0:
        return np.empty(0)
    moved = raised_cosine(np.arange(1, n + 1) * cycle_s, n * cycle_s)
    return start + (end - start) * moved


def raised_cosine(t: NDArray[np.floating[Any]], duration: float) -> Array:
    """Return a smooth rise from 0 at t = 0 to 1 from t = ``duration`` on; 1 if that is 0."""
    if duration <= 0:
        return np.ones_like(t)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(t / duration, 0.0, 1.0)))
