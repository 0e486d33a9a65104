"""What a bench file says about a drive that speaks its own CAN frames: which signal means what.

Signals are named ``Message.Signal`` as in the DBC. Units are those of the DBC (its factor and offset applied), brought
to SI by ``scale`` and ``sign``; position, velocity, torque and target are at the motor then.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from drivers.dbc_codec import ChecksumKind
from drivers.interfaces import ServoState

StateName = Literal["starting", "disabled", "ready", "standby", "running", "stopping", "fault reaction", "fault"]
STATES: Final[Mapping[StateName, ServoState]] = {
    "starting": ServoState.NOT_READY,
    "disabled": ServoState.SWITCH_ON_DISABLED,
    "ready": ServoState.READY,
    "standby": ServoState.SWITCHED_ON,
    "running": ServoState.OPERATION_ENABLED,
    "stopping": ServoState.QUICK_STOP_ACTIVE,
    "fault reaction": ServoState.FAULT_REACTION,
    "fault": ServoState.FAULT,
}
"""Words of the map for the states of the rest of the program."""

Assignments = Mapping[str, str | int]
"""Signal to the value it is to carry: a label of the DBC, or a number."""


@dataclass(frozen=True)
class Quantity:
    """A physical quantity in a signal: SI = sign x (scale x DBC value + offset)."""

    signal: str
    scale: float = 1.0
    sign: Literal[1, -1] = 1
    offset: float = 0.0


@dataclass(frozen=True)
class Inputs:
    """What the drive reports; one of ``current`` (A) and ``torque`` (N m at the motor) is needed.

    ``time`` is the drive's own clock, s, modulo the range of its signal; without it the host's time of arrival is
    taken. ``voltage`` (at the motor) is not a number where it is left out.
    """

    position: Quantity
    velocity: Quantity
    temperature: Quantity
    supply_voltage: Quantity
    current: Quantity | None = None
    torque: Quantity | None = None
    voltage: Quantity | None = None
    time: Quantity | None = None
    fault_code: Quantity | None = None
    serial_number: Quantity | None = None
    revision: Quantity | None = None


@dataclass(frozen=True)
class Status:
    """The signal that says what state the drive is in, and which of its values mean which state."""

    signal: str
    states: Mapping[StateName, tuple[str | int, ...]]


@dataclass(frozen=True)
class Orders:
    """What to send for each verb. ``enable`` is by the state the drive reports, one step at a time."""

    disable: Assignments
    stop: Assignments
    reset: Assignments
    enable: Mapping[StateName, Assignments]


@dataclass(frozen=True)
class StopFrame:
    """A frame that stops the drive whatever else is said; sent by every stop, disable and close."""

    message: str
    signals: Assignments = field(default_factory=dict)


@dataclass(frozen=True)
class LimitSignals:
    """Where a limit is written, and where the drive says what it holds; in the same units."""

    set: Quantity
    held: Quantity


@dataclass(frozen=True)
class LimitMap:
    """Limits that the drive can be told over the bus: angles, speed and following error at the motor, current in A."""

    angle_min: LimitSignals | None = None
    angle_max: LimitSignals | None = None
    speed: LimitSignals | None = None
    current: LimitSignals | None = None
    following_error: LimitSignals | None = None


@dataclass(frozen=True)
class Protection:
    """How one message is guarded, and how often it goes.

    ``counter`` and ``checksum`` name signals of the message. ``period_ms`` is how often it goes; 0 for every control
    cycle (an input: in answer to each command). Left out, the DBC's cycle time holds, or 0 where it has none.
    """

    counter: str | None = None
    checksum: str | None = None
    algorithm: ChecksumKind = "crc8_j1850"
    period_ms: float | None = None


@dataclass(frozen=True)
class DbcMap:
    """Everything the bench file says about the signals."""

    inputs: Inputs
    status: Status
    target: Quantity
    orders: Orders
    stop_frame: StopFrame
    limits: LimitMap = field(default_factory=LimitMap)
    messages: Mapping[str, Protection] = field(default_factory=dict)
