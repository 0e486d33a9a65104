"""Data classes of the content of ``run.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal

from pydantic import ConfigDict

from rig.common import provenance

SCHEMA = "loadrig.run/1"
RUN_FILE = provenance.RUN_FILE
RECORDING_FILE = "recording.mcap"
BENCH_ATTACHMENT = "bench.yaml"
SEQUENCE_ATTACHMENT = "sequence.yaml"
FEEDFORWARD_INPUT = "feedforward.json"
"""Name, as input and attachment, of the identification behind the torque offsets."""
ACCEPTANCE_INPUT = "acceptance.yaml"
"""Name, as input of a run and as attachment, of the file of limits given with ``--acceptance``."""
DIED = "died"  # state of a recording whose writer died
STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Validator with which a record is read back; the creation of a record does not validate it."""
Load = Literal["unloaded", "loaded", "hot_fire"]
Role = Literal["fit", "validate"]
StageEnd = Literal["stopped", "tripped", "failed"]
STAGE_ENDS: Mapping[str, StageEnd] = {
    "stopped": "stopped",
    "tripped": "tripped",
    "failed": "failed",
    "crashed": "failed",
}
"""State of the current stage by the state of a run that ended early."""


@dataclass
class StageRecord:
    """State of one stage.

    Attributes:
        name: Name of the stage.
        stage: Load condition.
        weight_kg: Planned mass on the lever.
        repeats: Planned excitations.
        samples: Samples of one excitation.
        state: `planned`, `running`, `done`, or how the run ended if it ended during the stage.
        confirmed_kg: Mass that the operator confirmed.
        role: `fit` or `validate`.
        load_change_kg: Mass by which the load changed during the stage, by its friction; None if no
            change was found.
    """

    __pydantic_config__ = STRICT

    name: str
    stage: Load
    weight_kg: float
    repeats: int
    samples: int
    state: Literal["planned", "running", "done"] | StageEnd = "planned"
    confirmed_kg: float | None = None
    role: Role = "fit"
    load_change_kg: float | None = None

    @property
    def outcome(self) -> str:
        """The state, with a change of the load."""
        return self.state if self.load_change_kg is None else f"{self.state}, load changed"

    @property
    def mass_kg(self) -> float:
        """The confirmed mass or, before a confirmation, the planned mass, kg."""
        return self.weight_kg if self.confirmed_kg is None else self.confirmed_kg

    def segment(
        self, index: int, stage_index: int, repeat: int, start: float, part: int
    ) -> SegmentRecord:
        """Return the initial record of an excitation of this stage; ``repeat`` counts from 1."""
        name = self.name if self.repeats == 1 else f"{self.name}[{repeat}]"
        return SegmentRecord(
            index,
            name,
            self.stage,
            self.mass_kg,
            start,
            self.samples,
            stage_index=stage_index,
            part=part,
            role=self.role,
        )


@dataclass
class SegmentRecord:
    """One excitation: the stage to which it belongs, and the times of its start and end.

    Attributes:
        index: Number from 1, unique in the run; the samples contain this number.
        name: Name of the recording that the excitation becomes.
        stage: Load condition.
        weight_kg: Mass on the lever.
        start: Start of the excitation, since the start of the recording, s.
        samples: Planned samples.
        end: End of the excitation, since the start of the recording, s.
        stage_index: Index of the excitation's stage, from 0.
        part: Number of the excitation's recording, from 1.
        kept: False if the stage of the excitation was begun again.
        role: `fit` or `validate`.
    """

    __pydantic_config__ = STRICT

    index: int
    name: str
    stage: Load
    weight_kg: float
    start: float
    samples: int
    end: float | None = None
    stage_index: int = 0
    part: int = 1
    kept: bool = True
    role: Role = "fit"


@dataclass
class PartRecord:
    """One recording of a run: the first recording, or a recording of a ``rig resume``.

    Attributes:
        file: File of the run folder.
        created: Date and time, UTC.
        seed: Seed of the simulated bench's noise.
        operator: Name of the operator.
        versions: Versions of this program and of the libraries that it depends on.
        devices: Identities of the devices, and the limits that the drive held before the run.
        state: `running`, `died`, or how the recording ended.
        cycles: Control cycles.
        seconds: Length of the recording, s.
        timing: Histograms of lateness and of the answers, missed SYNCs, lost samples, oldest
            sample.
        ended: Date and time of the end, UTC; None if unknown.
        message: How the recording ended, as text.
    """

    __pydantic_config__ = STRICT

    file: str
    created: str
    seed: int
    operator: str | None
    versions: Mapping[str, str]
    devices: Mapping[str, Any] = field(default_factory=dict)
    state: str = "running"
    cycles: int = 0
    seconds: float = 0.0
    timing: Mapping[str, Any] = field(default_factory=dict)
    ended: str | None = None
    message: str = ""


