"""Opens the devices of a bench file on their bus; the only place where drivers are chosen."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NoReturn

import drivers.mock
from drivers.amt21.encoder import COUNTS_PER_TURN, Amt21Encoder, Amt21Line, EncoderLink, Gate
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.device_data import DeviceData
from drivers.canopen.eds_file import read_eds
from drivers.canopen.link import CanopenLink
from drivers.canopen.sensors import Cia406Encoder
from drivers.clock import Clock, RealClock, Suspension
from drivers.dbc.link import DbcLink
from drivers.dbc.servo import DbcServo
from drivers.epos.link import EposSerialLink
from drivers.errors import ConfigurationError, DeviceError, LinkError
from drivers.interfaces import Encoder, Link, PressureTransmitter, Servo
from drivers.mock.bench import (
    SimulatedBench,
    SimulatedCanBench,
    SimulatedDbcBench,
    simulated_bench,
    simulated_can_bench,
    simulated_dbc_bench,
)
from drivers.mock.drive import Rating, SimulatedEposPort
from drivers.mock.encoder import SimulatedAmt21
from drivers.mock.plant.effects.own import own_torques
from drivers.mock.plant.hosted import FmuPlant, PlantFile, python_plant
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import constants
from drivers.mock.traits import described_drive
from drivers.mock.wires.serial_line import SimulatedLine, Station
from drivers.serial_port import BytePort, PySerialPort
from drivers.units import EncoderScales
from rig.common.errors import InputError
from rig.common.locks import Resource, hold_bench
from rig.config.bench import Bench
from rig.config.canopen import Bus, EncoderSection, ServoSection
from rig.config.configuration import Document
from rig.config.dbc import DbcServoSection, dbc_path, wire
from rig.config.serial_bus import Amt21Section, SerialBus
from rig.wiring.devices import Devices, Nominal
from rig.wiring.guard import Guard
from rig.wiring.scales import encoder_scales, servo_axis, servo_motion, servo_scales

_IN_PROCESS: Final = "virtual"
"""Interface of python-can with a bus inside this process, which no other process can reach."""
_ON_SERIAL_PORTS: Final = frozenset({"slcan", "robotell", "seeedstudio", "serial"})
"""Interfaces of python-can whose channel is a serial port, as a path or as a URL of pyserial."""
_WITH_RATE: Final = frozenset({"slcan", "robotell"})
"""Interfaces of python-can whose channel may end in ``@`` and the bit rate of the port."""


def resources(bench: Bench) -> tuple[Resource, ...]:
    """Return the resources that a program must lock to use this bench; none for a simulated bench.

    All names of a device have one key in common. The key of an interface with a channel does not
    depend on the bench file.
    """
    found = [*bus_resources(bench)]
    if not bench.simulated and bench.bus and isinstance(bench.encoder, Amt21Section):
        found += _port(bench.encoder.port)
    return tuple(sorted({part.key: part for part in reversed(found)}.values()))


def bus_resources(bench: Bench) -> tuple[Resource, ...]:
    """Return those resources of a bench through which its drive is reached."""
    bus = bench.bus
    if bus is None or bench.simulated:
        return ()
    return tuple(_port(bus.port) if isinstance(bus, SerialBus) else _channel(bus))


def _channel(bus: Bus) -> list[Resource]:
    channel = bus.channel or ""
    if bus.interface == _IN_PROCESS:
        return []
    if bus.interface in _WITH_RATE:
        channel = channel.partition("@")[0]
    if "://" not in channel and (bus.interface in _ON_SERIAL_PORTS or os.sep in channel):
        return _port(channel)
    return [
        Resource(f"{bus.interface}:{channel}", f"{bus.interface} channel {channel or 'by default'}")
    ]


def _port(path: str) -> list[Resource]:
    """Return the device file behind a name, and a link itself: it may lead elsewhere later."""
    label = f"port {path}"
    try:
        real = os.path.realpath(path)
        name = os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path))
    except ValueError:
        # A text with a null character is not a path.
        return [Resource(path, label)]
    return [Resource(key, label) for key in dict.fromkeys((real, name))]


def amt21_encoder(
    section: Amt21Section,
    middle_rad: float,
    simulated: SimulatedBench | None,
    clock: Clock,
    servo: Servo,
    gear_ratio: float,
) -> Amt21Encoder:
    """Return an encoder on its line, real or simulated."""
    connect: Callable[[], BytePort]
    if simulated is None:
        connect, name = lambda: PySerialPort(section.port, section.baud), f"AMT21 at {section.port}"
    else:
        station = SimulatedAmt21(simulated.clock, simulated.sampler, section.address)
        connect, name = _simulated(simulated, "encoder", section.baud, station), "simulated AMT21"
    line = Amt21Line(clock, connect, name, section.address)
    scales = EncoderScales(
        COUNTS_PER_TURN, section.sign, math.radians(section.offset_deg), middle_rad
    )
    gate = Gate(
        math.radians(section.gate_speed_deg_s), math.radians(section.gate_acceleration_deg_s2)
    )

    def elsewhere_rad() -> float | None:
        sample = servo.sample()
        return sample.motor_angle_rad / gear_ratio if sample.fresh else None

    return Amt21Encoder(line, scales, gate, elsewhere_rad)


def _simulated(
    simulated: SimulatedBench, device: str, baud: int, station: Station
) -> Callable[[], BytePort]:
    line = simulated.lines[device] = SimulatedLine(simulated.clock, baud, station)
    return lambda: line


_EDS = Path(drivers.mock.__file__).parent
DRIVE_EDS = _EDS / "drive.eds"
ENCODER_EDS = _EDS / "encoder.eds"
TRANSMITTER_EDS = _EDS / "transmitter.eds"
_TWIN_EDS = {"servo": DRIVE_EDS, "encoder": ENCODER_EDS, "pressure": TRANSMITTER_EDS}

_ENCODER_NODES = (2, 3)
"""Node of the unused simulated CAN encoder: the first that the drive does not occupy."""
NO_BUS = (
    "this bench has no bus, so that only `rig paper` can simulate it; use another bench, such as "
    "`practical`, or add a bus"
)
_SPEED_SHARE = 2.0  # fastest plausible speed of the joint, in units of the limit of the bench file
Hang = Callable[[float], None]
Attach = Callable[[SimulatedBench | SimulatedDbcBench], Clock]
"""Function that gets a simulated bench before its bus is opened; returns the host's clock."""


