"""A simulated bench whose drive speaks its own frames, with the host's drivers on it, for tests."""

import math
from dataclasses import dataclass

from drivers.can.port import PythonCanPort
from drivers.canopen.sensors import Cia406Encoder
from drivers.dbc.bind import bind
from drivers.dbc.channel import DbcChannel
from drivers.dbc.file import read_dbc
from drivers.dbc.limits import DbcDrive
from drivers.dbc.link import DbcLink
from drivers.dbc.map import (
    DbcMap,
    Inputs,
    LimitMap,
    LimitSignals,
    Orders,
    Protection,
    Quantity,
    Status,
    StopFrame,
)
from drivers.dbc.servo import DbcServo
from drivers.interfaces import Identity, ServoLimits
from drivers.mock.bench import ENCODER_NODE, SimulatedDbcBench, simulated_dbc_bench
from drivers.mock.dbc_drive import DRIVE_DBC
from drivers.mock.encoder import ENCODER_EDS
from drivers.mock.plant.parts.constants import Machine
from drivers.units import EncoderScales

from .contract import Rig
from .contract import enabled as enabled
from .contract import prepared as prepared
from .host import OPENED, noted_power

CYCLE_S = 0.001
ORDER = "DRV_Command.Order"


def limit(signal: str, scale: float = 1.0) -> LimitSignals:
    return LimitSignals(
        Quantity(f"DRV_Limits.{signal}", scale), Quantity(f"DRV_LimitsHeld.{signal}", scale)
    )


MAP = DbcMap(
    inputs=Inputs(
        position=Quantity("DRV_Motion.Position", math.tau),
        velocity=Quantity("DRV_Power.Velocity"),
        temperature=Quantity("DRV_Status.Temperature"),
        current=Quantity("DRV_Motion.Current"),
        voltage=Quantity("DRV_Power.Voltage"),
        supply_voltage=Quantity("DRV_Status.Supply"),
        time=Quantity("DRV_Power.Time"),
        fault_code=Quantity("DRV_Status.FaultCode"),
        serial_number=Quantity("DRV_Info.SerialNumber"),
        revision=Quantity("DRV_Info.Firmware"),
    ),
    status=Status(
        "DRV_Motion.State",
        {
            "disabled": ("OFF",),
            "ready": ("READY",),
            "running": ("RUN",),
            "stopping": ("STOPPING",),
            "fault reaction": ("BRAKING",),
            "fault": ("FAULT",),
        },
    ),
    target=Quantity("DRV_Command.TargetPosition", math.tau),
    orders=Orders(
        disable={ORDER: "OFF"},
        stop={ORDER: "STOP"},
        reset={ORDER: "RESET"},
        enable={"disabled": {ORDER: "READY"}, "ready": {ORDER: "RUN"}, "running": {ORDER: "RUN"}},
    ),
    stop_frame=StopFrame("DRV_Stop", {"Code": 165}),
    limits=LimitMap(
        angle_min=limit("AngleMin", math.tau),
        angle_max=limit("AngleMax", math.tau),
        speed=limit("Speed"),
        current=limit("Current"),
        following_error=limit("FollowingError", math.tau),
    ),
    messages={
        "DRV_Command": Protection(counter="Life", checksum="Check"),
        "DRV_Motion": Protection(counter="Life", checksum="Check"),
        "DRV_Power": Protection(counter="Life"),
        "DRV_Status": Protection(counter="Life", checksum="Check"),
    },
)
HELD = ServoLimits(-0.5236, 0.5236, 2.0944, 75.0, 25.0, 0.0349, 2, 34.9)
DRIVE = DbcDrive(Identity("house servo", 0x1234, 1, 0, 0), HELD, 100.0, 0.03, 0.0, 0.1)


@dataclass
class DbcHost(Rig):
    link: DbcLink
    servo: DbcServo
    encoder: Cia406Encoder
    bench: SimulatedDbcBench
    channel: DbcChannel
    powered: list[bool]


def make_dbc_host(
    seed: int = 1,
    spec: DbcMap = MAP,
    drive: DbcDrive = DRIVE,
    bitrate: int = 1_000_000,
    cycle_s: float = CYCLE_S,
    python_can: bool = False,
) -> DbcHost:
    """Return an open link to a booted bench; nothing is prepared."""
    bench = simulated_dbc_bench(Machine(), seed, bitrate)
    port = PythonCanPort(bench.bus, bench.clock) if python_can else bench.bus
    link = DbcLink(bench.clock, lambda: port, "simulated bus")
    channel = link.add_channel(bind(spec, read_dbc(DRIVE_DBC)), "the house servo")
    servo = DbcServo(link, channel, drive)
    encoder = Cia406Encoder(link.add_node(ENCODER_NODE, ENCODER_EDS), EncoderScales(262144))
    link.open()
    OPENED.append(link)
    powered = noted_power(bench.machine)
    return DbcHost(link, servo, encoder, cycle_s, bench, channel, powered)
