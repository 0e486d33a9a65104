"""Connects simulated devices to pseudo-terminals and sockets that programs open like hardware."""

from __future__ import annotations

import os
import select
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Self

from drivers.clock import NS, RealClock, SimulatedClock
from drivers.mock.wires.serial_line import Station

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