@contextmanager
def connect(
    document: Document[Bench],
    seed: int,
    realtime: bool,
    attach: Attach | None = None,
    torque_offset: bool = False,
    purpose: str = "rig",
) -> Iterator[Devices]:
    """Open the bus of a bench with its devices, and close the bus at the end. No device moves.

    A real bench is locked before its bus is opened, and released after its bus is closed.

    Raises:
        InputError: The bench has no bus, or a real device has no EDS file.
        InUseError: Another program uses the bench or a part of it.
        StorageError: The bench cannot be locked.
        DeviceError: The bus cannot be opened, or the devices in the bench file conflict on the bus.
    """
    bench = document.value
    if bench.bus is None:
        raise InputError(document.problem(("bus",), NO_BUS))
    wired = _wire(document, bench.bus, seed, attach, torque_offset)
    link, guard = wired.link, wired.guard
    with hold_bench(bench.name, resources(bench), purpose) as lock:
        if guard is not None:
            guard.keep(lock.descriptors)
        link.open()
        try:
            pacer = RealClock() if realtime and bench.simulated else None
            suspension = Suspension() if realtime or not bench.simulated else None
            yield dataclasses.replace(wired, pacer=pacer, lock=lock, suspension=suspension)
        finally:
            link.close()
            if guard is not None:
                guard.close()


