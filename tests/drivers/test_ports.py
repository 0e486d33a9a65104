"""The contract of the ports on all of them."""

import os
import select
from collections.abc import Iterator

import can
import pytest

from benchmarks.adapters import LawicelAdapter
from drivers.can import slcan
from drivers.can.port import PythonCanPort
from drivers.can.slcan import SlcanPort
from drivers.clock import NS, RealClock, SimulatedClock
from drivers.mock.wires.bus import SimulatedBus
from drivers.mock.wires.serial_line import SimulatedLine
from drivers.serial_port import InheritedPort, PySerialPort

from .host import frame
from .port_contract import IDENTIFIER, BytePortContract, FarBus, FarLine, FramePortContract
from .pty_line import Pty, pty_line


class Ear:
    """A station that says nothing."""

    def __init__(self) -> None:
        self.heard = b""

    def receive(self, data: bytes) -> bytes:
        self.heard += data
        return b""


def far_end(far: Pty, port: PySerialPort | InheritedPort) -> FarLine:
    def say(data: bytes) -> None:
        far.say(data)
        # The kernel hands bytes over in its own time, all that were written at once together.
        assert select.select([port.fileno()], [], [], 1.0)[0]

    return FarLine(port, say, far.heard)


class TestSimulatedLine(BytePortContract):
    @pytest.fixture
    def line(self) -> FarLine:
        clock, ear = SimulatedClock(), Ear()
        port = SimulatedLine(clock, 1_000_000, ear)

        def heard() -> bytes:
            clock.sleep_until_ns(clock.now_ns() + NS)
            return ear.heard

        return FarLine(port, lambda data: port.deliver(data, False), heard)


class TestPySerialPort(BytePortContract):
    @pytest.fixture
    def line(self) -> Iterator[FarLine]:
        with pty_line() as far:
            port = PySerialPort(far.path, 115_200)
            yield far_end(far, port)
            port.close()


class TestInheritedPort(BytePortContract):
    @pytest.fixture
    def line(self) -> Iterator[FarLine]:
        with pty_line() as far:
            port = InheritedPort(os.dup(far.theirs))
            yield far_end(far, port)
            port.close()


class Listener:
    """Another controller on the simulated bus."""

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock) -> None:
        self._clock = clock
        self._port = bus.attach()
        self._heard: list[bytes] = []
        self._port.listen(IDENTIFIER, self._heard.append)

    def say(self, data: bytes) -> None:
        self._port.send(IDENTIFIER, data)

    def heard(self) -> list[bytes]:
        self._clock.sleep_until_ns(self._clock.now_ns() + NS)
        return self._heard


class TestSimulatedBus(FramePortContract):
    @pytest.fixture(params=[False, True], ids=["natively", "through python-can"])
    def wire(self, request: pytest.FixtureRequest) -> Iterator[FarBus]:
        clock = SimulatedClock()
        bus = SimulatedBus(clock)
        other = Listener(bus, clock)
        port = PythonCanPort(bus, clock) if request.param else bus
        yield FarBus(port, other.say, other.heard)
        bus.shutdown()


class TestAnInterfaceOfPythonCan(FramePortContract):
    @pytest.fixture
    def wire(self) -> Iterator[FarBus]:
        with can.Bus(interface="virtual", channel="far") as far:
            port = PythonCanPort(can.Bus(interface="virtual", channel="far"), RealClock())

            def heard() -> list[bytes]:
                return [bytes(message.data) for message in iter(lambda: far.recv(0.0), None)]

            yield FarBus(port, lambda data: far.send(frame(IDENTIFIER, data)), heard)
            port.shutdown()


class TestSlcanOnASimulatedLine(FramePortContract):
    @pytest.fixture
    def wire(self) -> Iterator[FarBus]:
        clock = SimulatedClock()
        bus = SimulatedBus(clock)
        other = Listener(bus, clock)
        adapter = LawicelAdapter(bus)
        line = SimulatedLine(clock, 1_000_000, adapter)
        port = SlcanPort(line, clock, bus.bitrate)
        clock.sleep_until_ns(NS)

        def say(data: bytes) -> None:
            other.say(data)
            clock.sleep_until_ns(clock.now_ns() + NS // 1000)
            line.deliver(adapter.receive(b""), False)

        yield FarBus(port, say, other.heard)
        bus.shutdown()


class TestSlcanOnAPty(FramePortContract):
    @pytest.fixture
    def wire(self) -> Iterator[FarBus]:
        with pty_line() as far:
            port = SlcanPort(PySerialPort(far.path, 115_200), RealClock(), 1_000_000)
            assert far.heard() == b"C\rC\rS8\rO\r"

            def heard() -> list[bytes]:
                lines = far.heard().decode().split("\r")
                assert lines.pop() == ""
                assert {text[:4] for text in lines} == {f"t{IDENTIFIER:X}"}
                return [bytes.fromhex(text[5:]) for text in lines]

            yield FarBus(port, lambda data: far.say(slcan.encode(IDENTIFIER, data)), heard)
            port.shutdown()
