"""A run over real pseudo-terminals and sockets gives the very samples of the simulated bus or
line.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import can
import numpy as np
import pytest

from benchmarks.adapters import LawicelAdapter, Ports, SocketcandServer
from drivers.can.slcan import SlcanPort
from drivers.canopen.link import CanopenLink
from drivers.mock.bench import SimulatedBench
from drivers.mock.wires.serial_line import Station
from drivers.serial_port import BytePort
from rig.cli.entry import status
from rig.runs.mcap.reader import read_run
from rig.wiring import connect

from ..drivers.lock_step import (
    LockStep,
    LockStepCan,
    LockStepSerial,
    count_socketcand,
    served_meanwhile,
)

SEQUENCE = """\
sequence: 1
name: short
stages:
  - {name: heavy, stage: loaded, weight_kg: 10, tones: [{amplitude_deg: 4, frequency_Hz: 1}],
     duration_s: 0.3,
     center_deg: 2, ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.02}
"""
LINES = ("EPOS serial, AMT21", "slcan on a pty", "socketcand on loopback")
_ADAPTER_BAUD = 115_200


@contextlib.contextmanager
def wired(transport: str) -> Iterator[None]:
    """Put real pseudo-terminals or sockets between the host and the simulated bench, where the
    transport has any.
    """
    ports = Ports()
    with contextlib.ExitStack() as stack:
        stack.callback(ports.close)
        if transport == "EPOS serial, AMT21":
            stack.enter_context(patch.object(connect, "_simulated", _over_ptys(ports)))
        elif transport in LINES:
            over = _over_slcan(ports) if transport == "slcan on a pty" else _over_socketcand(ports)
            stack.enter_context(patch.object(connect, "_link", over))
        yield


def _over_ptys(
    ports: Ports,
) -> Callable[[SimulatedBench, str, int, Station], Callable[[], BytePort]]:
    def line(
        simulated: SimulatedBench, _name: str, baud: int, station: Station
    ) -> Callable[[], BytePort]:
        path = ports.open_pty(station)
        return lambda: LockStepSerial(path, baud, LockStep(simulated.clock, ports, path))

    return line


def _over_slcan(ports: Ports) -> Callable[..., tuple[CanopenLink, SimulatedBench]]:
    def link(
        bench: Any, servo: Any, bus: Any, seed: int, attach: Any
    ) -> tuple[CanopenLink, SimulatedBench]:
        simulated, clock = connect._simulated_bench(bench, servo, bus.bitrate, seed, attach)
        assert simulated is not None
        path = ports.open_pty(LawicelAdapter(simulated.bus))
        step = LockStep(simulated.clock, ports, path)

        def adapter() -> SlcanPort:
            return SlcanPort(
                LockStepSerial(path, _ADAPTER_BAUD, step), simulated.clock, bus.bitrate
            )

        return CanopenLink(clock, adapter, "slcan"), simulated

    return link


def _over_socketcand(ports: Ports) -> Callable[..., tuple[CanopenLink, SimulatedBench]]:
    def link(
        bench: Any, servo: Any, bus: Any, seed: int, attach: Any
    ) -> tuple[CanopenLink, SimulatedBench]:
        simulated, clock = connect._simulated_bench(bench, servo, bus.bitrate, seed, attach)
        assert simulated is not None
        port = ports.open_socket(SocketcandServer(simulated.bus))
        step = LockStep(simulated.clock, ports, port)
        options = {
            "interface": "socketcand",
            "channel": "can0",
            "host": "127.0.0.1",
            "port": port,
            "tcp_tune": True,
        }

        def client() -> LockStepCan:
            opened = served_meanwhile(ports, lambda: can.Bus(**options))
            step.sent, step.read = step.traffic.taken, step.traffic.given
            count_socketcand(opened, step)
            return LockStepCan(opened, step)

        return CanopenLink(clock, client, "socketcand"), simulated

    return link


@pytest.mark.parametrize("transport", ["slcan on a pty", "socketcand on loopback"])
def test_the_same_samples(tmp_path: Path, transport: str) -> None:
    (tmp_path / "s.yaml").write_text(SEQUENCE)
    for name, wire in (("plain", "CANopen"), ("wired", transport)):
        with wired(wire):
            assert (
                status(["run", str(tmp_path / "s.yaml"), "--yes", "--out", str(tmp_path / name)])
                == 0
            )
    plain, over = (
        read_run(tmp_path / name / "recording.mcap").samples for name in ("plain", "wired")
    )
    assert len(plain["time"]) > 300
    for field in (
        "time",
        "command",
        "angle",
        "motor_angle",
        "current",
        "velocity",
        "statusword",
        "fresh",
    ):
        np.testing.assert_array_equal(plain[field], over[field])


def test_an_epos_and_an_amt21_on_pseudo_terminals(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(SEQUENCE)
    out = tmp_path / "out"
    with wired("EPOS serial, AMT21"):
        assert (
            status(
                [
                    "run",
                    str(tmp_path / "s.yaml"),
                    "--bench",
                    "practical_serial",
                    "--yes",
                    "--out",
                    str(out),
                ]
            )
            == 0
        )
    samples = read_run(out / "recording.mcap").samples
    moving = samples["segment"] == 1
    assert samples["fresh"][moving].all()
    assert np.abs(samples["angle"] - samples["command"])[moving].max() < np.radians(1.0)


@pytest.mark.parametrize(
    ("transport", "bench"),
    [
        ("slcan on a pty", "practical"),
        ("socketcand on loopback", "practical"),
        ("EPOS serial, AMT21", "practical_serial"),
    ],
)
def test_a_bench_is_checked_over_its_wire(
    capsys: pytest.CaptureFixture[str], transport: str, bench: str
) -> None:
    with wired(transport):
        assert status(["check", bench]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[-2:] for line in lines if line.startswith("supply voltage ")] == [
        ["60.0", "V"]
    ]
    assert lines[-1] == "verdict: good: a run would start"