def _wire(
    document: Document[Bench],
    bus: Bus | SerialBus,
    seed: int,
    attach: Attach | None,
    torque_offset: bool,
) -> Devices:
    """Choose the drivers of a bench, and create its link without opening it."""
    bench = document.value
    simulated: SimulatedBench | None = None
    hang: Hang | None
    link: Link
    servo: Servo
    guard: Guard | None = None
    if isinstance(bus, SerialBus):
        link, servo, simulated, guard = _epos(document, bus, seed, attach)
        hang = None if simulated is None else simulated.machine.hang
    elif isinstance(bench.servo, DbcServoSection):
        link, servo, hang = _dbc_servo(document, bench.servo, bus, seed, attach)
    else:
        link, simulated = _link(document, bench.servo, bus, seed, attach)
        hang = None if simulated is None else simulated.machine.hang
        data = servo_data(document)
        axis = servo_axis(bench.servo, data)
        drive = link.add_node(bench.servo.node, eds_path(document, "servo"), axis)
        scales = servo_scales(bench.servo, bench.machine, data)
        motion, alone = (
            servo_motion(bench.servo, scales, data, torque_offset),
            bench.servo.stops_alone,
        )
        servo = Cia402Servo(drive, link, scales, motion=motion, stops_alone=alone)
    pressure: PressureTransmitter | None = None
    if bench.pressure is not None and isinstance(link, CanopenLink):
        pressure = bench.pressure.transmitter(
            link.add_node(bench.pressure.node, eds_path(document, "pressure"))
        )
    encoder: Encoder
    if isinstance(bench.encoder, Amt21Section):
        middle, gear = bench.limits.middle_rad, bench.machine.gear_ratio
        encoder = amt21 = amt21_encoder(bench.encoder, middle, simulated, link.clock, servo, gear)
        at_instant = link.call_at_instant if isinstance(link, EposSerialLink) else None
        link = EncoderLink(link, amt21, at_instant)
    elif isinstance(link, CanopenLink):
        node = link.add_node(bench.encoder.node, eds_path(document, "encoder"))
        encoder = Cia406Encoder(node, encoder_scales(bench.encoder, bench.limits))
    machine = None if simulated is None or pressure is None else simulated.machine
    ignite = machine.ignite if isinstance(machine, SimulatedMachine) else None
    return Devices(
        link,
        servo,
        encoder,
        hang,
        guard=guard,
        pressure=pressure,
        ignite=ignite,
        nominal=nominal_of(bench),
    )


@dataclass(frozen=True)
class BareBench:
    """Drive of a real bench, to stop it, and its joint encoder, or None without an EDS file."""

    link: Link
    servo: Servo
    encoder: Encoder | None

    def open(self) -> None:
        """Open what is not open; without the link of the drive, raise a LinkError."""
        self.link.open()
        if isinstance(self.encoder, Amt21Encoder):
            with suppress(LinkError):
                self.encoder.line.open()

    def close(self) -> None:
        """Close link and line."""
        self.link.close()
        if isinstance(self.encoder, Amt21Encoder):
            self.encoder.line.close()


def bare_bench(document: Document[Bench]) -> BareBench:
    """Return drive and joint encoder of a real bench without its other devices, which may be what
    failed. The port of the drive is opened even if another program has locked it.

    Raises:
        InputError: The drive has no EDS or DBC file.
    """
    bench = document.value
    link, servo = _bare_drive(document)
    encoder: Encoder | None = None
    if isinstance(bench.encoder, Amt21Section):
        middle, gear = bench.limits.middle_rad, bench.machine.gear_ratio
        encoder = amt21_encoder(bench.encoder, middle, None, link.clock, servo, gear)
    elif isinstance(link, CanopenLink):
        with suppress(InputError, DeviceError):
            node = link.add_node(bench.encoder.node, eds_path(document, "encoder"))
            encoder = Cia406Encoder(node, encoder_scales(bench.encoder, bench.limits))
    return BareBench(link, servo, encoder)


def _bare_drive(document: Document[Bench]) -> tuple[Link, Servo]:
    bench = document.value
    bus, section = bench.bus, bench.servo
    assert bus is not None
    if isinstance(section, DbcServoSection):
        assert isinstance(bus, Bus)
        wiring = wire(section, document.path, bench.simulated, document.problem)
        dbc = DbcLink.on_interface(RealClock(), *_interface(bus), bus_options=_shared(bus))
        drive = section.drive(bench.machine.gear_ratio, bench.machine.torque_constant_N_m_A)
        return dbc, DbcServo(dbc, dbc.add_channel(wiring, section.name), drive)
    data = servo_data(document)
    scales = servo_scales(section, bench.machine, data)
    eds = eds_path(document, "servo")
    if isinstance(bus, SerialBus):
        port, baud = bus.port, bus.baud
        line = EposSerialLink(
            RealClock(), lambda: PySerialPort(port, baud, exclusive=False), f"EPOS4 at {port}"
        )
        return line, Cia402Servo(line.add_node(section.node, eds), line, scales)
    link = CanopenLink.on_interface(RealClock(), *_interface(bus), bus_options=_shared(bus))
    motion = servo_motion(section, scales, data, False)
    node = link.add_node(section.node, eds)
    return link, Cia402Servo(node, link, scales, motion=motion, stops_alone=section.stops_alone)


