"""What ``run.json`` holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic import ConfigDict

SCHEMA = "loadrig.run/1"
RUN_FILE = "run.json"
RECORDING_FILE = "recording.mcap"
BENCH_ATTACHMENT = "bench.yaml"
SEQUENCE_ATTACHMENT = "sequence.yaml"
FEEDFORWARD_INPUT = "feedforward.json"
"""The identification that the drive's torque offsets were computed from, under the inputs and as attachment."""
DIED = "died"
"""State of a recording whose writer died."""
STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
"""How a record is read back; it is built without being checked."""
Load = Literal["unloaded", "loaded", "hot_fire"]
Role = Literal["fit", "validate"]
StageEnd = Literal["stopped", "tripped", "failed"]
STAGE_ENDS: Mapping[str, StageEnd] = {
    "stopped": "stopped",
    "tripped": "tripped",
    "failed": "failed",
    "crashed": "failed",
}
"""State of a run that ended before its plan did, to the state of the stage that was going on."""


@dataclass
class StageRecord:
    """State of one stage: ``stopped``, ``tripped`` and ``failed`` say how the run ended that it was going on in."""

    __pydantic_config__ = STRICT

    name: str
    stage: Load
    weight_kg: float
    repeats: int
    samples: int
    state: Literal["planned", "running", "done"] | StageEnd = "planned"
    confirmed_kg: float | None = None
    role: Role = "fit"

    @property
    def mass_kg(self) -> float:
        """The mass that was confirmed, or the planned one where none was yet, kg."""
        return self.weight_kg if self.confirmed_kg is None else self.confirmed_kg

    def segment(self, index: int, stage_index: int, repeat: int, start: float, part: int) -> SegmentRecord:
        """Return the record of one of this stage's excitations, numbered ``repeat`` from 1, as it begins."""
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
    """One excitation: which stage it belongs to, and when it ran, s since the start of its recording.

    Attributes:
        index: From 1, unique in the run; the samples carry it.
        stage_index: Which stage.
        part: Which recording, from 1.
        kept: False once its stage was begun again.
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
    """One recording of a run: the first, or that of a ``rig resume``."""

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


@dataclass
class RunRecord:
    """Everything in ``run.json``.

    ``drive_state`` is the state that the drive was read back in at the end, in the words of CiA 402; None where that is
    not known.
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
    cycles: int = 0
    overruns: int = 0
    stale: int = 0
    seconds: float = 0.0
    schema: str = SCHEMA

    def stage_ended(self, state: str) -> None:
        """Note how the run ended on the stage that was going on, if any: ``state`` is that of the run.

        A stage that still goes on where the run says that it is done has failed.
        """
        for stage in self.stages:
            if stage.state == "running":
                stage.state = STAGE_ENDS.get(state, "failed")
