"""The CAN bus and the CANopen devices in a bench file: drive (CiA 402) and joint encoder (CiA
406).
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.canopen.velocity_unit import RPM
from rig.config.configuration import Positive, Schema

NodeId = Annotated[int, Field(ge=1, le=127)]
Sign = Literal[1, -1]
ObjectAddress = tuple[Annotated[int, Field(ge=0, le=0xFFFF)], Annotated[int, Field(ge=0, le=0xFF)]]


class Bus(Schema):
    """Where the devices are.

    Attributes:
        interface: `mock` is the simulated bus; any other name is an interface of python-can, such
            as `socketcan`, `slcan` or `pcan`.
        channel: Name of the bus for that interface, such as `can0` or `/dev/ttyACM0`.
        bitrate: Bits per second, the same as in the devices.
    """

    interface: str = "mock"
    channel: str | None = None
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000


class ServoSection(Schema):
    """A CiA 402 drive on CANopen, and the scales that turn its units into SI; checked against the
    device before a run.

    Attributes:
        kind: The protocol of the drive.
        node: CANopen node number.
        counts_per_motor_turn: Counts of the motor encoder per turn, edges counted (608Fh).
        sign: 1 where the drive counts up for a positive joint angle, else -1.
        offset_deg: Joint angle at which the drive's position reads zero.
        current_sign: -1 where the drive's current is negative while it drives its own count up,
            else 1.
        rated_current_A: Rated motor current; the unit of the drive's current objects is a
            thousandth of it (6075h).
        rated_torque_N_m: Rated motor torque; the unit of the drive's torque objects is a thousandth
            of it (6076h).
        velocity_unit: Unit of 606Ch, 607Fh and, per second, 6085h; checked against 60A9h where the
            drive has it, and against the position as soon as the joint moves. Null for
            `velocity_unit_rad_s`.
        velocity_unit_rad_s: Motor speed of one unit of 606Ch, for other units; null for one count
            per second.
        voltage_object: Index and subindex of the motor voltage.
        voltage_unit_V: Voltage of one unit of that object.
        temperature_object: Index and subindex of the drive's temperature.
        temperature_unit_C: Temperature of one unit of that object.
        supply_object: Index and subindex of the supply voltage.
        supply_unit_V: Voltage of one unit of that object.
        current_object: Index and subindex of the maker's own object of the motor current; null for
            6078h or, where the drive has none, the torque 6077h.
        current_unit_A: Current of one unit of that object; not used for 6078h and 6077h, whose
            unit follows from the rated values.
        rated_current_object: Index and subindex of the rated motor current.
        rated_current_object_unit_A: Current of one unit of that object.
        rated_torque_object: Index and subindex of the rated motor torque.
        rated_torque_object_unit_N_m: Torque of one unit of that object.
        stops_alone: Whether the drive takes the power off by itself when it hears nothing of this
            program any more; null where its EDS file shows it (6007h). False cuts the limits, as
            for every drive without a watchdog.
        eds: The device's own EDS file, relative to the bench file; the simulated drive needs none,
            and shows only the objects of the file if one is named.
        quick_stop_option: What the drive does on a quick stop (605Ah). 2 brakes and takes the power
            off, 6 brakes and stays in the state quick stop active.
        quick_stop_deceleration_deg_s2: Deceleration of the braking ramp, at the joint (6085h).
    """

    kind: Literal["canopen"] = "canopen"
    node: NodeId = 1
    counts_per_motor_turn: Annotated[int, Field(gt=0)] = 4096
    sign: Sign = 1
    offset_deg: float = 0.0
    current_sign: Sign = 1
    rated_current_A: Positive = 15.0
    rated_torque_N_m: Positive = 0.45
    velocity_unit: Literal["counts_per_s", "rpm"] | None = None
    velocity_unit_rad_s: Positive | None = None
    voltage_object: ObjectAddress = (0x2100, 0)
    voltage_unit_V: Positive = 0.01
    temperature_object: ObjectAddress = (0x2101, 0)
    temperature_unit_C: Positive = 0.1
    supply_object: ObjectAddress = (0x6079, 0)
    supply_unit_V: Positive = 0.001
    current_object: ObjectAddress | None = None
    current_unit_A: Positive = 0.001
    rated_current_object: ObjectAddress = (0x6075, 0)
    rated_current_object_unit_A: Positive = 0.001
    rated_torque_object: ObjectAddress = (0x6076, 0)
    rated_torque_object_unit_N_m: Positive = 0.001
    stops_alone: bool | None = None
    eds: str | None = None
    quick_stop_option: Literal[2, 6] = 2
    quick_stop_deceleration_deg_s2: Positive = 2000.0

    @model_validator(mode="after")
    def _one_velocity_unit(self) -> Self:
        if self.velocity_unit is not None and self.velocity_unit_rad_s is not None:
            raise ValueError(
                f"velocity_unit {self.velocity_unit} and velocity_unit_rad_s "
                f"{self.velocity_unit_rad_s:g} are both set; remove one"
            )
        return self

    @property
    def motor_speed_unit_rad_s(self) -> float | None:
        """Motor speed of one unit of 606Ch, rad/s; None for one count per second."""
        return RPM if self.velocity_unit == "rpm" else self.velocity_unit_rad_s


class EncoderSection(Schema):
    """The joint encoder, a CiA 406 device on CANopen.

    Attributes:
        kind: The protocol of the encoder.
        node: CANopen node number.
        counts_per_turn: Counts per turn of the joint.
        sign: 1 where the encoder counts up for a positive joint angle, else -1.
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
