"""Encodes and decodes frames of the LAWICEL protocol ("slcan") of CAN adapters on a serial line.
This module has no input and output.

A frame is one line of ASCII characters that ends in a carriage return. A data frame in base format
consists of ``t``, the identifier (3 hexadecimal digits), the length (1 digit) and the data (2
digits for each byte). A data frame in extended format begins with ``T``, and its identifier has 8
digits. Remote frames begin with ``r`` or ``R``, and have no data. An adapter that adds time stamps
appends 4 digits.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Final

from drivers.can.port import EXTENDED_FLAG, REMOTE_FLAG, raw_frame
from drivers.clock import NS, Clock
from drivers.interfaces import RawFrame
from drivers.port_errors import close_all, os_errors
from drivers.serial_port import BytePort, PySerialPort

CLOSE: Final = b"C\r"
OPEN: Final = b"O\r"
SPEEDS: Final[Mapping[int, bytes]] = {
    10_000: b"S0\r",
    20_000: b"S1\r",
    50_000: b"S2\r",
    83_300: b"S9\r",
    100_000: b"S3\r",
    125_000: b"S4\r",
    250_000: b"S5\r",
    500_000: b"S6\r",
    750_000: b"S7\r",
    1_000_000: b"S8\r",
}
"""Bit rate to the command that sets it."""

_END: Final = re.compile(rb"[\r\a]")
_FRAME: Final = re.compile(
    rb"(?:([tr])([0-7][0-9A-Fa-f]{2})|([TR])([01][0-9A-Fa-f]{7}))([0-8])([0-9A-Fa-f]*)"
)
_FLAGS: Final = {b"t": 0, b"T": EXTENDED_FLAG, b"r": REMOTE_FLAG, b"R": EXTENDED_FLAG | REMOTE_FLAG}
_STAMP: Final = 4
_ANSWERS: Final = frozenset({b"", b"z", b"Z"})
"""Answers to an accepted command; before a BEL, the empty answer is a refusal."""
MAX_LINE: Final = 64  # greatest number of characters of a line; the longest frame has 30 characters


def encode(identifier: int, data: bytes) -> bytes:
    """Return the line that sends a frame; of ``data``, a remote frame has only the length."""
    kind, digits = ("T", 8) if identifier & EXTENDED_FLAG else ("t", 3)
    if identifier & REMOTE_FLAG:
        kind = "R" if kind == "T" else "r"
    number = identifier & ~(EXTENDED_FLAG | REMOTE_FLAG)
    content = "" if identifier & REMOTE_FLAG else data.hex().upper()
    return f"{kind}{number:0{digits}X}{len(data)}{content}\r".encode()


class LineDecoder:
    """Decodes received bytes into whole frames; never raises.

    A line that is neither a complete frame nor an answer to a command is dropped as a whole and
    counted, because a part of the line could resemble a frame that was never sent. The next line is
    decoded normally.
    """

    def __init__(self) -> None:
        self.bad = 0  # number of lines dropped so far
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return the frames that ``data`` completes: identifier with flags, and data."""
        frames = []
        *ends, rest = _END.split(data)
        for end in ends:
            line = self._line(end)
            frame = _parsed(line)
            if frame is not None:
                frames.append(frame)
            elif line not in _ANSWERS:
                self.bad += 1
        self._keep(rest)
        return frames

    def _line(self, end: bytes) -> bytes:
        """Return the line that ends with ``end``, cut to a length at which it is rejected."""
        self._keep(end)
        line = bytes(self._rest)
        self._rest.clear()
        return line

    def _keep(self, piece: bytes) -> None:
        self._rest += piece
        del self._rest[MAX_LINE:]


def _parsed(line: bytes) -> tuple[int, bytes] | None:
    """Return the frame in a line, or None if the line contains no complete frame."""
    found = _FRAME.fullmatch(line)
    if found is None:
        return None
    base, base_identifier, extended, extended_identifier, length, digits = found.groups()
    kind = base or extended
    count = 2 * int(length) if kind in b"tT" else 0
    if len(digits) not in (count, count + _STAMP):
        return None
    return int(base_identifier or extended_identifier, 16) | _FLAGS[kind], bytes.fromhex(
        digits[:count].decode()
    )


