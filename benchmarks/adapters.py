"""Puts simulated benches behind pseudo-terminals and sockets of this computer, for tests and
benchmarks of real ports: stations of serial lines, a LAWICEL adapter (slcan), a socketcand server.
"""

from __future__ import annotations

import os
import select
import socket
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, Self

from drivers.clock import NS, RealClock, SimulatedClock
from drivers.interfaces import REMOTE_FLAG, RawFrame
from drivers.mock.wires.bus import SimulatedBus
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


_OK: Final = b"\r"
_BELL: Final = b"\a"
_STANDARD: Final = 0x7FF
_SETTINGS: Final = frozenset(b"SsMmZWX")
_HEX: Final = frozenset(b"0123456789ABCDEFabcdef")
_MAX_LINE: Final = 64


class LawicelAdapter:
    """Serial side of a LAWICEL adapter ("slcan"); a
    :class:`~drivers.mock.wires.serial_line.Station`.

    The adapter handles frames with 11-bit identifiers, which the simulated devices use.
    The adapter does not answer settings, because hosts do not wait for an answer.

    Args:
        bus: The bus on the other side of the adapter; the adapter is the host of the bus.
    """

    def __init__(self, bus: SimulatedBus) -> None:
        self._bus = bus
        self._buffer = bytearray()
        self._open = False

    def receive(self, data: bytes) -> bytes:
        """Execute the commands that end in ``data``; return their answers and the received
        frames.
        """
        self._buffer += data
        answers = bytearray()
        *lines, rest = self._buffer.split(_OK)
        # Bytes of more than the longest command without an end do not belong to this protocol.
        self._buffer = rest if len(rest) <= _MAX_LINE else bytearray()
        for line in lines:
            answers += self._obey(bytes(line))
        frames = self._bus.collect(0.0)
        if self._open:
            answers += _lines(frames)
        return bytes(answers)

    def _obey(self, line: bytes) -> bytes:
        match line[:1]:
            case b"":
                return b""
            case b"O" | b"L":
                self._open = True
            case b"C":
                self._open = False
            case b"t" | b"r" if self._open:
                return self._send(line)
            case code if code[0] not in _SETTINGS:
                return _BELL
        return b""

    def _send(self, line: bytes) -> bytes:
        if len(line) < 5 or not set(line[1:]) <= _HEX:
            return _BELL
        identifier, length, remote = int(line[1:4], 16), int(line[4:5], 16), line.startswith(b"r")
        if len(line) != 5 + (0 if remote else 2 * length) or identifier > _STANDARD or length > 8:
            return _BELL
        data = bytes(length) if remote else bytes.fromhex(line[5:].decode())
        sent = _transmitted(self._bus, identifier | (REMOTE_FLAG if remote else 0), data)
        return b"" if sent else _BELL


def _lines(frames: Iterable[RawFrame]) -> bytes:
    parts = [
        f"t{identifier:03X}{len(data)}{data.hex().upper()}\r".encode()
        for _, identifier, data, _ in frames
        if identifier <= _STANDARD
    ]
    return b"".join(parts)


class SocketcandServer:
    """One connection to a socketcand server; a :class:`~drivers.mock.wires.serial_line.Station`.

    Args:
        bus: The bus; the server is the host of the bus.
    """

    def __init__(self, bus: SimulatedBus) -> None:
        self._bus = bus
        self._buffer = b""
        self._greeted = False
        self._raw = False

    def receive(self, data: bytes) -> bytes:
        """Execute the commands that end in ``data``; return their answers and the received
        frames.
        """
        answers = "" if self._greeted else "< hi >"
        self._greeted = True
        *commands, self._buffer = (self._buffer + data).split(b">")
        self._buffer = self._buffer[-_MAX_LINE:]
        for command in commands:
            answers += self._obey(command.decode("ascii", errors="replace").strip(" <").split())
        frames = self._bus.collect(0.0)
        if self._raw:
            for time_ns, identifier, payload, _ in frames:
                if identifier <= _STANDARD:
                    answers += f"< frame {identifier:03X} {time_ns / 1e9:.6f} {payload.hex()} >"
        return answers.encode()

    def _obey(self, words: list[str]) -> str:
        match words:
            case ["open", _]:
                return "< ok >"
            case ["rawmode"]:
                self._raw = True
                return "< ok >"
            case ["send", identifier, _, *payload]:
                try:
                    data = bytes(int(byte, 16) for byte in payload)
                    number = int(identifier, 16)
                except ValueError:
                    return "< error malformed send >"
                if number > _STANDARD or len(data) > 8 or not _transmitted(self._bus, number, data):
                    return "< error cannot send >"
                return ""
        return "< error unknown command >"


def _transmitted(bus: SimulatedBus, identifier: int, data: bytes) -> bool:
    try:
        bus.transmit(identifier, data)
    except OSError:
        return False
    return True
