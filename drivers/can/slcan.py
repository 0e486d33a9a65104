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
from collections.abc import Mapping
from typing import Final

from drivers.can.port import EXTENDED_FLAG, REMOTE_FLAG

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
"""Answers of an adapter to an accepted command; before a BEL character, the empty answer means that
the command is refused.
"""
MAX_LINE: Final = 64
"""Greatest number of characters of a line; the longest frame has 30 characters."""


def encode(identifier: int, data: bytes) -> bytes:
    """Return the line that sends a frame; the flags of the identifier choose its format. Of
    ``data``, a remote frame contains only the length.
    """
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

    Attributes:
        bad: Number of lines dropped so far.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return the frames that ``data`` completes, oldest first: identifier with flags, and
        data.
        """
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
        """Return the line that ends with ``end``; a line that is too long is shortened to a length
        at which it is still rejected.
        """
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
