"""The servo contract on every transport; on pseudo-terminals and sockets with real bytes in
simulated time.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from benchmarks.adapters import RealTimeBench
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.clock import NS, RealClock
from drivers.epos.link import EposSerialLink
from drivers.errors import LinkError
from drivers.interfaces import ServoState
from drivers.mock.bench import DRIVE_NODE, simulated_bench
from drivers.mock.drive import DRIVE_EDS
from drivers.mock.epos_serial import SimulatedEposPort
from drivers.serial_port import PySerialPort

from .contract import Rig, ServoContract
from .host import SCALES
from .serial_host import (
    BAUD,
    CYCLE_S,
    MACHINE,
    in_memory,
    serial_over_pty,
    slcan_over_pty,
    socketcand_on_loopback,
)


class TestTransports(ServoContract):
    @pytest.fixture(params=[in_memory, serial_over_pty, slcan_over_pty, socketcand_on_loopback])
    def rig(self, request: pytest.FixtureRequest) -> Iterator[Rig]:
        with request.param() as rig:
            yield rig


def test_the_twin_lives_in_real_time_behind_pyserial() -> None:
    """Short, and patient: how long a busy machine lets a process wait is not what is tested."""
    bench = simulated_bench(MACHINE, 1)
    simulated = RealTimeBench(bench.clock)
    path = simulated.open_pty(SimulatedEposPort(bench.bus, bench.clock, bench.drive))
    clock = RealClock()
    link = EposSerialLink(
        clock, lambda: PySerialPort(path, BAUD), "pty", answer_s=5.0, silence_s=5.0
    )
    servo = Cia402Servo(link.add_node(DRIVE_NODE, DRIVE_EDS), link, SCALES, state_timeout_s=5.0)
    began = clock.now_ns()
    with simulated:
        link.open()
        servo.prepare(CYCLE_S)
        servo.enable()
        while not servo.sample().fresh or clock.now_ns() - began < NS // 5:
            link.exchange()
        assert servo.state() is ServoState.OPERATION_ENABLED
        servo.disable()
        assert servo.state() is ServoState.SWITCH_ON_DISABLED
        link.close()
    lived = bench.clock.now_ns() / NS
    assert 0.2 <= lived <= (clock.now_ns() - began) / NS + 0.01
    with pytest.raises(LinkError, match="cannot be opened"):
        link.open()
