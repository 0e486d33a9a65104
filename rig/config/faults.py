"""Schema of the fault schedule (YAML or CSV): simulated faults, and expected reactions."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from rig.common.yaml_tree import Mark, Node, csv_rows, read_text
from rig.config.configuration import Document, Schema, load_located, nearest, placed, validated

Target = Literal["bus", "line", "encoder_line", "drive", "encoder", "host", "disk", "operator"]
PhaseName = Literal[
    "prompt", "prepare", "enable", "approach", "settle", "excite", "ramp_out", "hold", "disable"
]
StateName = Literal[
    "switch_on_disabled",
    "ready",
    "switched_on",
    "operation_enabled",
    "quick_stop_active",
    "fault_reaction",
    "fault",
]
_COLUMNS = {
    "device": "frames.device",
    "function": "frames.function",
    "deenergised_within_s": "expect.deenergised_within_s",
    "exit_status": "expect.exit_status",
    "words": "expect.words",
}
"""Keys of the columns of a CSV file whose names are not the keys of a row."""


@dataclass(frozen=True)
class Kind:
    """One kind of fault."""

    meaning: str  # description of the fault
    unit: str = ""  # unit of `value`; empty if the value has no unit
    default: float | None = None  # default of `value`
    counted: bool = False  # whether `count` applies
    integer: bool = False  # whether `value` must be an integer


_counted = partial(Kind, counted=True)
_part = partial(Kind, counted=True, integer=True)
_code = partial(Kind, integer=True)
FAULTS: Mapping[tuple[str, str], Kind] = {
    ("bus", "lost"): _counted("frames are lost"),
    ("bus", "repeated"): _counted("frames arrive twice"),
    ("bus", "late"): _counted("frames arrive late", "s", 0.003),
    ("bus", "flipped"): _part(
        "one data bit is inverted, which the checksum does not detect", "bit", 29
    ),
    ("bus", "short"): _counted("the last byte is missing, which the checksum does not detect"),
    ("bus", "bus_off"): Kind(
        "the host's CAN controller is bus-off; permanently if there is no value", "s"
    ),
    ("bus", "error_frames"): _counted("the host receives error frames"),
    ("line", "lost"): _counted("messages of the drive's serial line are lost"),
    ("line", "byte_lost"): _part("one byte of a message is lost", "byte", 5),
    ("line", "corrupt"): _part("one bit is inverted: a CRC error", "bit", 37),
    ("line", "stuffing"): _counted("a byte 90h is not doubled"),
    ("line", "late"): _counted("messages arrive late", "s", 0.005),
    ("line", "repeated"): _counted("messages arrive twice"),
    ("line", "refused"): _counted("requests are answered with an error code"),
    ("line", "cut"): Kind("the line is unplugged; permanently if there is no value", "s"),
    ("encoder_line", "lost"): _counted("messages of the encoder's serial line are lost"),
    ("encoder_line", "byte_lost"): _part("one byte of a message is lost", "byte", 1),
    ("encoder_line", "corrupt"): _part("one bit is inverted: the check bits are wrong", "bit", 3),
    ("encoder_line", "late"): _counted("messages arrive late", "s", 0.005),
    ("encoder_line", "repeated"): _counted("messages arrive twice"),
    ("encoder_line", "cut"): Kind("the line is unplugged; permanently if there is no value", "s"),
    ("drive", "emcy"): _code(
        "the drive sends an emergency message without a reaction", "code", 0x2310
    ),
    ("drive", "fault"): _code("the drive goes into fault by itself", "code", 0x7320),
    ("drive", "restart"): Kind("the drive restarts, as after a short failure of its supply"),
    ("drive", "quick_stop_option"): _code("605Ah has another value", "605Ah", 2),
    ("drive", "stuck"): Kind(
        "the power stage is defective: once on, it stays on although the drive reports off"
    ),
    ("drive", "mode_refused"): Kind("the drive accepts 6060h, but 6061h stays 0"),
    ("drive", "sdo_abort"): _counted("SDO requests are refused"),
    ("drive", "sdo_timeout"): _counted("SDO requests are not answered"),
    ("drive", "limits_refused"): Kind("the drive ignores written limits"),
    ("drive", "counter_stuck"): Kind("the life counters of the drive do not change"),
    ("drive", "position_sign"): Kind("the position loop of the drive has the wrong sign"),
    ("drive", "velocity_sign"): Kind("the speed loop of the drive has the wrong sign"),
    ("drive", "phases_swapped"): Kind("two phases of the motor are swapped"),
    ("encoder", "bit"): _part("one bit of the position is inverted", "bit", 13),
    ("encoder", "jump"): Kind("the position shifts permanently", "deg", 5.0),
    ("encoder", "frozen"): Kind("the position stays constant, but the time stamps continue"),
    ("encoder", "reversed"): Kind("the encoder counts in the opposite direction"),
    ("host", "killed"): Kind(
        "the program is killed (SIGKILL) after the devices have run for this time", "s", 1.0
    ),
    ("host", "hangs"): Kind("the control loop pauses", "s", 0.5),
    ("host", "clock_step"): Kind("the control clock jumps", "s", 1.0),
    ("host", "recorder_fails"): Kind("writing the recording raises an input/output error"),
    ("disk", "full"): Kind("writing to files fails, as on a full disk"),
    ("operator", "stop"): Kind("Ctrl-C"),
    ("operator", "unanswered"): Kind(
        "the prompt's input ends without an answer after this time", "s", 0.0
    ),
    ("operator", "weight_removed"): Kind(
        "the weight falls or is taken off, and this mass is left on the lever", "kg", 0.0
    ),
    ("operator", "wrong_weight"): Kind(
        "the operator hangs this mass and types the planned mass", "kg", 60.0
    ),
}

COUNTED_FRAMES: Mapping[str, tuple[int, ...]] = {
    "sync": (0x080,),
    "output": (0x200,),
    "motion": (0x180,),
    "speed": (0x280,),
    "emergency": (0x080,),
    "heartbeat": (0x700,),
    "sdo_request": (0x600,),
    "sdo_answer": (0x580,),
}
"""Function codes (identifier without the node number) by the names that ``function`` may have."""


class Frames(Schema):
    """The frames that a bus fault affects; all frames if nothing is stated.

    Attributes:
        device: Frames of this device only. On a serial line `host` selects the requests, and
            `drive` or `encoder` selects the device's answers.
        function: Frames of this CANopen function only.
    """

    device: Literal["drive", "encoder", "host"] | None = None
    function: str | None = None

    @field_validator("function")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name is not None and name not in COUNTED_FRAMES:
            raise ValueError(f"unknown function; {nearest(name, sorted(COUNTED_FRAMES))}")
        return name


class Expectation(Schema):
    """The reaction that a run must show.

    Attributes:
        deenergised_within_s: Longest time from the fault to a drive without power.
        exit_status: Exit status of the run; negative for a signal that ends it.
        words: Regular expression that the run's last message must contain.
    """

    deenergised_within_s: Annotated[float, Field(ge=0)] | None = None
    exit_status: Annotated[int, Field(ge=-15, le=255)] | None = None
    words: str | None = None

    @field_validator("words")
    @classmethod
    def _expression(cls, words: str | None) -> str | None:
        if words is not None:
            try:
                re.compile(words)
            except re.error as error:
                raise ValueError(f"not a regular expression: {error}") from error
        return words


class FaultRow(Schema):
    """One fault of the schedule.

    The fault occurs at a bench time, or after the start of a phase or of a state of the drive;
    exactly one of `time_s`, `phase` and `state` is stated.

    Attributes:
        time_s: Bench time at which the fault occurs.
        phase: Phase of a stage from whose start `after_s` is counted.
        state: State of the drive from whose start `after_s` is counted.
        after_s: Delay after `time_s`, `phase` or `state`.
        stage: The stage of `phase`; if left out, the first stage.
        target: The part that fails.
        fault: Name of the fault, from the table of the target's faults.
        value: Size of the fault, in the unit that the table states.
        count: Number of frames, requests or readings that the fault affects; 0 for a permanent
            fault.
        frames: The frames that a fault of a bus or line affects.
        expect: The reaction that the run must show.
    """

    time_s: Annotated[float, Field(ge=0, le=1e9)] | None = None
    phase: PhaseName | None = None
    state: StateName | None = None
    after_s: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    stage: str | None = None
    target: Target
    fault: str
    value: Annotated[float, Field(ge=-1e9, le=1e9)] | None = None
    count: Annotated[int, Field(ge=0)] = 1
    frames: Frames = Frames()
    expect: Expectation = Expectation()

    @model_validator(mode="after")
    def _complete(self) -> Self:
        triggers = [
            name for name in ("time_s", "phase", "state") if getattr(self, name) is not None
        ]
        if len(triggers) != 1:
            given = " and ".join(triggers) or "none"
            raise ValueError(
                f"state exactly one of time_s, phase and state as the start of the fault, found "
                f"{given}"
            )
        names = sorted(name for target, name in FAULTS if target == self.target)
        if self.fault not in names:
            raise ValueError(
                f"{self.target!r} has no fault {self.fault!r}; {nearest(self.fault, names)}"
            )
        kind = self.kind
        if self.value is not None and not kind.unit:
            raise ValueError(f"{self.target} {self.fault} takes no value; remove the value")
        if "count" in self.model_fields_set and not kind.counted:
            raise ValueError(f"{self.target} {self.fault} takes no count; remove 'count'")
        if self.stage is not None and self.phase is None:
            raise ValueError("'stage' needs 'phase'; remove 'stage', or state the phase")
        unsigned = kind.unit in ("bit", "byte", "code")
        if unsigned and self.value is not None and not 0 <= self.value <= 0xFFFF:
            raise ValueError(
                f"{self.target} {self.fault} needs a value of 0 to 65535 ({kind.unit}), found "
                f"{self.value:g}"
            )
        if kind.integer and self.value is not None and self.value != int(self.value):
            raise ValueError(
                f"{self.target} {self.fault} needs a whole number ({kind.unit}), found "
                f"{self.value:g}"
            )
        if self.frames != Frames() and self.target not in ("bus", "line", "encoder_line"):
            raise ValueError("only faults of a bus or line have 'frames'; remove 'frames'")
        if self.frames.function is not None and self.target != "bus":
            raise ValueError("only faults of a CAN bus have a 'function'; remove 'function'")
        return self

    @property
    def kind(self) -> Kind:
        """The kind of fault."""
        return FAULTS[self.target, self.fault]

    @property
    def amount(self) -> float | None:
        """The value of the fault, or the default of its kind."""
        return self.kind.default if self.value is None else self.value

    @property
    def when(self) -> str:
        """Time of the fault, as text."""
        after = f" + {self.after_s:g} s" if self.after_s else ""
        if self.time_s is not None:
            return f"{self.time_s + self.after_s:g} s"
        return f"{self.phase or f'state {self.state}'}{after}"


class FaultSchedule(Schema):
    """A whole schedule, as written in its file.

    Attributes:
        faults: Version of the file format.
        rows: The faults, in any order.
    """

    faults: Literal[1]
    rows: Annotated[tuple[FaultRow, ...], Field(min_length=1)]


def load_faults(path: Path) -> Document[FaultSchedule]:
    """Read a fault schedule: CSV if the name ends in ``.csv``, else YAML.

    In CSV the first line names the columns, which are the keys of a row; the columns ``device`` and
    ``function`` are the keys of ``frames``, and the columns ``deenergised_within_s``,
    ``exit_status`` and ``words`` are the keys of ``expect``.
    """
    if path.suffix.lower() != ".csv":
        return load_located(path, FaultSchedule)
    with placed(path):
        rows = csv_rows(read_text(path), path, _COLUMNS)
    top = Mark(1, 1)
    places = {"faults": top, "rows": top}
    root = Node({"faults": Node(1, top, {}), "rows": Node(rows, top, {})}, top, places)
    return validated(path, root, FaultSchedule)
