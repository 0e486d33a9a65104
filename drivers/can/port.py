"""How a link reaches a CAN bus: frames as plain tuples, over any python-can interface or on the
simulated bus.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Final, Protocol

import can

from drivers.clock import Clock
from drivers.interfaces import RawFrame
from drivers.port_errors import close_all, os_errors

EXTENDED_FLAG: Final = 0x80000000
REMOTE_FLAG: Final = 0x40000000
ERROR_FLAG: Final = 0x20000000
"""Set in :attr:`RawFrame.identifier` for what is not an ordinary data frame, as SocketCAN does."""

MAX_COLLECTED: Final = 1024
"""So that a device which floods the bus cannot hold the control loop."""

SEND_LIMIT_S: Final = 0.1
"""How long an interface may take to accept a frame."""

_HIGHEST_BASE: Final = 0x7FF
_IDENTIFIER_BITS: Final = 0x1FFFFFFF
_MAX_BYTES: Final = 8

raw_frame: Final[Callable[[tuple[int, int, bytes, bool]], RawFrame]] = partial(
    tuple.__new__, RawFrame
)
"""Makes a :class:`RawFrame` of a tuple in half the time its constructor takes; a cycle has six."""


class FramePort(Protocol):
    """An open bus. Its methods raise nothing but OSError, also after :meth:`shutdown`."""

    def transmit(self, identifier: int, data: bytes) -> None:
        """Send a base-format data frame.

        Raises:
            OSError: The bus refuses it, is gone, or does not take it within :data:`SEND_LIMIT_S`.
        """
        ...

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return what has come in, oldest first; where there is nothing, wait for it.

        Empty after the time-out.

        Raises:
            OSError: The bus failed, or what came in is not of its protocol.
        """
        ...

    def shutdown(self) -> None:
        """Close the bus. Safe to call twice; raises nothing."""
        ...


class PythonCanPort:
    """A bus of python-can; frames are stamped when they are read.

    A garbled message of an interface over a serial line or a socket is an error once, for
    python-can does not say how much of it was read; the port stays usable. Frames of CAN FD do not
    belong on this bus and are passed over.

    Args:
        bus: The opened interface; closed by :meth:`shutdown`.
        clock: What stamps the frames.
    """

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        self._bus = bus
        self._clock = clock
        _limit_sockets(bus)

    @os_errors
    def transmit(self, identifier: int, data: bytes) -> None:
        """Send a frame.

        Raises:
            OSError: The bus refuses it, is gone, or does not take it in time.
        """
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        try:
            self._bus.send(message, timeout=SEND_LIMIT_S)
        except BlockingIOError as error:
            raise TimeoutError(
                f"the interface did not take a frame within {SEND_LIMIT_S:g} s"
            ) from error

    @os_errors
    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return what has come in, at most :data:`MAX_COLLECTED` frames.

        Raises:
            OSError: The bus failed, or what came in is not of its protocol.
        """
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
        """Close the bus; safe to call twice, raises nothing."""
        close_all(self._bus.shutdown)


def _identifier(message: can.Message) -> int:
    # A backend takes what an adapter says for an identifier; only one that exists may count as a
    # base-format one.
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
    """Have the kernel end what blocks: interfaces over sockets do not all heed the time limit of a
    send.
    """
    limit = struct.pack("ll", 0, round(SEND_LIMIT_S * 1e6))
    for part in getattr(bus, "__dict__", {}).values():
        if isinstance(part, socket.socket):
            with suppress(OSError):
                part.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
