"""Simulated CAN adapters for the simulated bus: LAWICEL serial protocol (slcan) and socketcand."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from drivers.interfaces import REMOTE_FLAG, RawFrame
from drivers.mock.wires.bus import SimulatedBus

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
