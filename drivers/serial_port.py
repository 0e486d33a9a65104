"""Serial ports for links: send and receive bytes on a real or a simulated line."""

from __future__ import annotations

import errno
import os
import select
import struct
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import Final, Protocol

import serial

from drivers.clock import NS, RealClock
from drivers.interfaces import SERIAL_FLAG as SERIAL_FLAG
from drivers.interfaces import RawFrame
from drivers.port_errors import UnpluggedError, close_all, os_errors

try:
    import fcntl
    import termios
except ImportError:  # Windows, where all functions except serial ports work
    fcntl = termios = None  # type: ignore[assignment]

WRITE_LIMIT_S: Final = 0.1
"""Time-out of a write, s; a request of some 30 bytes fits into the buffer of the driver."""

_FRAME_BYTES: Final = 8
_CHUNK: Final = 4096
_DRAIN_STEP_NS: Final = NS // 1000


def _require_posix() -> None:
    """Check, before a drive moves, that this system can flush a serial line."""
    if termios is None or fcntl is None:
        raise OSError(
            "this system has no termios, which is needed to lock and flush serial lines; use "
            "Linux or macOS"
        )


class BytePort(Protocol):
    """An open serial line; its methods raise nothing but OSError, also after :meth:`close`."""

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            OSError: The line is gone, or does not accept the bytes within :data:`WRITE_LIMIT_S`.
        """
        ...

    def read(self, timeout_s: float) -> bytes:
        """Return the received bytes; wait if no byte has arrived. The result is empty after the
        time-out.

        Raises:
            OSError: The line is gone.
        """
        ...

    def discard(self) -> None:
        """Drop what has come in."""
        ...

    def close(self) -> None:
        """Close the line. Safe to call twice; raises nothing."""
        ...


class InheritedPort:
    """A serial port that another program, or :class:`PySerialPort`, has opened and set up.

    Args:
        descriptor: File descriptor of the port; closed by :meth:`close`.

    Raises:
        OSError: The descriptor is not open.
    """

    def __init__(self, descriptor: int) -> None:
        _require_posix()
        # A write must return if the buffer is full; otherwise it would exceed its time-out.
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._clock = RealClock()

    @os_errors
    def write(self, data: bytes) -> None:
        """Send bytes.

        Bytes that are not accepted in time are dropped, because an old request must not be sent
        later.
        """
        descriptor = self.fileno()
        deadline = self._clock.now_ns() + round(WRITE_LIMIT_S * NS)
        left = data
        while True:
            with suppress(BlockingIOError):
                left = left[os.write(descriptor, left) :]
            if not left:
                return
            wait_ns = deadline - self._clock.now_ns()
            if wait_ns <= 0 or not select.select([], [descriptor], [], wait_ns / NS)[1]:
                termios.tcflush(descriptor, termios.TCOFLUSH)
                taken = len(data) - len(left)
                raise TimeoutError(
                    f"the line accepted {taken} of {len(data)} bytes within {WRITE_LIMIT_S:g} s"
                )

    @os_errors
    def read(self, timeout_s: float) -> bytes:
        descriptor = self.fileno()
        ready, _, _ = select.select([descriptor], [], [], max(0.0, timeout_s))
        if not ready:
            return b""
        try:
            data = os.read(descriptor, _CHUNK)
        except BlockingIOError:
            return b""
        if not data:
            # An unplugged adapter is always ready to read, but returns no data and no error.
            raise UnpluggedError(
                "the adapter was unplugged, or another program reads this line too"
            )
        return data

    @os_errors
    def discard(self) -> None:
        termios.tcflush(self.fileno(), termios.TCIFLUSH)

    def fileno(self) -> int:
        """Return the file descriptor of the port."""
        if self._descriptor < 0:
            raise OSError("the port is closed")
        return self._descriptor

    def close(self) -> None:
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            close_all(partial(self._drain, descriptor), partial(os.close, descriptor))

    def _drain(self, descriptor: int) -> None:
        """Wait until the written bytes are sent, at most for a short time, then drop the remaining
        bytes.

        If bytes remained, closing a blocked line would take up to 30 s in the operating system.
        """
        deadline = self._clock.now_ns() + round(WRITE_LIMIT_S * NS)
        while struct.unpack("i", fcntl.ioctl(descriptor, termios.TIOCOUTQ, bytes(4)))[0]:
            if self._clock.now_ns() >= deadline:
                termios.tcflush(descriptor, termios.TCOFLUSH)
                return
            self._clock.sleep_until_ns(self._clock.now_ns() + _DRAIN_STEP_NS)


class PySerialPort(InheritedPort):
    """A serial port of the operating system, 8N1, locked by this program; pyserial opens and
    configures the port. Bytes are read and written through the file descriptor, because pyserial
    raises exceptions of many types on a port that has been unplugged, and its write with a time-out
    waits for buffer space even after the last byte.

    Args:
        path: Path of the device.
        baud: Bit rate, bit/s.
        rtscts: Hardware flow control.
        exclusive: Whether to lock the port, and to refuse a port that another program has locked.

    Raises:
        OSError: The port cannot be opened, does not support this bit rate, or is used by another
            program.
    """

    @os_errors
    def __init__(self, path: str, baud: int, rtscts: bool = False, exclusive: bool = True) -> None:
        _require_posix()
        try:
            port = serial.Serial(path, baud, timeout=0, exclusive=exclusive, rtscts=rtscts)
        except OSError as error:
            if error.errno != errno.EAGAIN:
                raise
            raise OSError(f"{path} is used by another program") from error
        try:
            # Reduces the latency of FTDI adapters from 16 ms to some 6 ms; other ports lack this
            # setting.
            with suppress(ValueError, OSError, AttributeError, NotImplementedError):
                port.set_low_latency_mode(True)
            # The lock belongs to the open file, and not to one of its descriptors.
            super().__init__(os.dup(port.fileno()))
        finally:
            port.close()


def raw_frames(time_ns: int, line: int, data: bytes, sent: bool) -> Iterator[RawFrame]:
    """Yield the bytes of a serial line as frames of eight bytes, for the log."""
    for at in range(0, len(data), _FRAME_BYTES):
        yield RawFrame(time_ns, SERIAL_FLAG | line, data[at : at + _FRAME_BYTES], sent)
