"""Signal map of a drive with its own CAN frames: which signal of a DBC file has which meaning.

The bench file contains the map.

Signals are named ``Message.Signal`` as in the DBC. The units are those of the DBC, after its factor
and offset were applied; ``scale`` and ``sign`` convert the values to SI units. After this
conversion position, velocity, torque and target are those of the motor. The ranges of the numbers
are checked where the bench file is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from pydantic import Field

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
"""Names of the states in the map, with the state of CiA 402 that corresponds to each."""

Assignments = Mapping[str, str | int | float]
"""Value that each signal must have: a label of the DBC, or a raw number."""


@dataclass(frozen=True)
class Quantity:
    """A physical quantity in a signal: SI = sign x (scale x DBC value + offset).

    Attributes:
        signal: `Message.Signal` as in the DBC file.
        scale: SI units per unit of the DBC value, after factor and offset of the DBC.
        sign: -1 reverses the direction.
        offset: Value that is added after the scale, SI.
        wraps_after: For position and target: change, in rad, after which the signal has its former
            value again. The program then counts the overflows of a position from its first value
            on; between two frames the position must change by less than half of `wraps_after`. A
            target is sent as that value in the range of the signal that is equivalent to the
            target.
    """

    signal: str
    scale: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0
    sign: Literal[1, -1] = 1
    offset: float = 0.0
    wraps_after: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None


@dataclass(frozen=True)
class Inputs:
    """Signals that the drive reports; either ``current`` or ``torque`` is needed.

    Attributes:
        position: Motor angle, rad.
        velocity: Motor speed, rad/s.
        temperature: Temperature of the drive, deg C; omitted if the drive reports none. Without
            this signal the program does not check the temperature limit.
        supply_voltage: Supply voltage, V; omitted if the drive reports none. Without this signal
            the program does not check the limits of the supply voltage.
        current: Motor current, A.
        torque: Motor torque, N m.
        voltage: Motor voltage, V; if this signal is omitted, the recording contains NaN.
        time: Time of the drive's clock, s, modulo the range of its signal; if this signal is
            omitted, the time of arrival is used.
        fault_code: The drive's fault code. A code other than 0 counts as a fault in every state.
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
    """The signal that reports the state of the drive, and the meaning of its values.

    Attributes:
        signal: `Message.Signal` as in the DBC file.
        states: Values of the signal for each state: labels of the DBC, or numbers.
        asked: Whether the drive sends frames only in answer to a command. The program, in `rig
            check` too, then repeats the current order, which is `disable` until a run enables the
            drive.
    """

    signal: str
    states: Mapping[StateName, tuple[str | int, ...]]
    asked: bool = False


@dataclass(frozen=True)
class Orders:
    """The orders of the program, each with the values of signals to send: labels of the DBC, or
    numbers.

    If an order sets the target signal, its frames do not contain the target of the program. A
    message that occurs in orders only is sent once with each of these orders, or periodically if it
    has a ``period_ms``.

    Attributes:
        disable: Switches the power off.
        stop: Brakes, then switches the power off.
        reset: Clears a fault.
        enable: Order for each state that the drive reports; the orders are sent one after another
            until the drive runs.
    """

    disable: Assignments
    stop: Assignments
    reset: Assignments
    enable: Mapping[StateName, Assignments]


@dataclass(frozen=True)
class StopFrame:
    """A frame that stops the drive independently of all other frames; every stop, disable and close
    sends this frame.

    Attributes:
        message: Name of the message in the DBC file.
        signals: Value of each signal of this message.
    """

    message: str
    signals: Assignments = field(default_factory=dict)


@dataclass(frozen=True)
class LimitSignals:
    """The signal with which a limit is written, and the signal with which the drive reports the
    limit, in one unit.

    Attributes:
        set: The signal with which the limit is written.
        held: The signal that reports the limit; omitted if the drive does not report the limit. The
            limit is then written, but counts as a limit that only this program checks.
    """

    set: Quantity
    held: Quantity | None = None


@dataclass(frozen=True)
class LimitMap:
    """Limits that can be written over the bus, at the motor.

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
    """Counter and checksum of one message, and how often the message is sent.

    Attributes:
        counter: Signal of the message that increases by one with every message.
        checksum: Signal of the message that contains the checksum.
        algorithm: How the checksum is computed.
        prefix: Bytes that the checksum covers before those of the message: an identifier, a length
            or a data ID.
        own_byte: `zero`: the checksum covers its own byte with the value zero; `left out`: the
            checksum does not cover its own byte.
        period_ms: Period of the message; 0 for every control cycle (for an input: in answer to each
            command). If this key is omitted, the period is the cycle time in the DBC, or 0 without
            a cycle time; but a message that occurs in orders only is then sent once with each of
            these orders.
        remote: Whether the message is an input that the drive sends only in answer to a remote
            frame: the program then sends a remote frame every `period_ms`.
        counter_last: Greatest value of the counter, after which 0 follows; if this key is omitted,
            the greatest value of the signal.
    """

    counter: str | None = None
    checksum: str | None = None
    algorithm: ChecksumKind = "crc8_j1850"
    prefix: tuple[Annotated[int, Field(ge=0, le=0xFF)], ...] = ()
    own_byte: Literal["zero", "left out"] = "zero"
    period_ms: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    remote: bool = False
    counter_last: int | None = None


@dataclass(frozen=True)
class DbcMap:
    """All data of the bench file about the signals of one drive."""

    inputs: Inputs
    status: Status
    target: Quantity
    orders: Orders
    stop_frame: StopFrame
    limits: LimitMap = field(default_factory=LimitMap)
    messages: Mapping[str, Protection] = field(default_factory=dict)
    torque_offset: Quantity | None = None