def _interface(bus: Bus) -> tuple[str, str, int]:
    return bus.interface, bus.channel or "", bus.bitrate


def _shared(bus: Bus) -> dict[str, bool]:
    """Return the option by which a port is opened that another program has locked."""
    return {"exclusive": False} if bus.interface == "slcan" else {}


def _epos(
    document: Document[Bench], bus: SerialBus, seed: int, attach: Attach | None
) -> tuple[EposSerialLink, Cia402Servo, SimulatedBench | None, Guard | None]:
    """Return link and drive on a serial line, and the simulated bench or the guard."""
    bench = document.value
    assert isinstance(bench.servo, ServoSection)
    simulated, clock = _simulated_bench(document, bench.servo, 1_000_000, seed, attach)
    eds, node = eds_path(document, "servo"), bench.servo.node
    scales = servo_scales(bench.servo, bench.machine, servo_data(document))
    guard = None
    if simulated is None:
        guard = Guard(bus.port, bus.baud, node, eds, scales)
        link = EposSerialLink(clock, guard.open_port, guard.name, guard=guard)
    else:
        station = SimulatedEposPort(simulated.bus, simulated.clock, simulated.drive)
        line = _simulated(simulated, "drive", bus.baud, station)
        link = EposSerialLink(clock, line, "simulated EPOS4")
    speed = _SPEED_SHARE * math.radians(bench.limits.speed_deg_s)
    channel = link.add_node(node, eds, speed / abs(scales.joint_rad_per_count))
    return link, Cia402Servo(channel, link, scales), simulated, guard


def _simulated_bench(
    document: Document[Bench], servo: ServoSection, bitrate: int, seed: int, attach: Attach | None
) -> tuple[SimulatedBench | None, Clock]:
    """Return the simulated bench, or None for a real bench, and the host's clock."""
    bench = document.value
    if bench.mock is None or not bench.simulated:
        return None, RealClock()
    _require_own_effects(document, bench.mock)
    encoder_node = (
        bench.encoder.node
        if isinstance(bench.encoder, EncoderSection)
        else _ENCODER_NODES[servo.node == _ENCODER_NODES[0]]
    )
    transmitter_node = None if bench.pressure is None else bench.pressure.node
    rating = Rating(servo.rated_current_A, servo.rated_torque_N_m)
    traits = (
        None
        if servo.eds is None
        else described_drive(
            read_eds(eds_path(document, "servo"), servo.node), servo_axis(servo, None)
        )
    )
    simulated = simulated_bench(
        bench.mock,
        seed,
        bitrate,
        servo.node,
        encoder_node,
        transmitter_node,
        rating,
        traits,
        _plant(document),
    )
    return simulated, simulated.clock if attach is None else attach(simulated)


def _link(
    document: Document[Bench], servo: ServoSection, bus: Bus, seed: int, attach: Attach | None
) -> tuple[CanopenLink, SimulatedBench | None]:
    """Return the link, and the simulated bench behind it, or None for a real bench."""
    simulated, clock = _simulated_bench(document, servo, bus.bitrate, seed, attach)
    if simulated is not None:
        return CanopenLink(clock, lambda: simulated.bus, name="simulated bus"), simulated
    return CanopenLink.on_interface(clock, *_interface(bus)), None


def _dbc_servo(
    document: Document[Bench], servo: DbcServoSection, bus: Bus, seed: int, attach: Attach | None
) -> tuple[DbcLink, DbcServo, Hang | None]:
    """Return link and DBC drive, and the function that hangs a weight on a simulated lever."""
    bench = document.value
    wiring = wire(servo, document.path, bench.simulated, document.problem)
    hang: Hang | None = None
    if bench.mock is not None and bench.simulated:
        mock, clock = _simulated_dbc(document, bench.mock, servo, bus.bitrate, seed, attach)
        link, hang = DbcLink(clock, lambda: mock.bus, name="simulated bus"), mock.machine.hang
    else:
        link = DbcLink.on_interface(RealClock(), *_interface(bus))
    drive = servo.drive(bench.machine.gear_ratio, bench.machine.torque_constant_N_m_A)
    return link, DbcServo(link, link.add_channel(wiring, servo.name), drive), hang


