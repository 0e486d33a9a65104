"""How a link reaches a CAN bus: frames as plain tuples, over any python-can interface or natively on the simulated bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Protocol

import can

from drivers.clock import Clock
from drivers.interfaces import RawFrame

EXTENDED_FLAG: Final = 0x80000000
REMOTE_FLAG: Final = 0x40000000
ERROR_FLAG: Final = 0x20000000
"""Set in :attr:`RawFrame.identifier` for what is not an ordinary data frame, as SocketCAN does."""


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
        """Return the next frame."""
        message = self._bus.recv(timeout_s)
        if message is None:
            return ()
        identifier = message.arbitration_id
        if message.is_error_frame:
            identifier |= ERROR_FLAG
        if message.is_remote_frame:
            identifier |= REMOTE_FLAG
        if message.is_extended_id:
            identifier |= EXTENDED_FLAG
        return (RawFrame(self._clock.now_ns(), identifier, bytes(message.data), False),)

    def shutdown(self) -> None:
        """Close the bus."""
        self._bus.shutdown()
