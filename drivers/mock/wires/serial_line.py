"""A serial line in simulated time, on which each byte takes its time at the bit rate."""

from __future__ import annotations

import os
import select
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, Self

from drivers.clock import NS, RealClock, SimulatedClock

ByteFilter = Callable[[int, bytes, bool], bytes]
"""Function of (time in ns, bytes, whether the host sent them) that returns the bytes to deliver."""

_BITS_PER_BYTE = 10


class Station(Protocol):
    """The device at the other end of a line."""

    def receive(self, data: bytes) -> bytes:
        """Process received bytes, which may be empty, and return the answer or unsolicited bytes
        that are due.
        """
        ...


class SimulatedLine:
    """The line with the interface of the host: a :class:`~drivers.serial_port.BytePort`.

    To read advances the clock.

    A message arrives as a whole at the time of its last byte, and the station answers at this time.

    Args:
        clock: Simulated time.
        baud: Bit rate, bit/s, with 8N1.
        station: The device at the far end.
        echo: Whether the host's adapter returns the bytes that it sends (echo).

    Attributes:
        station: The device at the far end.
        filters: Hooks for fault injection, applied in order to every message.
        cut: Whether the line is unplugged, so that nothing arrives in either direction.
    """

    def __init__(
        self, clock: SimulatedClock, baud: int, station: Station, echo: bool = False
    ) -> None:
        self.station = station
        self.filters: list[ByteFilter] = []
        self.cut = False
        self._clock = clock
        self._byte_ns = _BITS_PER_BYTE * NS // baud
        self._echo = echo
        self._received = b""
        self._free_ns = 0
        self._closed = False

    def write(self, data: bytes) -> None:
        """Send bytes after the bytes that are still being sent.

        Raises:
            OSError: The line is closed.
        """
        self._require_open()
        arrival = max(self._clock.now_ns(), self._free_ns) + len(data) * self._byte_ns
        self._free_ns = arrival
        self._clock.call_at(arrival, lambda: self._arrived(data))

    def read(self, timeout_s: float) -> bytes:
        """Return the received bytes; if there is none, simulated time advances until a byte
        arrives.

        Raises:
            OSError: The line is closed.
        """
        self._require_open()
        clock = self._clock
        deadline = clock.now_ns() + round(timeout_s * NS)
        while not self._received:
            due = clock.next_event_ns()
            if due is None or due > deadline:
                clock.sleep_until_ns(deadline)
                return b""
            clock.fire_next(deadline)
        data, self._received = self._received, b""
        return data

    def discard(self) -> None:
        """Discard the received bytes."""
        self._require_open()
        self._received = b""

    def close(self) -> None:
        """Close the line."""
        self._closed = True

    def deliver(self, data: bytes, from_host: bool) -> None:
        """Deliver a message to its receiver without the filters; the answer passes the filters."""
        if self.cut:
            return
        if not from_host:
            self._received += data
            return
        answer = self.station.receive(data)
        if answer:
            due = self._clock.now_ns() + len(answer) * self._byte_ns
            self._clock.call_at(due, lambda: self.deliver(self._filtered(answer, False), False))

    def _arrived(self, data: bytes) -> None:
        if self._echo:
            self._received += data
        self.deliver(self._filtered(data, True), True)

    def _filtered(self, data: bytes, from_host: bool) -> bytes:
        for change in self.filters:
            data = change(self._clock.now_ns(), data, from_host)
        return data

    def _require_open(self) -> None:
        if self._closed:
            raise OSError("the simulated line is closed")


_CHUNK: Final = 4096
_IDLE_S: Final = 0.05


@dataclass
class Traffic:
    """Counts of bytes that a station has received from the host program and sent to it."""

    station: Station
    taken: int = 0
    given: int = 0


