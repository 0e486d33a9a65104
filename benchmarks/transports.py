"""Cycles per second and lateness on each transport, beside a bare sleeping loop in the same run.

The simulated devices live in a process of their own, behind pseudo-terminals and a loopback socket,
in real time. The drive is prepared but not enabled, which makes no difference to the traffic.
``time.sleep`` is ``clock_nanosleep`` on Linux. The simulated buses have no real time to be late in;
they show what the host's own code takes, plant included.

At the end ``rig run --realtime`` runs a whole sequence over slcan, and its own report of its timing
is printed.

    python benchmarks/transports.py --seconds 5
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
from collections.abc import Callable
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from io import StringIO
from multiprocessing.connection import Connection
from pathlib import Path
from time import perf_counter

import numpy as np
from adapters import LawicelAdapter, RealTimeBench, SocketcandServer

from drivers.amt21.encoder import COUNTS_PER_TURN, Amt21Encoder, Amt21Line, EncoderLink, Gate
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.link import CanopenLink
from drivers.canopen.sensors import Cia406Encoder
from drivers.clock import NS, Clock, RealClock
from drivers.epos.link import EposSerialLink
from drivers.errors import DeviceError
from drivers.interfaces import Encoder, Link
from drivers.mock.bench import DRIVE_NODE, ENCODER_NODE, simulated_bench
from drivers.mock.drive import DRIVE_EDS, SimulatedEposPort
from drivers.mock.encoder import ENCODER_EDS, SimulatedAmt21
from drivers.mock.plant.parts.constants import Machine, Sensing
from drivers.serial_port import PySerialPort
from drivers.units import EncoderScales, ServoScales
from rig.cli.entry import status
from rig.common.tables import table
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.wiring.connect import connect

SCALES = ServoScales(
    counts_per_turn=4096, gear_ratio=100.0, rated_current_A=15.0, rated_torque_N_m=0.45
)
MACHINE = Machine(sensing=Sensing(joint_counts_per_turn=COUNTS_PER_TURN))
FREE_CYCLES = 1000
SEQUENCE = """\
sequence: 1
name: short
stages:
  - {name: sine, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 0.5}], duration_s: 4}
"""
Devices = tuple[Link, Cia402Servo, Encoder]
Ports = list[str | int]


def serve(kind: str, wire: Connection) -> None:
    """Let the devices live until told to stop; the body of the child process."""
    bench = simulated_bench(MACHINE, 1)
    bench.sampler.advance(bench.machine.loop_ns)
    served = RealTimeBench(bench.clock)
    ports: Ports
    match kind:
        case "serial":
            drive = served.open_pty(SimulatedEposPort(bench.bus, bench.clock, bench.drive))
            ports = [drive, served.open_pty(SimulatedAmt21(bench.clock, bench.sampler))]
        case "slcan":
            ports = [served.open_pty(LawicelAdapter(bench.bus))]
        case _:
            ports = [served.open_socket(SocketcandServer(bench.bus))]
    with served:
        wire.send(ports)
        wire.recv()


@contextmanager
def devices(kind: str):
    """Yield the host's devices on a transport."""
    ours, theirs = multiprocessing.Pipe()
    child = multiprocessing.get_context("spawn").Process(target=serve, args=(kind, theirs))
    child.start()
    try:
        made = _serial(ours.recv()) if kind == "serial" else _can(kind, ours.recv())
        made[0].open()
        try:
            yield made
        finally:
            made[0].close()
    finally:
        ours.send(None)
        child.join()


def _serial(ports: Ports) -> Devices:
    clock = RealClock()
    epos = EposSerialLink(clock, lambda: PySerialPort(str(ports[0]), 1_000_000))
    line = Amt21Line(clock, lambda: PySerialPort(str(ports[1]), 2_000_000), "encoder")
    encoder = Amt21Encoder(line, EncoderScales(COUNTS_PER_TURN), Gate(10.0, 350.0))
    link = EncoderLink(epos, encoder, epos.call_at_instant)
    return link, Cia402Servo(epos.add_node(DRIVE_NODE, DRIVE_EDS), link, SCALES), encoder


def _can(kind: str, ports: Ports) -> Devices:
    slcan = kind == "slcan"
    options = (
        {"sleep_after_open": 0, "timeout": 1e-4}
        if slcan
        else {"host": "127.0.0.1", "port": ports[0]}
    )
    options |= {} if slcan else {"tcp_tune": True}
    link = CanopenLink.on_interface(
        RealClock(), kind, str(ports[0]) if slcan else "can0", 1_000_000, options
    )
    servo = Cia402Servo(link.add_node(DRIVE_NODE, DRIVE_EDS), link, SCALES)
    return (
        link,
        servo,
        Cia406Encoder(link.add_node(ENCODER_NODE, ENCODER_EDS), EncoderScales(COUNTS_PER_TURN)),
    )


