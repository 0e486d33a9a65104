"""Bench file section of a drive with its own CAN frames: a DBC file and a map of its signals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from drivers.can.port import EXTENDED_FLAG
from drivers.dbc.bind import bind
from drivers.dbc.codec import Wiring
from drivers.dbc.file import DbcMapError, read_dbc
from drivers.dbc.limits import DbcDrive
from drivers.dbc.map import (
    DbcMap,
    Inputs,
    LimitMap,
    Orders,
    Protection,
    Quantity,
    Status,
    StopFrame,
)
from drivers.errors import ConfigurationError
from drivers.interfaces import Identity, ServoLimits
from drivers.mock.can_drives import CAN_DRIVE_FILES, CanDriveKind
from drivers.mock.dbc_drive import DRIVE_DBC
from rig.common.errors import InputError
from rig.config.configuration import Loc, Positive, Schema

_Natural = Annotated[int, Field(ge=0)]
_EXTENDED_BYTES = 3
"""Bytes of data that take as long as the 20 additional bits of an extended frame with bit stuffing.
"""
Problem = Callable[[Loc, str], str]  # function that formats a problem; see `problem`


class HeldSection(Schema):
    """Limits that were set in the drive with its maker's tool; limits that the drive reports over
    the bus have priority.

    Attributes:
        angle_min_deg: Lowest joint angle.
        angle_max_deg: Highest joint angle.
        speed_deg_s: Highest joint speed.
        torque_N_m: Highest torque at the joint.
        current_A: Highest motor current.
        following_error_deg: Largest following error; null if the drive has no such limit.
        quick_stop_deceleration_deg_s2: Deceleration of the drive's braking ramp, at the joint.
    """

    angle_min_deg: float
    angle_max_deg: float
    speed_deg_s: Positive
    torque_N_m: Positive
    current_A: Positive
    following_error_deg: Positive | None
    quick_stop_deceleration_deg_s2: Positive


class DbcServoSection(Schema):
    """A drive with its own CAN frames, described by a DBC file and a map of its signals.

    Attributes:
        kind: The protocol of the drive.
        file: The drive's DBC file, relative to the bench file; the simulated drive needs none.
        simulated_drive: The drive on the simulated bus: a drive with the frames of ODrive's CAN
            protocol, or a motor with MIT-style packed frames; if left out, the drive of the bench
            `practical_dbc`.
        name: Name of the drive in reports.
        vendor_id: Number of the maker, kept with the recording.
        product_code: Number of the product, kept with the recording.
        revision: Revision of the drive, if the drive does not report it.
        serial_number: Serial number of the drive, if the drive does not report it.
        offset_deg: Joint angle at which the drive's position reads zero.
        watchdog_ms: Time without a command after which the drive stops by itself; null if the drive
            has no watchdog.
        held: Limits set in the drive with its maker's tool.
        inputs: Signals that the drive reports.
        status: The signal of the drive's state.
        target: The signal of the target position, at the motor.
        orders: The values of signals to send for each order.
        stop_frame: A frame that stops the drive independently of all other frames.
        limits: Limits that can be written over the bus.
        messages: Counter, checksum and period of each message.
        torque_offset: The signal of a torque at the motor that the drive adds to the torque of its
            controller, N m after the scale; needed for feed-forward.
    """

    kind: Literal["dbc"]
    file: str | None = None
    simulated_drive: CanDriveKind | None = None
    name: str
    vendor_id: Annotated[int, Field(ge=1)]
    product_code: _Natural = 0
    revision: _Natural = 0
    serial_number: _Natural = 0
    offset_deg: float = 0.0
    watchdog_ms: Positive | None
    held: HeldSection
    inputs: Inputs
    status: Status
    target: Quantity
    orders: Orders
    stop_frame: StopFrame
    limits: LimitMap = LimitMap()
    messages: Mapping[str, Protection] = Field(default_factory=dict)
    torque_offset: Quantity | None = None

    @property
    def unreported(self) -> frozenset[str]:
        """Names of the limits that are not checked because the drive does not report the value."""
        unknown: set[str] = set()
        if self.inputs.temperature is None:
            unknown |= {"temperature_C"}
        if self.inputs.supply_voltage is None:
            unknown |= {"supply_min_V", "supply_max_V"}
        return frozenset(unknown)

    @property
    def quick_stop_option(self) -> int:
        """Quick stop option 2 of 605Ah: every stop of such a drive ends with the power off."""
        return 2

    @property
    def quick_stop_deceleration_deg_s2(self) -> float:
        """Deceleration of the drive's own ramp."""
        return self.held.quick_stop_deceleration_deg_s2

    @property
    def signal_map(self) -> DbcMap:
        """The signal map of the section."""
        return DbcMap(
            self.inputs,
            self.status,
            self.target,
            self.orders,
            self.stop_frame,
            self.limits,
            dict(self.messages),
            self.torque_offset,
        )

    def drive(self, gear_ratio: float, torque_constant_N_m_A: float) -> DbcDrive:
        """Return the data of the drive other than its signals, in SI units."""
        held = self.held
        window = held.following_error_deg
        return DbcDrive(
            identity=Identity(
                self.name, self.vendor_id, self.product_code, self.revision, self.serial_number
            ),
            held=ServoLimits(
                angle_min_rad=math.radians(held.angle_min_deg),
                angle_max_rad=math.radians(held.angle_max_deg),
                speed_rad_s=math.radians(held.speed_deg_s),
                torque_N_m=held.torque_N_m,
                current_A=held.current_A,
                following_error_rad=None if window is None else math.radians(window),
                quick_stop_option=self.quick_stop_option,
                quick_stop_deceleration_rad_s2=math.radians(held.quick_stop_deceleration_deg_s2),
            ),
            gear_ratio=gear_ratio,
            torque_constant_N_m_A=torque_constant_N_m_A,
            offset_rad=math.radians(self.offset_deg),
            watchdog_s=None if self.watchdog_ms is None else self.watchdog_ms * 1e-3,
        )


def dbc_path(section: DbcServoSection, path: Path) -> Path:
    """Return the path of the drive's DBC file, for a simulated drive a packaged one."""
    if section.file is not None:
        return path.parent / section.file
    kind = section.simulated_drive
    return DRIVE_DBC if kind is None else CAN_DRIVE_FILES[kind]


def wire(section: DbcServoSection, path: Path, simulated: bool, problem: Problem) -> Wiring:
    """Read the drive's DBC file and bind its signals; the InputError has every problem's place."""
    place: Loc = ("servo", "file")
    if section.file is None and not simulated:
        raise InputError(
            problem(place, "missing; state the DBC file of the real drive, relative to this file")
        )
    try:
        layouts = read_dbc(dbc_path(section, path))
    except ConfigurationError as error:
        raise InputError((problem(place, "cannot be used"), str(error))) from error
    try:
        return bind(section.signal_map, layouts)
    except DbcMapError as error:
        raise InputError([problem(("servo", *at), text) for at, text in error.problems]) from None


def cycle_frames(wiring: Wiring, cycle_s: float) -> list[tuple[int, int]]:
    """Return data bytes and period in cycles of each frame; 29-bit identifiers count 3 bytes."""
    frames = []
    for message in (*wiring.sent.values(), *wiring.received.values()):
        extended = _EXTENDED_BYTES if message.identifier & EXTENDED_FLAG else 0
        every = max(1, round(message.period_s / cycle_s))
        frames += [(message.size + extended, every), *[(0, every)] * message.remote]
    return frames