@dataclass
class RunRecord:
    """The whole content of ``run.json``.

    Attributes:
        name: Name of the sequence.
        created: Date and time, UTC.
        seed: Seed of the simulated bench's noise.
        simulated: Whether the bench is simulated.
        realtime: Whether a simulated bench ran in real time.
        cycle_s: Control cycle, s.
        versions: Versions of this program and of the libraries that it depends on.
        inputs: File and SHA-256 of every input file, by name.
        bench: Nominal constants of the bench, SI.
        stages: State of each stage.
        segments: Every excitation that began.
        parts: Every recording.
        operator: Name of the operator.
        calibrations: Calibrations of the bench, and whether each was overdue.
        weights: Weight checks: stage, confirmed and measured mass, verdict, message.
        warnings: Warnings that were shown to the operator.
        state: `running`, or how the run ended: `done`, `tripped`, `stopped`, `failed`, `crashed`.
        message: How the run ended, as text.
        trip: The limit that was violated: check, value, limit, unit, time; whether the joint moved
            against the command; and the predicted peak of torque or current, else None.
        de_energised: Whether state, current and motion showed at the end that the drive is off.
        drive_state: State of the drive as it was read back, in the words of CiA 402, or None if
            unknown.
        drive: How the drive was left: state, current, motion, and why it was not proved off.
        cycles: Control cycles.
        overruns: Cycles that started late.
        stale: Cycles whose answer was incomplete.
        seconds: Time of the bench, s.
        schema: Name and version of the format.
    """

    __pydantic_config__ = STRICT

    name: str
    created: str
    seed: int
    simulated: bool
    realtime: bool
    cycle_s: float
    versions: Mapping[str, str]
    inputs: Mapping[str, Mapping[str, str]]
    bench: Mapping[str, Any]
    stages: list[StageRecord]
    segments: list[SegmentRecord] = field(default_factory=list)
    parts: list[PartRecord] = field(default_factory=list)
    operator: str | None = None
    calibrations: list[Mapping[str, Any]] = field(default_factory=list)
    weights: list[Mapping[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    state: str = "running"
    message: str = ""
    trip: Mapping[str, Any] | None = None
    de_energised: bool | None = None
    drive_state: str | None = None
    drive: dict[str, Any] | None = None
    cycles: int = 0
    overruns: int = 0
    stale: int = 0
    seconds: float = 0.0
    schema: str = SCHEMA

    @property
    def operators(self) -> list[str]:
        """Names of the operators of the recordings, else of the run, each once."""
        names = [part.operator for part in self.parts if part.operator]
        return list(dict.fromkeys(names or filter(None, [self.operator])))

    @property
    def operators_words(self) -> str:
        """The operators as text."""
        return ", ".join(self.operators) or "not given"

    def stage_ended(self, state: str) -> None:
        """Set the state of the current stage, if there is one, at the end of the run with state
        ``state``.

        If a stage is still running although the run is done, the state of the stage is failed.
        """
        for stage in self.stages:
            if stage.state == "running":
                stage.state = STAGE_ENDS.get(state, "failed")


class Ending(Enum):
    """How a run ended."""

    DONE = "done"
    TRIPPED = "tripped"
    STOPPED = "stopped"
    FAILED = "failed"
    CRASHED = "crashed"


class Verdict(Enum):
    """Result of a weight check."""

    RIGHT = "right"
    WRONG = "wrong"
    UNCHECKED = "unchecked"


@dataclass(frozen=True)
class Weighing:
    """Data of one weight check."""

    stage: str  # name of the stage
    confirmed_kg: float  # mass on the lever as confirmed by the operator
    verdict: Verdict  # verdict by friction
    # Mass that the measured friction implies, or None if it could not be measured.
    measured_kg: float | None
    # Standard error of the measured mass, without the error of the reference.
    sigma_kg: float | None
    message: str  # text with the remedy
