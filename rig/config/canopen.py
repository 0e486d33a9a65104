"""Bench file sections of the CAN bus, the CANopen drive (CiA 402) and joint encoder (CiA 406)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import Field, field_validator, model_validator

from drivers.canopen.device_data import SIMULATED, DeviceData, devices, match
from drivers.canopen.eds_file import read_eds
from drivers.canopen.motion import RPM, ModeName
from drivers.canopen.sdo import AXIS_OBJECTS
from drivers.errors import ConfigurationError
from rig.config.configuration import Positive, Schema, nearest

NodeId = Annotated[int, Field(ge=1, le=127)]
Sign = Literal[1, -1]
NO_DEVICE: Final = "none"  # value of `device` with which no data of a drive's maker are used
ObjectAddress = tuple[Annotated[int, Field(ge=0, le=0xFFFF)], Annotated[int, Field(ge=0, le=0xFF)]]


class Bus(Schema):
    """The bus of the devices.

    Attributes:
        interface: `mock` is the simulated bus; any other name is an interface of python-can, such
            as `socketcan`, `slcan` or `pcan`.
        channel: Name of the bus for the interface, such as `can0` or `/dev/ttyACM0`.
        bitrate: Bits per second, equal to the setting of the devices.
    """

    interface: str = "mock"
    channel: str | None = None
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000

    @field_validator("interface")
    @classmethod
    def _known(cls, name: str) -> str:
        if name == "mock":
            return name
        from can.interfaces import VALID_INTERFACES  # late: a simulated bench needs no adapter

        known = ["mock", "epos_serial", *sorted(VALID_INTERFACES)]
        if name not in known:
            raise ValueError(f"unknown interface; {nearest(name, known)}")
        return name


class PositionLoopSection(Schema):
    """The position loop of this program, for drives that accept a speed (`csv`) or torque (`cst`).

    Gains that are null are computed from the control cycle and, for a torque, from the inertia.

    Attributes:
        position_gain_1_s: Speed command per position error.
        speed_gain_N_m_s_rad: Torque command per speed error, at the joint; used with `cst` only.
        reset_1_s: Inverse reset time of the speed loop; used with `cst` only.
        inertia_kg_m2: Inertia at the joint, identified or from the drawings; `cst` needs it.
        drive_limits_speed: Whether the drive itself limits the speed in torque mode, to
            `limits.speed_deg_s` or less, as set with the maker's tool (for example 6080h). `cst`
            needs it, because a torque command that persists until the drive's watchdog acts
            accelerates the joint.
    """

    position_gain_1_s: Positive | None = None
    speed_gain_N_m_s_rad: Positive | None = None
    reset_1_s: Positive | None = None
    inertia_kg_m2: Positive | None = None
    drive_limits_speed: bool = False


class ServoSection(Schema):
    """A CiA 402 drive on CANopen, and the scales that convert its units to SI. A run checks the
    section against the device before it starts.

    Keys that are null are taken from the [data of the drive's maker](devices.md). If the program
    has no data of this maker, the values of CiA 402 apply.

    Attributes:
        kind: The protocol of the drive.
        node: CANopen node number.
        object_offset: Offset of the objects of the axis, for a drive with several axes in one
            node: 0x800 for the second axis, whose objects begin at 6800h in CiA 402.
        sub_index: Subindex of the axis, for a drive whose CiA 402 objects have one member for each
            axis, such as 6064h:01h and 6064h:02h; 0 for other drives. An object with a single value
            applies to all axes.
        device: Name of the maker's data. Null selects the data by the identity in the EDS file;
            `none` selects no data.
        counts_per_motor_turn: Counts of the motor encoder per turn, edges counted (608Fh).
        sign: 1 if the drive counts up for a positive joint angle, else -1.
        offset_deg: Joint angle at which the drive's position reads zero.
        current_sign: -1 if the drive reports a negative current while it drives its own count up,
            else 1.
        current_offset_A: Current that `rig check` shows while the main supply of the drive is off
            and only its electronics have power, subtracted from every current. A sensor needs this
            key whose zero is wrong by more than 2 % of the rated current, because the program
            otherwise cannot prove that the drive is off; the key hides a real current of this size.
        rated_current_A: Rated motor current; the unit of the drive's current objects is a
            thousandth of it (6075h).
        rated_torque_N_m: Rated motor torque; the unit of the drive's torque objects is a thousandth
            of it (6076h).
        velocity_unit: Unit of 606Ch and 607Fh; checked against 60A9h where the drive has it, and
            against the position as soon as the joint moves. Null if `velocity_unit_rad_s` or the
            maker's data state the unit.
        velocity_unit_rad_s: Motor speed of one unit of 606Ch, for other units. If neither this key
            nor the maker's data state the unit of speed, the unit is one count per second.
        acceleration_unit_rad_s2: Motor acceleration of one unit of 6083h, 6084h, 6085h and 609Ah;
            checked against 60AAh where the drive has it. If neither this key nor the maker's data
            state the unit, the unit is one unit of the speed per second.
        voltage_object: Index and subindex of the motor voltage; CiA 402 has none.
        voltage_unit_V: Voltage of one unit of `voltage_object`; 0.01 unless stated.
        temperature_object: Index and subindex of the drive's temperature; CiA 402 has none.
        temperature_unit_C: Temperature of one unit of `temperature_object`; 0.1 unless stated.
        supply_object: Index and subindex of the supply voltage; 6079h in CiA 402.
        supply_unit_V: Voltage of one unit of `supply_object`; 0.001 unless stated.
        current_object: Index and subindex of the maker's own object of the motor current. In CiA
            402 the object is 6078h or, if the drive lacks it, the torque 6077h.
        current_unit_A: Current of one unit of `current_object`, 0.001 unless stated; not used for
            6078h and 6077h of CiA 402, whose unit follows from the rated values.
        rated_current_object: Index and subindex of the rated motor current; 6075h in CiA 402.
        rated_current_object_unit_A: Current of one unit of `rated_current_object`; 0.001 unless
            stated.
        rated_torque_object: Index and subindex of the rated motor torque; 6076h in CiA 402.
        rated_torque_object_unit_N_m: Torque of one unit of `rated_torque_object`; 0.001 unless
            stated.
        mode: Mode of operation of the drive. In `csp` the program sends a position in every cycle.
            In `csv` the program sends speeds, in `cst` torques, and in these two modes the program
            closes the position loop; the drive must then detect by itself that the program is
            silent. In `pp` the program sends set-points,
            and the drive moves from one to the next in ramps; suitable for slow motions. Null
            selects the mode of the maker's data, or `csp` if the program has no data of this maker.
        position_loop: The position loop of `csv` and `cst`.
        profile_acceleration_deg_s2: Acceleration of the ramps of `pp`, at the joint (6083h, 6084h).
        stops_alone: Whether the drive switches the power off by itself when it receives nothing
            from this program. Null reads this from the EDS file (6007h). False reduces the limits,
            as for every drive without a watchdog.
        eds: The device's own EDS file, relative to the bench file; the simulated drive needs none,
            and has only the objects of the file if a file is named.
        quick_stop_option: Reaction of the drive to a quick stop (605Ah). 2: the drive brakes and
            switches the power off; 6: the drive brakes and stays in the state quick stop active.
        quick_stop_deceleration_deg_s2: Deceleration of the braking ramp, at the joint (6085h).
    """

    kind: Literal["canopen"] = "canopen"
    node: NodeId = 1
    object_offset: Annotated[int, Field(ge=0, le=7 * AXIS_OBJECTS, multiple_of=AXIS_OBJECTS)] = 0
    sub_index: Annotated[int, Field(ge=0, le=8)] = 0
    device: str | None = None
    counts_per_motor_turn: Annotated[int, Field(gt=0)] = 4096
    sign: Sign = 1
    offset_deg: float = 0.0
    current_sign: Sign = 1
    current_offset_A: float = 0.0
    rated_current_A: Positive = 15.0
    rated_torque_N_m: Positive = 0.45
    velocity_unit: Literal["counts_per_s", "rpm"] | None = None
    velocity_unit_rad_s: Positive | None = None
    acceleration_unit_rad_s2: Positive | None = None
    voltage_object: ObjectAddress | None = None
    voltage_unit_V: Positive | None = None
    temperature_object: ObjectAddress | None = None
    temperature_unit_C: Positive | None = None
    supply_object: ObjectAddress | None = None
    supply_unit_V: Positive | None = None
    current_object: ObjectAddress | None = None
    current_unit_A: Positive | None = None
    rated_current_object: ObjectAddress | None = None
    rated_current_object_unit_A: Positive | None = None
    rated_torque_object: ObjectAddress | None = None
    rated_torque_object_unit_N_m: Positive | None = None
    mode: ModeName | None = None
    position_loop: PositionLoopSection = PositionLoopSection()
    profile_acceleration_deg_s2: Positive = 2000.0
    stops_alone: bool | None = None
    eds: str | None = None
    quick_stop_option: Literal[2, 6] = 2
    quick_stop_deceleration_deg_s2: Positive = 2000.0

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.object_offset and self.sub_index:
            raise ValueError(
                f"object_offset {self.object_offset:#x} and sub_index {self.sub_index} are both "
                "set; remove one of these two keys"
            )
        if self.velocity_unit is not None and self.velocity_unit_rad_s is not None:
            raise ValueError(
                f"velocity_unit {self.velocity_unit} and velocity_unit_rad_s "
                f"{self.velocity_unit_rad_s:g} are both set; remove one of these two keys"
            )
        loop = self.position_loop
        if self.mode == "cst" and (loop.inertia_kg_m2 is None or not loop.drive_limits_speed):
            raise ValueError(
                "mode cst needs position_loop.inertia_kg_m2, and a drive that itself limits the "
                "speed, stated by position_loop.drive_limits_speed: true"
            )
        return self

    @field_validator("device")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        names = [NO_DEVICE, *devices()]
        if name is not None and name not in names:
            raise ValueError(
                f"no file in drivers/canopen/devices has this name; {nearest(name, names)}"
            )
        return name

    def device_data(self, folder: Path) -> DeviceData | None:
        """Return the maker's data of the drive, or None; ``folder`` is that of the bench file."""
        if self.device is not None:
            return devices().get(self.device)
        if self.eds is None:
            return devices()[SIMULATED]
        try:
            return match(read_eds(folder / self.eds, self.node))
        except ConfigurationError:
            return None

    def commanded(self, data: DeviceData | None) -> ModeName:
        """Return the mode of the section, else that of the maker's data, else `csp`."""
        return self.mode or (data.mode if data is not None else None) or "csp"

    def motor_speed_unit_rad_s(self, data: DeviceData | None) -> float | None:
        """Return the motor speed of one unit of 606Ch, rad/s, or None for one count per second."""
        if self.velocity_unit is not None or self.velocity_unit_rad_s is not None:
            return RPM if self.velocity_unit == "rpm" else self.velocity_unit_rad_s
        if data is None:
            return None
        counts_per_s = data.velocity_unit_counts_per_s
        if counts_per_s is not None:
            return counts_per_s * 2.0 * math.pi / self.counts_per_motor_turn
        return RPM if data.velocity_unit == "rpm" else None

    def motor_acceleration_unit_rad_s2(self, data: DeviceData | None) -> float | None:
        """Return the motor acceleration of one unit of 6085h, rad/s^2, or None."""
        if self.acceleration_unit_rad_s2 is not None or data is None:
            return self.acceleration_unit_rad_s2
        if data.acceleration_unit_counts_per_s2 is not None:
            turns = data.acceleration_unit_counts_per_s2 / self.counts_per_motor_turn
        elif data.acceleration_unit_turns_per_s2 is not None:
            turns = data.acceleration_unit_turns_per_s2
        else:
            return None
        return 2.0 * math.pi * turns


class EncoderSection(Schema):
    """The joint encoder, a CiA 406 device on CANopen.

    Attributes:
        kind: The protocol of the encoder.
        node: CANopen node number.
        counts_per_turn: Counts per turn of the joint.
        sign: 1 if the encoder counts up for a positive joint angle, else -1.
        offset_deg: Joint angle at which the encoder reads zero.
        eds: The device's own EDS file, relative to the bench file; the simulated encoder needs
            none.
    """

    kind: Literal["cia406"] = "cia406"
    node: NodeId = 2
    counts_per_turn: Annotated[int, Field(gt=0)] = 262144
    sign: Sign = 1
    offset_deg: float = 0.0
    eds: str | None = None
