"""A simulated bench with the host's drivers on it, for tests."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import can

from drivers.can.port import PythonCanPort
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.eds_file import read_eds
from drivers.canopen.link import CanopenLink, CanopenNode
from drivers.canopen.motion import CyclicPosition, Motion
from drivers.canopen.sdo import ONE_AXIS, Axis
from drivers.canopen.sensors import Cia406Encoder
from drivers.interfaces import Link
from drivers.mock.bench import DRIVE_NODE, ENCODER_NODE, SimulatedBench, simulated_bench
from drivers.mock.drive import DRIVE_EDS
from drivers.mock.encoder import ENCODER_EDS, EXACT_COUNTS
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.traits import Traits, described_drive
from drivers.units import EncoderScales, ServoScales
from tests.drivers.makes import description

from .contract import Rig
from .contract import enabled as enabled
from .contract import prepared as prepared

CYCLE_S = 0.001
SCALES = ServoScales(
    counts_per_turn=4096,
    gear_ratio=100.0,
    rated_current_A=15.0,
    rated_torque_N_m=0.45,
    voltage_object=(0x2100, 0),
    temperature_object=(0x2101, 0),
    known_objects=((0x2100, 0), (0x2101, 0)),
)


def drive_eds(
    folder: Path,
    lacks: Sequence[int] = (),
    defaults: Mapping[tuple[int, int], int] | None = None,
    axis: Axis = ONE_AXIS,
    source: Path = DRIVE_EDS,
) -> Path:
    """Write the EDS of a simulated device without some objects, or of one axis of several."""
    kept, keep, at = [], True, (0, 0)
    for line in source.read_text(encoding="ascii").splitlines():
        if head := re.match(r"\[([0-9A-F]{4})(?:sub([0-9A-F]+))?\]", line):
            at = int(head[1], 16), int(head[2] or "0", 16)
        if line.startswith("["):
            keep = head is None or at[0] not in lacks
            if head and 0x6000 <= at[0] < 0x6800:
                line = line.replace(head[1], f"{at[0] + axis.object_offset:04X}")
                if axis.sub_index and line == f"[{at[0]:04X}]" and at[0] in MEMBERS:
                    number = f"[{at[0]:04X}sub{axis.sub_index}]"
                    record = f"{line}\nParameterName=Of each axis\nObjectType=0x9\n"
                    line = f"{record}\n{number}"
        if axis.sub_index and at == (0x6041, 0) and line == "DataType=0x0006":
            line = "DataType=0x0007"
        if line.startswith("DefaultValue=") and at in (defaults or {}):
            line = f"DefaultValue={(defaults or {})[at]}"
        if keep:
            kept.append(line)
    path = folder / "drive.eds"
    path.write_text("\n".join(kept) + "\n", encoding="ascii")
    return path


def make_eds(folder: Path, make: str) -> Path:
    """Write the EDS of a make's drive."""
    path = folder / "drive.eds"
    path.write_text(description(make))
    return path


MEMBERS = (0x6064, 0x606C, 0x6071, 0x6077, 0x6078, 0x607A, 0x6081, 0x60FF)
"""Objects with a member for each axis in some drives with several axes."""


OPENED: list[Link] = []
"""Links of the hosts of a test, which are closed at its end."""


@dataclass
class Host(Rig):
    servo: Cia402Servo
    encoder: Cia406Encoder
    bench: SimulatedBench
    drive: CanopenNode
    powered: list[bool]
    """Power of the machine, switched on or off."""


def noted_power(machine: SimulatedMachine) -> list[bool]:
    """Return a list that grows with each switching of the power."""
    powered, switch = list[bool](), machine.power

    def power(on: bool) -> None:
        powered.append(on)
        switch(on)

    machine.power = power  # type: ignore[method-assign]
    return powered


def make_host(
    seed: int = 1,
    machine: Machine | None = None,
    scales: ServoScales = SCALES,
    bitrate: int = 1_000_000,
    cycle_s: float = CYCLE_S,
    python_can: bool = False,
    torque_offset: bool = False,
    eds: Path | None = None,
    motion: Motion | None = None,
    traits: Traits | None = None,
    axis: Axis = ONE_AXIS,
) -> Host:
    """Return an open link to a booted bench, natively or through python-can."""
    if eds is not None:
        traits = described_drive(read_eds(eds, DRIVE_NODE), axis)
    bench = simulated_bench(machine or Machine(), seed, bitrate, traits=traits)
    port = PythonCanPort(bench.bus, bench.clock) if python_can else bench.bus
    link = CanopenLink(bench.clock, lambda: port, "simulated bus")
    drive = link.add_node(DRIVE_NODE, eds or DRIVE_EDS, axis)
    servo = Cia402Servo(drive, link, scales, motion=motion or CyclicPosition(torque_offset))
    resolution = bench.machine.constants.sensing.joint_counts_per_turn or EXACT_COUNTS
    encoder = Cia406Encoder(link.add_node(ENCODER_NODE, ENCODER_EDS), EncoderScales(resolution))
    link.open()
    OPENED.append(link)
    powered = noted_power(bench.machine)
    return Host(link, servo, encoder, cycle_s, bench, drive, powered)


def frame(identifier: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
