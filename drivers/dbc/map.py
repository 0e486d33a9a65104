"""Map of the signals of a drive with its own CAN frames, as given in the bench file.

Signals are named ``Message.Signal`` as in the DBC. Units are those of the DBC (its factor and
offset applied), brought to SI by ``scale`` and ``sign``; position, velocity, torque and target are
at the motor then.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from drivers.dbc.codec import ChecksumKind
from drivers.interfaces import ServoState

StateName = Literal[
    "starting", "disabled", "ready", "standby", "running", "stopping", "fault reaction", "fault"
]
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
"""State names in the map to states of the program."""

Assignments = Mapping[str, str | int | float]
"""Signal to the value it must carry: a label of the DBC, or a raw number."""


@dataclass(frozen=True)
class Quantity:
    """A physical quantity in a signal: SI = sign x (scale x DBC value + offset).

    Attributes:
        signal: `Message.Signal` as in the DBC file.
        scale: SI units per unit of the DBC value, whose own factor and offset are applied before.
        sign: -1 turns the direction.
        offset: Added after the scale, SI.
        wraps_after: For position and target: change, in rad, after which the signal shows the same
            value again. A position is then followed over the jump (it moves less than half of this
            between two frames), from its first value on; a target is sent as the value of the
            signal's range that means the same angle.
    """

    signal: str
    scale: float = 1.0
    sign: Literal[1, -1] = 1
    offset: float = 0.0
    wraps_after: float | None = None


@dataclass(frozen=True)
class Inputs:
    """What the drive reports; one of ``current`` and ``torque`` is needed.

    Attributes:
        position: Motor angle, rad.
        velocity: Motor speed, rad/s.
        temperature: Temperature of the drive, deg C; left out where the drive reports none, and no
            limit is checked then.
        supply_voltage: Supply voltage, V; left out as the temperature.
        current: Motor current, A.
        torque: Motor torque, N m.
        voltage: Motor voltage, V; not a number in the recording where it is left out.
        time: The drive's own clock, s, modulo the range of its signal; without it the time of
            arrival is taken.
        fault_code: The drive's fault code. A code other than 0 is a fault, whatever the state says.
        serial_number: The drive's serial number.
        revision: The drive's firmware or hardware revision.
    """

    position: Quantity
    velocity: Quantity
    temperature: Quantity | None = None
    supply_voltage: Quantity | None = None
    current: Quantity | None = None
    torque: Quantity | None = None
    voltage: Quantity | None = None
    time: Quantity | None = None
    fault_code: Quantity | None = None
    serial_number: Quantity | None = None
    revision: Quantity | None = None


@dataclass(frozen=True)
class Status:
    """The signal that says what state the drive is in, and which of its values mean which state.

    Attributes:
        signal: `Message.Signal` as in the DBC file.
        states: State to the values of the signal that mean it: labels of the DBC, or numbers.
        asked: The drive is silent until it gets a command. The program then asks by repeating the
            order in force, which is `disable` until a run enables the drive; `check` does so too.
    """

    signal: str
    states: Mapping[StateName, tuple[str | int, ...]]
    asked: bool = False


@dataclass(frozen=True)
class Orders:
    """What to send for each verb: signal to label of the DBC, or number.

    An order that sets the target signal goes without the target. A message that only orders name is
    sent with these orders alone, and once; with a ``period_ms`` of its own it is sent periodically.

    Attributes:
        disable: Takes the power off.
        stop: Brakes, then takes the power off.
        reset: Clears a fault.
        enable: By the state that the drive reports, one step at a time until it runs.
    """

    disable: Assignments
    stop: Assignments
    reset: Assignments
    enable: Mapping[StateName, Assignments]


@dataclass(frozen=True)
class StopFrame:
    """A frame that stops the drive whatever else is sent; every stop, disable and close sends it.

    Attributes:
        message: Name of the message in the DBC file.
        signals: Signal of that message to its value.
    """

    message: str
    signals: Assignments = field(default_factory=dict)


@dataclass(frozen=True)
class LimitSignals:
    """Where a limit is written, and where the drive reports what it holds; in the same units.

    Attributes:
        set: The signal that the limit is written to.
        held: The signal that reports the limit; left out where none does. Such a limit is written,
            but counts as one that this program alone holds.
    """

    set: Quantity
    held: Quantity | None = None


@dataclass(frozen=True)
class LimitMap:
    """Limits that the drive takes over the bus, at the motor.

    Attributes:
        angle_min: Lowest motor angle, rad.
        angle_max: Highest motor angle, rad.
        speed: Highest motor speed, rad/s.
        current: Highest motor current, A.
        following_error: Largest following error of the motor angle, rad.
    """

    angle_min: LimitSignals | None = None
    angle_max: LimitSignals | None = None
    speed: LimitSignals | None = None
    current: LimitSignals | None = None
    following_error: LimitSignals | None = None


@dataclass(frozen=True)
class Protection:
    """How one message is guarded, and how often it goes.

    Attributes:
        counter: Signal of the message that counts up with every message.
        checksum: Signal of the message that holds the checksum.
        algorithm: How the checksum is computed.
        prefix: Bytes that the checksum covers before those of the message: an identifier, a length
            or a data ID.
        own_byte: `zero`: the checksum covers its own byte, as zero; `left out`: it does not.
        period_ms: How often the message goes; 0 for every control cycle (an input: in answer to
            each command). Left out, the cycle time of the DBC holds, or 0 where it has none; a
            message that only orders name is then sent once with each of them.
        remote: An input that the drive sends only in answer to a remote frame: the program sends
            one every `period_ms`.
        counter_last: Value of the counter that 0 follows; left out, the greatest that it can hold.
    """

    counter: str | None = None
    checksum: str | None = None
    algorithm: ChecksumKind = "crc8_j1850"
    prefix: tuple[int, ...] = ()
    own_byte: Literal["zero", "left out"] = "zero"
    period_ms: float | None = None
    remote: bool = False
    counter_last: int | None = None


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
    torque_offset: Quantity | None = None