class Ports:
    """Pseudo-terminals and sockets with a station behind each.

    Attributes:
        traffic: Byte counts of each port, by the path or number that the host program opens.
    """

    def __init__(self) -> None:
        self.traffic: dict[str | int, Traffic] = {}
        self._stations: dict[int, Traffic] = {}
        self._listeners: dict[int, tuple[socket.socket, Traffic | Callable[[], Station]]] = {}
        self._owned: list[int] = []
        self._ends: dict[str | int, list[int]] = {}

    def open_pty(self, station: Station) -> str:
        """Connect a station to a pseudo-terminal; return the path that the host program opens.

        Bytes are lost if the host does not read and the buffer is full, as in a real adapter.
        """
        # Imported here, because Windows has no pseudo-terminals.
        import pty
        import tty

        ours, theirs = pty.openpty()
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        # The other end stays open in this process too, so that the host may close and open the port
        # again.
        self._owned += [ours, theirs]
        path = os.ttyname(theirs)
        self._ends[path] = [ours, theirs]
        self._stations[ours] = self.traffic[path] = Traffic(station)
        return path

    def open_socket(self, station: Station) -> int:
        """Connect a station to a TCP port of 127.0.0.1 that serves one connection; return the port
        number.
        """
        listener = socket.create_server(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        self.traffic[port] = traffic = Traffic(station)
        self._listeners[listener.fileno()] = listener, traffic
        return port

    def open_server(self, connected: Callable[[], Station]) -> int:
        """Accept any number of connections to a TCP port of 127.0.0.1; return the port number.

        Args:
            connected: Function that is called at each connection and returns the station for it.
        """
        listener = socket.create_server(("127.0.0.1", 0))
        port: int = listener.getsockname()[1]
        self._listeners[listener.fileno()] = listener, connected
        self._ends[port] = []
        return port

    def unplug(self, name: str | int) -> None:
        """Remove a pseudo-terminal or server; open ports of the host program fail from now on."""
        for number, (listener, _) in list(self._listeners.items()):
            if listener.getsockname()[1] == name:
                del self._listeners[number]
                listener.close()
        for descriptor in self._ends.pop(name, []):
            self._stations.pop(descriptor, None)
            if descriptor in self._owned:
                self._owned.remove(descriptor)
                os.close(descriptor)

    def babble(self, name: str | int, data: bytes) -> None:
        """Send bytes to the host program that no station has sent."""
        for descriptor in self._ends[name]:
            if descriptor in self._stations:
                _write(descriptor, data)

    def close(self) -> None:
        """Close all ports; the method may be called twice."""
        for listener, _ in self._listeners.values():
            listener.close()
        for descriptor in self._owned:
            os.close(descriptor)
        self._owned, self._stations, self._listeners, self._ends = [], {}, {}, {}

    def wait(self, timeout_s: float, *others: int) -> list[int]:
        """Return the ports and members of ``others`` that become readable within the time-out."""
        ready, _, _ = select.select([*others, *self._stations, *self._listeners], [], [], timeout_s)
        return ready

    def serve(self, ready: list[int]) -> None:
        """Transfer bytes from the host program to the stations and back."""
        for descriptor in ready:
            if descriptor in self._listeners:
                self._accept(descriptor)
        for descriptor, traffic in list(self._stations.items()):
            self._move(descriptor, traffic, descriptor in ready)

    def _accept(self, descriptor: int) -> None:
        listener, behind = self._listeners[descriptor]
        connection, _ = listener.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._owned.append(connection.fileno())
        if isinstance(behind, Traffic):
            del self._listeners[descriptor]
            listener.close()
            self._stations[connection.detach()] = behind
        else:
            self._ends[listener.getsockname()[1]].append(connection.fileno())
            self._stations[connection.detach()] = Traffic(behind())

    def _move(self, descriptor: int, traffic: Traffic, readable: bool) -> None:
        try:
            data = os.read(descriptor, _CHUNK) if readable else b""
            if readable and not data:
                raise ConnectionResetError
            traffic.taken += len(data)
            answer = traffic.station.receive(data)
            traffic.given += len(answer)
            _write(descriptor, answer)
        except OSError:
            # The host program has ended, but its devices continue to run.
            del self._stations[descriptor]


def _write(descriptor: int, data: bytes) -> None:
    """Write as many bytes as the buffer accepts."""
    try:
        while data:
            data = data[os.write(descriptor, data) :]
    except BlockingIOError:
        return


class RealTimeBench(Ports):
    """Ports whose devices run in real time, in a separate thread.

    The devices continue to run while the host program computes, hangs or, in another process, has
    ended. The class is a context manager; open the ports before entering it.

    Args:
        clock: Clock of the simulated devices; this class advances it with the real clock, and no
            other code may advance it.
    """

    def __init__(self, clock: SimulatedClock) -> None:
        super().__init__()
        self._clock = clock
        self._real = RealClock()
        self._ahead_ns = 0
        self._wake, self._woken = os.pipe()
        self._owned += [self._wake, self._woken]
        self._thread = threading.Thread(target=self._run, name="simulated devices")

    def __enter__(self) -> Self:
        """Start to serve the ports."""
        self._ahead_ns = self._clock.now_ns() - self._real.now_ns()
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        """Stop and close all ports."""
        os.write(self._woken, b"x")
        self._thread.join()
        self.close()

    def _run(self) -> None:
        clock = self._clock
        while True:
            due = clock.next_event_ns()
            wait_s = _IDLE_S if due is None else min(_IDLE_S, max(0.0, (due - self._now_ns()) / NS))
            ready = self.wait(wait_s, self._wake)
            if self._wake in ready:
                return
            clock.sleep_until_ns(self._now_ns())
            self.serve(ready)

    def _now_ns(self) -> int:
        return self._real.now_ns() + self._ahead_ns
