"""CAN ports for links: frames as plain tuples, over python-can or the simulated bus."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Final, Protocol

import can

from drivers.clock import Clock
from drivers.interfaces import ERROR_FLAG as ERROR_FLAG
from drivers.interfaces import EXTENDED_FLAG as EXTENDED_FLAG
from drivers.interfaces import REMOTE_FLAG as REMOTE_FLAG
from drivers.interfaces import RawFrame
from drivers.port_errors import close_all, os_errors

MAX_COLLECTED: Final = 1024
"""Greatest number of frames of one call: no device can block the control loop by sending."""

SEND_LIMIT_S: Final = 0.1  # time-out within which an interface must accept a frame, s

_CONNECT_LIMIT_S: Final = 0.5
_HIGHEST_BASE: Final = 0x7FF
_IDENTIFIER_BITS: Final = 0x1FFFFFFF
_MAX_BYTES: Final = 8
_SOCKETCAND: Final = "can.interfaces.socketcand"

raw_frame: Final[Callable[[tuple[int, int, bytes, bool]], RawFrame]] = partial(
    tuple.__new__, RawFrame
)
"""Makes a :class:`RawFrame` from a tuple, in half of the time of its constructor."""


def hexadecimal(identifier: int) -> str:
    """Return a CAN identifier as hexadecimal text: 3 digits, or 8 digits in extended format."""
    extended = identifier & EXTENDED_FLAG
    return f"{identifier & _IDENTIFIER_BITS:08X}h" if extended else f"{identifier:03X}h"


class FramePort(Protocol):
    """An open bus. The methods of a port raise nothing but OSError, also after :meth:`shutdown`."""

    def transmit(self, identifier: int, data: bytes) -> None:
        """Send a frame; the flags of the identifier choose its format as in :class:`RawFrame`. Of
        ``data``, a remote frame contains only the length.

        Raises:
            OSError: The bus refuses the frame, does not accept it within :data:`SEND_LIMIT_S`, or
                is gone.
        """
        ...

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return the received frames, oldest first; wait if no frame has arrived.

        The result is empty after the time-out.

        Raises:
            OSError: The bus failed, or received data violate its protocol.
        """
        ...

    def shutdown(self) -> None:
        """Close the bus. Safe to call twice; raises nothing."""
        ...


def open_bus(interface: str, channel: str, bitrate: int, options: Mapping[str, Any]) -> can.BusABC:
    """Open an interface of python-can.

    Raises:
        OSError: Nothing listens where a socketcand server should. python-can would try to connect
            for 10 s, longer than a drive may stay energised.
        can.CanError: The interface cannot be opened.
        ValueError: An option is wrong.
    """
    if interface == "socketcand":
        # The server's address may also stand in python-can's own files or its environment.
        known = can.util.load_config(config={"interface": interface, "channel": channel, **options})
        socket.create_connection((known["host"], known["port"]), _CONNECT_LIMIT_S).close()
    return can.Bus(channel=channel, interface=interface, bitrate=bitrate, **options)


class PythonCanPort:
    """A bus of python-can; the time stamp of a frame is the time at which it is read.

    A garbled message from a serial or socket interface raises an error, because python-can does
    not report how many bytes of the message were read; the port stays usable. CAN FD frames are
    ignored.
    """

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        self._bus = bus
        self._clock = clock
        # This interface would send a data frame instead of a remote frame.
        self._remote_frames_lost = type(bus).__module__.startswith(_SOCKETCAND)
        _limit_sockets(bus)

    @os_errors
    def transmit(self, identifier: int, data: bytes) -> None:
        if identifier > _HIGHEST_BASE:
            remote = bool(identifier & REMOTE_FLAG)
            if remote and self._remote_frames_lost:
                raise OSError("this interface of python-can sends no remote frames; use another")
            message = can.Message(
                arbitration_id=identifier & _IDENTIFIER_BITS,
                is_extended_id=bool(identifier & EXTENDED_FLAG),
                is_remote_frame=remote,
                dlc=len(data),
                data=None if remote else data,
            )
        else:
            message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        try:
            self._bus.send(message, timeout=SEND_LIMIT_S)
        except BlockingIOError as error:
            raise TimeoutError(
                f"the CAN interface did not accept a frame for sending within {SEND_LIMIT_S:g} s"
            ) from error

    @os_errors
    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        frames: list[RawFrame] = []
        read = 0
        message = self._bus.recv(timeout_s)
        while message is not None:
            read += 1
            data = bytes(message.data)
            if not message.is_fd and len(data) <= _MAX_BYTES:
                frames.append(raw_frame((self._clock.now_ns(), _identifier(message), data, False)))
            message = self._bus.recv(0.0) if read < MAX_COLLECTED else None
        return frames

    def shutdown(self) -> None:
        close_all(self._bus.shutdown)


def _identifier(message: can.Message) -> int:
    # python-can returns any identifier that an adapter sends; only a valid identifier may count as
    # one of base format.
    found = message.arbitration_id
    identifier = found & _IDENTIFIER_BITS
    if message.is_extended_id or found != identifier or identifier > _HIGHEST_BASE:
        identifier |= EXTENDED_FLAG
    if message.is_error_frame:
        identifier |= ERROR_FLAG
    if message.is_remote_frame:
        identifier |= REMOTE_FLAG
    return identifier


def _limit_sockets(bus: can.BusABC) -> None:
    """Limit blocking calls: some socket interfaces of python-can ignore the time-out of a send."""
    limit = struct.pack("ll", 0, round(SEND_LIMIT_S * 1e6))
    for part in getattr(bus, "__dict__", {}).values():
        if isinstance(part, socket.socket):
            with suppress(OSError):
                part.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)


ANSWER_SHARE: Final = 0.8
"""Share of a control cycle for process data; the rest is for heartbeats, SDO and the host."""


def frame_bits(length: int) -> int:
    """Return the maximum length of a base-format data frame of ``length`` bytes, in bit times.

    34 + 8 n bits, with n data bytes, are subject to bit stuffing, in the worst case one stuff bit
    after every four bits; 13 bits (delimiters, acknowledge, end of frame, intermission) are not.
    """
    stuffed = 34 + 8 * length
    return stuffed + (stuffed - 1) // 4 + 13


def cycle_bits(frames: Iterable[tuple[int, int]]) -> float:
    """Return the mean number of bit times of SYNC and process data in a control cycle, with the
    worst-case number of stuff bits.

    Args:
        frames: Data bytes of each PDO, and its period in cycles.
    """
    return frame_bits(0) + sum(frame_bits(length) / every for length, every in frames)