def _simulated_dbc(
    document: Document[Bench],
    machine: constants.Machine,
    servo: DbcServoSection,
    bitrate: int,
    seed: int,
    attach: Attach | None,
) -> tuple[SimulatedDbcBench | SimulatedCanBench, Clock]:
    """Return the simulated bench of a DBC drive, and the host's clock."""
    encoder = document.value.encoder
    assert isinstance(encoder, EncoderSection)
    _require_own_effects(document, machine)
    kind = servo.simulated_drive
    plant = _plant(document)
    if kind is None:
        house = simulated_dbc_bench(machine, seed, bitrate, encoder.node, plant)
        return house, house.clock if attach is None else attach(house)
    if attach is not None:
        text = "fault schedules work with the drive of `practical_dbc` only; leave this key out"
        raise InputError(document.problem(("servo", "simulated_drive"), text))
    bench = simulated_can_bench(kind, machine, seed, bitrate, encoder.node, plant)
    return bench, bench.clock


def _require_own_effects(document: Document[Bench], machine: constants.Machine) -> None:
    """Try the functions of the file with effects of the user; InputError if one fails."""
    try:
        own_torques(machine)
    except ConfigurationError as error:
        raise InputError(document.problem(("mock", "effects_file"), str(error))) from error


def _plant(document: Document[Bench]) -> PlantFile | None:
    """Load the machine that takes the place of the own one; InputError if it cannot be used."""
    mock, path = document.value.mock, plant_file(document)
    if mock is None or path is None:
        return None
    name = mock.plant.get("class")
    try:
        return PlantFile(FmuPlant(path), path) if name is None else python_plant(path, name)
    except ConfigurationError as error:
        raise InputError(document.problem(("mock", "plant"), str(error))) from error


def plant_file(document: Document[Bench]) -> Path | None:
    """Return the file of the machine that takes the place of the own one, or None."""
    bench = document.value
    if bench.mock is None or not bench.mock.plant or not bench.simulated:
        return None
    return document.path.parent / (bench.mock.plant.get("fmu") or bench.mock.plant["python"])


def never_opened() -> NoReturn:
    """Stand for the bus of a link on which devices are only declared."""
    raise AssertionError("the files of this bench are only read, and its bus must not be opened")


def nominal_of(bench: Bench) -> Nominal:
    """Return the constants of a bench with which its motions are compared.

    Rated values with the defaults of the bench file are left out, because these are not the values
    of this motor.
    """
    machine, servo = bench.machine, bench.servo
    stated = servo.model_fields_set
    own = isinstance(servo, ServoSection) and {"rated_current_A", "rated_torque_N_m"} <= stated
    return Nominal(
        machine.torque_constant_N_m_A,
        machine.gear_ratio,
        getattr(servo, "rated_current_A", None) if own else None,
        getattr(servo, "rated_torque_N_m", None) if own else None,
        bench.encoder.sign,
        getattr(servo, "current_sign", None),
        machine.back_emf_constant_V_s_rad,
    )


def device_files(document: Document[Bench]) -> dict[str, Path]:
    """Return device and machine files by name; InputError if a real device lacks its EDS."""
    bench = document.value
    found = {}
    if (plant := plant_file(document)) is not None:
        found["mock.plant"] = plant
    if isinstance(bench.servo, DbcServoSection):
        found["servo.dbc"] = dbc_path(bench.servo, document.path)
    else:
        found["servo.eds"] = eds_path(document, "servo")
    if isinstance(bench.encoder, EncoderSection):
        found["encoder.eds"] = eds_path(document, "encoder")
    if bench.pressure is not None:
        found["pressure.eds"] = eds_path(document, "pressure")
    return found


def servo_data(document: Document[Bench]) -> DeviceData | None:
    """Return the maker's data of the bench's drive, or None."""
    servo = document.value.servo
    return servo.device_data(document.path.parent) if isinstance(servo, ServoSection) else None


def eds_path(document: Document[Bench], section: Literal["servo", "encoder", "pressure"]) -> Path:
    """Return the EDS file of a device: for a simulated device the packaged file, for a real device
    the file that the bench file names.

    Raises:
        InputError: A real device has no EDS file.
    """
    bench = document.value
    named: str | None = getattr(bench, section).eds
    if named is not None:
        return document.path.parent / named
    if not bench.simulated:
        text = "missing; name the EDS file of the real device's maker, relative to this file"
        raise InputError(document.problem((section, "eds"), text))
    return _TWIN_EDS[section]
