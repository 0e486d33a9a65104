"""How a link reaches a CAN bus: frames as plain tuples, over any python-can interface or on the simulated bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, Protocol

import can

from drivers.clock import Clock
from drivers.interfaces import RawFrame

EXTENDED_FLAG: Final = 0x80000000
REMOTE_FLAG: Final = 0x40000000
ERROR_FLAG: Final = 0x20000000
"""Set in :attr:`RawFrame.identifier` for what is not an ordinary data frame, as SocketCAN does."""

MAX_COLLECTED: Final = 1024
"""So that a device which floods the bus cannot hold the control loop."""

raw_frame: Final[Callable[[tuple[int, int, bytes, bool]], RawFrame]] = partial(tuple.__new__, RawFrame)
"""Makes a :class:`RawFrame` of a tuple in half the time its constructor takes; a cycle has six."""


class FramePort(Protocol):
    """An open bus."""

    def transmit(self, identifier: int, data: bytes) -> None:
        """Send a base-format data frame.

        Raises:
            can.CanError: The bus refuses it.
            OSError: The same, from the operating system.
        """
        ...

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return what has come in, oldest first; where there is nothing, wait for it. Empty after the time-out.

        Raises:
            can.CanError: The bus failed.
            OSError: The same, from the operating system.
        """
        ...

    def shutdown(self) -> None:
        """Close the bus."""
        ...


class PythonCanPort:
    """A bus of python-can; frames are stamped when they are read.

    Args:
        bus: The opened interface; closed by :meth:`shutdown`.
        clock: What stamps the frames.
    """

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        self._bus = bus
        self._clock = clock

    def transmit(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        self._bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return what has come in, at most :data:`MAX_COLLECTED` frames."""
        frames: list[RawFrame] = []
        message = self._bus.recv(timeout_s)
        while message is not None:
            frames.append(raw_frame((self._clock.now_ns(), _identifier(message), bytes(message.data), False)))
            message = self._bus.recv(0.0) if len(frames) < MAX_COLLECTED else None
        return frames

    def shutdown(self) -> None:
        """Close the bus."""
        self._bus.shutdown()


def _identifier(message: can.Message) -> int:
    identifier = message.arbitration_id
    if message.is_error_frame:
        identifier |= ERROR_FLAG
    if message.is_remote_frame:
        identifier |= REMOTE_FLAG
    if message.is_extended_id:
        identifier |= EXTENDED_FLAG
    return identifier