_TTY_BAUD: Final = 115_200
_START_S: Final = 2.0
"""Time during which an adapter may restart and ignore input after its port was opened, s."""


class SlcanPort:
    """A CAN adapter that speaks the LAWICEL protocol; a :class:`~drivers.can.port.FramePort`.

    This port replaces the interface ``slcan`` of python-can, which has three defects: a write to a
    blocked line never returns, a read without data takes a millisecond, and after a byte outside
    ASCII nothing more can be read.

    A garbled line is dropped and counted, and later frames are read. To drop a garbled line is
    safer than to raise an error: the link treats the frame like any other lost frame (stale sample,
    no answer, no heartbeat), whereas an error could abort the exchange that takes the power off. If
    all lines are garbled, no frames arrive and the time-outs of the link act.

    Args:
        line: The adapter's serial line, opened; closed by :meth:`shutdown`.
        clock: Clock for the time stamps of frames.
        bitrate: Bit rate of the CAN bus, bit/s.

    Raises:
        OSError: The line is gone, or slcan adapters do not support this bit rate.
    """

    @os_errors
    def __init__(self, line: BytePort, clock: Clock, bitrate: int) -> None:
        self.decoder = LineDecoder()  # the decoder, which counts bad lines
        self._line = line
        self._clock = clock
        speed = SPEEDS.get(bitrate)
        if speed is None:
            known = ", ".join(f"{rate}" for rate in SPEEDS)
            raise OSError(
                f"an slcan adapter does not support {bitrate} bit/s; choose one of {known}"
            )
        # The first carriage return ends a command that an earlier program may have left incomplete.
        # Frames that were received for the earlier program are discarded.
        line.write(2 * CLOSE)
        line.discard()
        line.write(speed)
        line.write(OPEN)

    @os_errors
    def transmit(self, identifier: int, data: bytes) -> None:
        self._line.write(encode(identifier, data))

    @os_errors
    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        deadline = self._clock.now_ns() + round(timeout_s * NS)
        while True:
            left = deadline - self._clock.now_ns()
            found = self.decoder.feed(self._line.read(max(left, 0) / NS))
            if found or left <= 0:
                now = self._clock.now_ns()
                return [raw_frame((now, identifier, data, False)) for identifier, data in found]

    def shutdown(self) -> None:
        close_all(partial(self._line.write, CLOSE), self._line.close)


@os_errors
def open_slcan(
    channel: str,
    clock: Clock,
    bitrate: int,
    tty_baudrate: int = _TTY_BAUD,
    sleep_after_open: float = _START_S,
    rtscts: bool = False,
    timeout: float | None = None,
    exclusive: bool = True,
) -> SlcanPort:
    """Open an adapter. The options are those of the interface ``slcan`` of python-can.

    Args:
        channel: Serial port of this computer; a suffix of ``@`` and a bit rate replaces
            ``tty_baudrate``.
        clock: Clock for the time stamps of frames.
        bitrate: Bit rate of the CAN bus, bit/s.
        tty_baudrate: Bit rate of the serial line, bit/s; without effect on a USB port.
        sleep_after_open: Time that the adapter takes to start, s.
        rtscts: Hardware flow control of the serial line.
        timeout: Accepted but not used, because each read has a time-out of its own.
        exclusive: Whether the port must not be used by another program.

    Raises:
        OSError: The port cannot be opened, or another program uses it.
    """
    path, _, baud = channel.partition("@")
    line = PySerialPort(path, int(baud) if baud else tty_baudrate, rtscts, exclusive)
    try:
        clock.sleep_until_ns(clock.now_ns() + round(sleep_after_open * NS))
        return SlcanPort(line, clock, bitrate)
    except BaseException:
        line.close()
        raise
