"""How a link reaches a serial line: bytes out, bytes in, over pyserial or on a simulated line."""

from __future__ import annotations

import os
import select
import termios
from collections.abc import Iterator
from contextlib import suppress
from typing import Final, Protocol

import serial

from drivers.interfaces import RawFrame

SERIAL_FLAG: Final = 0x10000000
"""Set in :attr:`RawFrame.identifier` for bytes of a serial line; the low bits are the line's number."""
_FRAME_BYTES: Final = 8
_CHUNK: Final = 4096


class BytePort(Protocol):
    """An open serial line."""

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            OSError: The line is gone.
        """
        ...

    def read(self, timeout_s: float) -> bytes:
        """Return what has come in; where there is nothing, wait for it. Empty after the time-out.

        Raises:
            OSError: The line is gone.
        """
        ...

    def discard(self) -> None:
        """Drop what has come in.

        Raises:
            OSError: The line is gone.
        """
        ...

    def close(self) -> None:
        """Close the line."""
        ...


class PySerialPort:
    """A serial port of the operating system, 8N1.

    Args:
        path: Of the device.
        baud: Bit/s.

    Raises:
        OSError: It cannot be opened.
        ValueError: It does not take this rate.
    """

    def __init__(self, path: str, baud: int) -> None:
        self._serial = serial.Serial(path, baud, timeout=0, exclusive=True)
        # Cuts the 16 ms that FTDI adapters hold bytes back to some 6 ms; other ports do not have it.
        with suppress(ValueError, OSError, AttributeError, NotImplementedError):
            self._serial.set_low_latency_mode(True)

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._serial.write(data)

    def read(self, timeout_s: float) -> bytes:
        """Return what has come in."""
        ready, _, _ = select.select([self._serial], [], [], max(0.0, timeout_s))
        return bytes(self._serial.read(self._serial.in_waiting or 1)) if ready else b""

    def discard(self) -> None:
        """Drop what has come in."""
        self._serial.reset_input_buffer()

    def fileno(self) -> int:
        """Return its file descriptor."""
        descriptor: int = self._serial.fileno()
        return descriptor

    def close(self) -> None:
        """Close the port."""
        self._serial.close()


class InheritedPort:
    """A serial port that another program opened and set up.

    Args:
        descriptor: Its file descriptor.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def write(self, data: bytes) -> None:
        """Send bytes."""
        while data:
            select.select([], [self._descriptor], [])
            data = data[os.write(self._descriptor, data) :]

    def read(self, timeout_s: float) -> bytes:
        """Return what has come in."""
        ready, _, _ = select.select([self._descriptor], [], [], max(0.0, timeout_s))
        return os.read(self._descriptor, _CHUNK) if ready else b""

    def discard(self) -> None:
        """Drop what has come in.

        Raises:
            OSError: The line is gone.
        """
        try:
            termios.tcflush(self._descriptor, termios.TCIFLUSH)
        except termios.error as error:
            raise OSError(*error.args) from error

    def close(self) -> None:
        """Close it."""
        os.close(self._descriptor)


def raw_frames(time_ns: int, line: int, data: bytes, sent: bool) -> Iterator[RawFrame]:
    """Yield bytes of a line for the log, eight to a frame."""
    for at in range(0, len(data), _FRAME_BYTES):
        yield RawFrame(time_ns, SERIAL_FLAG | line, data[at : at + _FRAME_BYTES], sent)