def paced(clock: Clock, cycle_s: float, seconds: float, work: Callable[[], None]) -> np.ndarray:
    """Do ``work`` once a cycle; return how late each began, s.

    A late one moves the next ones back.
    """
    late = []
    due = clock.now_ns()
    for _ in range(round(seconds / cycle_s)):
        due += round(cycle_s * NS)
        clock.sleep_until_ns(due)
        begin = clock.now_ns()
        late.append((begin - due) / NS)
        due = max(due, begin - round(cycle_s * NS))
        work()
    return np.array(late)


def measure(kind: str, cycle_s: float, seconds: float) -> list[str]:
    """Return a row: cycles per second without pause, lateness when paced, incomplete cycles."""
    with devices(kind) as (link, servo, encoder):
        servo.prepare(cycle_s)
        encoder.prepare(cycle_s)
        lost = 0

        def work() -> None:
            nonlocal lost
            link.exchange()
            lost += not (servo.sample().fresh and encoder.sample().fresh)
            link.take_frames()

        began = perf_counter()
        for _ in range(FREE_CYCLES):
            work()
        free = FREE_CYCLES / (perf_counter() - began)
        lost = 0
        late = paced(link.clock, cycle_s, seconds, work)
    return [f"{free:.0f}", *_lateness(late), f"{lost} of {len(late)}"]


def simulated(name: str) -> str:
    """Return cycles per second on a packaged bench in simulated time."""
    document = load_bench(name)
    with connect(document, 0, realtime=False) as devices:
        cycle_s = document.value.cycle_s
        devices.servo.prepare(cycle_s)
        devices.encoder.prepare(cycle_s)
        clock = devices.link.clock
        due = clock.now_ns()
        began = perf_counter()
        for _ in range(FREE_CYCLES):
            due += round(cycle_s * NS)
            clock.sleep_until_ns(due)
            devices.link.exchange()
            devices.link.take_frames()
        return f"{FREE_CYCLES / (perf_counter() - began):.0f}"


def whole_run() -> tuple[int, str]:
    """Run a sequence over slcan in real time; return exit status and what it says."""
    ours, theirs = multiprocessing.Pipe()
    child = multiprocessing.get_context("spawn").Process(target=serve, args=("slcan", theirs))
    child.start()
    try:
        (terminal,) = ours.recv()
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "sequence.yaml").write_text(SEQUENCE)
            (folder / "bench.yaml").write_text(slcan_bench(str(terminal)))
            words = [
                "run",
                str(folder / "sequence.yaml"),
                "--bench",
                str(folder / "bench.yaml"),
                "--realtime",
                "--yes",
            ]
            said = StringIO()
            with redirect_stdout(said), redirect_stderr(said):
                code = status([*words, "--no-first-pass", "--out", str(folder / "run")])
            return code, said.getvalue()
    finally:
        ours.send(None)
        child.join()


def slcan_bench(terminal: str) -> str:
    """Return the practical bench behind an slcan adapter, with a cycle and time limits for a
    machine that is shared.
    """
    text = resolve("practical", "benches").read_text().split("mock:  ")[0]
    changes = {
        "interface: mock": f"interface: slcan, channel: {terminal}",
        "cycle_Hz: 1000": "cycle_Hz: 250",
        "sample_age_ms: 5": "sample_age_ms: 90",
        "lateness_ms: 25": "lateness_ms: 50",
        "counts_per_turn: 262144": f"counts_per_turn: {COUNTS_PER_TURN}",
        "servo: {": f"servo: {{eds: {DRIVE_EDS}, ",
        "encoder: {": f"encoder: {{eds: {ENCODER_EDS}, ",
    }
    for here, there in changes.items():
        text = text.replace(here, there)
    return text


def _lateness(late: np.ndarray) -> list[str]:
    return [
        f"{1e3 * value:.2f}" for value in (np.median(late), np.quantile(late, 0.99), late.max())
    ]


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=5.0)
    seconds = parser.parse_args().seconds
    cases = [
        ("EPOS serial and AMT21 over ptys", "serial", 0.002),
        ("CANopen over slcan on a pty", "slcan", 0.002),
        ("CANopen over socketcand on loopback", "socketcand", 0.001),
    ]
    rows = []
    for name, kind, cycle_s in cases:
        bare = paced(RealClock(), cycle_s, seconds, lambda: None)
        rows.append([f"bare loop at {1 / cycle_s:g} Hz", "", *_lateness(bare), ""])
        try:
            measured = measure(kind, cycle_s, seconds)
        except DeviceError as error:
            # On a machine that is too busy a limit on silence is met; the other transports are
            # measured all the same.
            measured = ["", "", "", "", str(error)]
        rows.append([f"{name} at {1 / cycle_s:g} Hz", *measured])
    for name, bench in (
        ("CANopen", "practical"),
        ("EPOS serial and AMT21", "practical_serial"),
        ("DBC", "practical_dbc"),
    ):
        rows.append([f"{name}, in simulated time", simulated(bench), *[""] * 4])
    print(
        table(["loop", "cycles/s unpaced", "late p50 ms", "p99 ms", "worst ms", "incomplete"], rows)
    )
    code, words = whole_run()
    print(f"rig run --realtime over slcan at 250 Hz, exit status {code}:\n{words}")


if __name__ == "__main__":
    main()
