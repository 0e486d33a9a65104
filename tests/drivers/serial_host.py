"""The simulated bench behind serial lines and CAN adapters."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import can

from benchmarks.adapters import LawicelAdapter, Ports, SocketcandServer
from drivers.amt21.encoder import COUNTS_PER_TURN, Amt21Encoder, Amt21Line, EncoderLink, Gate
from drivers.can.slcan import SlcanPort
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.link import CanopenLink
from drivers.canopen.sensors import Cia406Encoder
from drivers.clock import Clock
from drivers.epos.link import FASTEST_1_S, EposSerialLink, EposSerialNode
from drivers.interfaces import Encoder, Link
from drivers.mock.bench import DRIVE_NODE, ENCODER_NODE, SimulatedBench, simulated_bench
from drivers.mock.drive import DRIVE_EDS, SimulatedEposPort
from drivers.mock.encoder import ENCODER_EDS, SimulatedAmt21
from drivers.mock.plant.parts.constants import Machine, Sensing
from drivers.mock.wires.serial_line import SimulatedLine
from drivers.serial_port import BytePort
from drivers.units import EncoderScales

from .contract import Rig
from .host import OPENED, SCALES
from .lock_step import LockStep, LockStepCan, LockStepSerial, count_socketcand, served_meanwhile

BAUD = 1_000_000
ENCODER_BAUD = 2_000_000
CYCLE_S = 0.002
GATE = Gate(speed_rad_s=10.0, acceleration_rad_s2=350.0)
MACHINE = Machine(sensing=Sensing(joint_counts_per_turn=COUNTS_PER_TURN))


@dataclass
class SerialHost(Rig):
    servo: Cia402Servo
    encoder: Amt21Encoder
    bench: SimulatedBench
    epos: EposSerialLink
    drive: EposSerialNode
    line: SimulatedLine
    encoder_line: SimulatedLine
    amt21: SimulatedAmt21


def make_serial_host(
    seed: int = 1,
    baud: int = BAUD,
    cycle_s: float = CYCLE_S,
    echo: bool = False,
    fastest_1_s: float = FASTEST_1_S,
) -> SerialHost:
    """Return an open link over simulated lines to a booted bench; nothing is prepared."""
    bench = simulated_bench(MACHINE, seed)
    line = SimulatedLine(bench.clock, baud, SimulatedEposPort(bench.bus, bench.clock, bench.drive))
    amt21 = SimulatedAmt21(bench.clock, bench.sampler)
    encoder_line = SimulatedLine(bench.clock, ENCODER_BAUD, amt21, echo)
    epos = EposSerialLink(bench.clock, lambda: line, "simulated line")
    drive = epos.add_node(DRIVE_NODE, DRIVE_EDS, fastest_1_s)
    amt21_line = Amt21Line(bench.clock, lambda: encoder_line, "simulated encoder line")
    encoder = Amt21Encoder(
        amt21_line,
        EncoderScales(COUNTS_PER_TURN),
        GATE,
        lambda: servo.sample().motor_angle_rad / SCALES.gear_ratio,
    )
    link = EncoderLink(epos, encoder, epos.call_at_instant)
    servo = Cia402Servo(drive, link, SCALES)
    link.open()
    OPENED.append(link)
    return SerialHost(link, servo, encoder, cycle_s, bench, epos, drive, line, encoder_line, amt21)


@contextmanager
def in_memory() -> Iterator[Rig]:
    host = make_serial_host()
    yield host
    host.link.close()


@contextmanager
def serial_over_pty() -> Iterator[Rig]:
    bench, ports = simulated_bench(MACHINE, 1), Ports()
    path, encoder_path = serial_ports(bench, ports)
    yield from _rig(
        ports,
        serial_devices(
            bench.clock,
            lambda: LockStepSerial(path, BAUD, LockStep(bench.clock, ports, path)),
            lambda: LockStepSerial(
                encoder_path, ENCODER_BAUD, LockStep(bench.clock, ports, encoder_path)
            ),
        ),
    )


@contextmanager
def slcan_over_pty() -> Iterator[Rig]:
    bench, ports = simulated_bench(MACHINE, 1), Ports()
    path = ports.open_pty(LawicelAdapter(bench.bus))
    step = LockStep(bench.clock, ports, path)

    def connect() -> SlcanPort:
        return SlcanPort(LockStepSerial(path, BAUD, step), bench.clock, 1_000_000)

    yield from _rig(ports, can_devices(CanopenLink(bench.clock, connect, "slcan")))


@contextmanager
def socketcand_on_loopback() -> Iterator[Rig]:
    bench, ports = simulated_bench(MACHINE, 1), Ports()
    port = ports.open_socket(SocketcandServer(bench.bus))
    step = LockStep(bench.clock, ports, port)

    def connect() -> LockStepCan:
        options = {
            "interface": "socketcand",
            "channel": "can0",
            "host": "127.0.0.1",
            "port": port,
            "tcp_tune": True,
        }
        bus = served_meanwhile(ports, lambda: can.Bus(**options))
        step.sent, step.read = step.traffic.taken, step.traffic.given
        count_socketcand(bus, step)
        return LockStepCan(bus, step)

    yield from _rig(ports, can_devices(CanopenLink(bench.clock, connect, "socketcand")))


def serial_ports(bench: SimulatedBench, ports: Ports) -> tuple[str, str]:
    """Put drive and encoder behind pseudo-terminals; returns their paths."""
    drive = ports.open_pty(SimulatedEposPort(bench.bus, bench.clock, bench.drive))
    return drive, ports.open_pty(SimulatedAmt21(bench.clock, bench.sampler))


def serial_devices(
    clock: Clock, connect: Callable[[], BytePort], connect_encoder: Callable[[], BytePort]
) -> tuple[Link, Cia402Servo, Encoder]:
    epos = EposSerialLink(clock, connect, "pty")
    line = Amt21Line(clock, connect_encoder, "encoder pty")
    encoder = Amt21Encoder(line, EncoderScales(COUNTS_PER_TURN), GATE)
    link = EncoderLink(epos, encoder, epos.call_at_instant)
    return link, Cia402Servo(epos.add_node(DRIVE_NODE, DRIVE_EDS), link, SCALES), encoder


def can_devices(link: CanopenLink) -> tuple[Link, Cia402Servo, Encoder]:
    servo = Cia402Servo(link.add_node(DRIVE_NODE, DRIVE_EDS), link, SCALES)
    encoder = Cia406Encoder(
        link.add_node(ENCODER_NODE, ENCODER_EDS), EncoderScales(COUNTS_PER_TURN)
    )
    return link, servo, encoder


def _rig(ports: Ports, devices: tuple[Link, Cia402Servo, Encoder]) -> Iterator[Rig]:
    rig = Rig(*devices, CYCLE_S)
    rig.link.open()
    try:
        yield rig
    finally:
        rig.link.close()
        ports.close()
