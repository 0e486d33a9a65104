"""Real pseudo-terminals and sockets in simulated time."""

import socket
import threading
from collections.abc import Callable, Sequence

import can

from benchmarks.adapters import Ports
from drivers.can.port import PythonCanPort
from drivers.clock import NS, SimulatedClock
from drivers.interfaces import RawFrame
from drivers.serial_port import PySerialPort

ON_THE_WAY_S = 10.0


class LockStep:
    """Moves the bytes of one port until none is on its way, then simulated time to the next
    event.
    """

    def __init__(self, clock: SimulatedClock, ports: Ports, name: str | int) -> None:
        self.clock = clock
        self.ports = ports
        self.traffic = ports.traffic[name]
        self.sent = 0
        self.read = 0

    def settle(self) -> None:
        """Have everything that the host has sent taken by the stations."""
        self.ports.serve([])
        while self.traffic.taken < self.sent:
            ready = self.ports.wait(ON_THE_WAY_S)
            assert ready, "bytes of the host were lost on the way"
            self.ports.serve(ready)

    def wait(self, timeout_s: float, look: Callable[[float], object]) -> None:
        """Let time pass until ``look(real seconds to wait)`` finds something, at most for
        ``timeout_s``.
        """
        deadline = self.clock.now_ns() + round(timeout_s * NS)
        while True:
            self.settle()
            while self.read < self.traffic.given:
                if look(ON_THE_WAY_S):
                    return
            due = self.clock.next_event_ns()
            if due is None or due > deadline:
                self.clock.sleep_until_ns(deadline)
                return
            self.clock.fire_next(deadline)


class LockStepSerial(PySerialPort):
    """A serial port of the operating system that waits in simulated time."""

    def __init__(self, path: str, baud: int, step: LockStep) -> None:
        super().__init__(path, baud)
        self._step = step

    def write(self, data: bytes) -> None:
        super().write(data)
        self._step.sent += len(data)

    def read(self, timeout_s: float) -> bytes:
        found = b""

        def look(real_s: float) -> bytes:
            nonlocal found
            found = super(LockStepSerial, self).read(real_s)
            self._step.read += len(found)
            return found

        self._step.wait(timeout_s, look)
        return found

    def discard(self) -> None:
        self._step.settle()
        while self._step.read < self._step.traffic.given:
            self._step.read += len(super().read(ON_THE_WAY_S))


class LockStepCan(PythonCanPort):
    """A bus of python-can that waits in simulated time."""

    def __init__(self, bus: can.BusABC, step: LockStep) -> None:
        super().__init__(bus, step.clock)
        self._step = step

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        found: Sequence[RawFrame] = ()

        def look(real_s: float) -> Sequence[RawFrame]:
            nonlocal found
            # Less than the whole time at once: what has come in may hold no frame.
            found = super(LockStepCan, self).collect(min(real_s, 0.001))
            return found

        self._step.wait(timeout_s, look)
        return found


def count_socketcand(bus: can.BusABC, step: LockStep) -> None:
    """Count what python-can's socketcand client sends and receives."""
    name = "_SocketCanDaemonBus__socket"
    setattr(bus, name, CountedSocket(getattr(bus, name), step))


class CountedSocket:
    def __init__(self, real: socket.socket, step: LockStep) -> None:
        self._real = real
        self._step = step
        self.fileno, self.setsockopt, self.close = real.fileno, real.setsockopt, real.close

    def sendall(self, data: bytes) -> None:
        self._step.sent += len(data)
        self._real.sendall(data)

    def recv(self, size: int) -> bytes:
        data = self._real.recv(size)
        self._step.read += len(data)
        return data


def served_meanwhile(ports: Ports, connect: Callable[[], can.BusABC]) -> can.BusABC:
    """Open a bus whose opening waits for answers."""
    opened = threading.Event()

    def serve() -> None:
        while not opened.is_set():
            ports.serve(ports.wait(0.01))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        return connect()
    finally:
        opened.set()
        thread.join()
