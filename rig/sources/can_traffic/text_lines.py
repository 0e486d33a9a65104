"""Filters the lines of text formats of CAN traffic before python-can reads them.

python-can misreads some lines: it reads an error frame of candump as a data frame, half a byte at
the end as a whole byte, time stamps since the last event as stamps since the start, and an unknown
TRC version as another version. The filters drop and count such lines, rewrite them, or refuse the
file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import TextIO

from rig.common.errors import InputError

ERROR_FLAG = 0x20000000
"""Flag that SocketCAN sets in the identifier of an error frame."""
_CANDUMP = re.compile(
    r"\((\d+)(\.\d+)?\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"((?:#[0-9A-Fa-f])?(?:[0-9A-Fa-f]{2})*|[Rr]\d?)(\s+[RTrt])?"
)
_CANDUMP_SCREEN = re.compile(r"(\(.*\)\s+)?\S+\s+[0-9A-Fa-f]{3,8}\s+\[\d+\]")
_STAMPED = re.compile(r"\s*(-?\d+\.\d+)(\s+.*)", re.DOTALL)
_ASC_HEAD = re.compile(r"date\s|base\s|//|(no\s+)?\s*internal\s+events\s+logged", re.IGNORECASE)
_TRC_VERSIONS = ("1.0", "1.1", "1.3", "2.0", "2.1")


@dataclass
class Lines:
    """State of the filtering of a file: the current line, and the counts of dropped lines.

    Attributes:
        path: The file.
        number: Number of the line that was read last, from 1.
        stamped: Number of lines with a time stamp.
        errors: Number of dropped error frames.
        notes: Messages to the user.
    """

    path: Path
    number: int = 0
    stamped: int = 0
    errors: int = 0
    notes: list[str] = field(default_factory=list)

    def whole(self, stream: TextIO) -> Iterator[str]:
        """Yield the lines that have an end; a last line without an end may be cut off."""
        for text in stream:
            self.number += 1
            if not text.endswith("\n"):
                if text.strip():
                    self.notes.append(
                        f"line {self.number} has no line end and may be cut off: line dropped"
                    )
                return
            yield text


def candump(lines: Lines, stream: TextIO) -> Iterator[str]:
    """Yield the frames of a ``candump -L`` file, with time stamps since the first frame.

    Raises:
        InputError: A line is not a frame; the message names the line.
    """
    begin: int | None = None
    for text in lines.whole(stream):
        if not text.strip():
            continue
        found = _CANDUMP.fullmatch(text.strip())
        if found is None:
            screen = _CANDUMP_SCREEN.match(text.strip())
            remedy = (
                "this is candump's output for the screen; record with candump -L"
                if screen
                else "if the file is a table, name it .csv; record CAN traffic with candump -L"
            )
            raise InputError(
                f"{lines.path}:{lines.number}: not a frame of candump -L "
                f"(got {text.strip()[:60]!r}); {remedy}"
            )
        whole, fraction, bus, identifier, data, direction = found.groups()
        if begin is None:
            begin = int(whole)
        lines.stamped += 1
        if len(identifier) == 8 and int(identifier, 16) & ERROR_FLAG:
            lines.errors += 1
            continue
        # Seconds since 1970 leave a double a quarter of a microsecond.
        stamp = f"{int(whole) - begin}{fraction or '.0'}"
        yield f"({stamp}) {bus} {identifier}#{data}{direction or ''}\n"


def asc(lines: Lines, stream: TextIO) -> Iterator[str]:
    """Yield the lines of a Vector ASC file, with time stamps since the start of the measurement."""
    relative, head, total = False, True, Decimal(0)
    for text in lines.whole(stream):
        if head and text.strip() and not _ASC_HEAD.match(text.strip()):
            # python-can treats the first line after the head as a part of the head.
            head = False
            yield "no internal events logged\n"
        if head and re.search(r"timestamps\s+relative", text, re.IGNORECASE):
            relative = True
            lines.notes.append(
                "the time stamps count from the previous event: summed to times since the start"
            )
        found = _STAMPED.fullmatch(text)
        if found is not None:
            lines.stamped += "Start of measurement" not in text
            if relative:
                total += Decimal(found[1])
                text = f"{total:f}{found[2]}"
        yield text


def trc(lines: Lines, stream: TextIO) -> Iterator[str]:
    """Yield the lines of a PEAK TRC file without its date.

    Raises:
        InputError: The file is of a version that python-can does not read.
    """
    for text in lines.whole(stream):
        word = text.strip()
        if word.startswith(";$FILEVERSION"):
            version = word.partition("=")[2].strip()
            if version not in _TRC_VERSIONS:
                raise InputError(
                    f"{lines.path}:{lines.number}: TRC of version {version}; versions that can be "
                    f"read are {', '.join(_TRC_VERSIONS)}: save the file in one of these versions "
                    f"with PCAN-View"
                )
        lines.stamped += bool(word) and not word.startswith(";")
        # Without the date, stamps are since the start, to the last digit.
        if not word.startswith(";$STARTTIME"):
            yield text


FILTERS: dict[str, Callable[[Lines, TextIO], Iterator[str]]] = {
    "log": candump,
    "asc": asc,
    "trc": trc,
}
"""Filters of the lines of text formats, by file extension."""
