"""Reads frames of recorded CAN traffic with python-can: candump, Vector ASC and BLF, PEAK TRC, and
the bus logging of MDF.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any, BinaryIO, TextIO, cast

import can
import can.io
import can.io.blf
import numpy as np
from numpy.typing import NDArray

from drivers.can.port import EXTENDED_FLAG
from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.formats.table import damaged, format_of, heard, library, open_binary, quiet_ends
from rig.sources.formats.text_layout import encoding_of, open_text

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


_DAMAGED = (
    can.CanError,
    can.io.blf.BLFParseError,
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    TypeError,
    ValueError,
    NotImplementedError,
    struct.error,
    zlib.error,
)
"""Exceptions that python-can raises on damaged files."""
_REMEDY = "check that the file was copied completely"
_READERS: Mapping[str, Any] = {
    "log": can.io.CanutilsLogReader,
    "asc": can.io.ASCReader,
    "trc": can.io.TRCReader,
}
_FROM_ZERO = frozenset({"asc", "blf"})
"""Formats in which channels are numbered from 1, but by python-can from 0."""

Key = tuple[str, int]
"""Bus and identifier of a frame; in a 29-bit identifier, :data:`EXTENDED_FLAG` is set."""


@dataclass(frozen=True)
class Frames:
    """All frames of one identifier on one bus.

    Attributes:
        stamps: Time since the first frame of the file, s, shape (n,).
        data: Data bytes, zero beyond the length of each frame, shape (n, longest).
        lengths: Number of data bytes of each frame, shape (n,).
    """

    stamps: Array
    data: NDArray[np.uint8]
    lengths: NDArray[np.intp]


@dataclass
class Traffic:
    """Content of a file of CAN traffic.

    Attributes:
        frames: By bus and identifier, in order of appearance.
        notes: Messages to the user.
    """

    frames: dict[Key, Frames] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def read_traffic(path: Path) -> Traffic:
    """Read all data frames of a file; error frames and remote frames are left out and counted.

    Raises:
        InputError: The file is damaged or has no frames; for a text format, the message names the
            line.
    """
    kind = format_of(path)
    lines = Lines(path)
    traffic = Traffic(notes=lines.notes)
    stamps: dict[Key, list[float]] = {}
    data: dict[Key, list[bytes]] = {}
    remote = read = 0
    said: list[str] = []
    try:
        with heard("can") as said:
            for message in _messages(path, kind, lines):
                read += 1
                if message.is_error_frame:
                    lines.errors += 1
                    continue
                if message.is_remote_frame:
                    remote += 1
                    continue
                bus = message.channel
                if kind in _FROM_ZERO and isinstance(bus, int):
                    bus += 1
                flag = EXTENDED_FLAG if message.is_extended_id else 0
                key = (str(bus), message.arbitration_id | flag)
                stamps.setdefault(key, []).append(message.timestamp)
                data.setdefault(key, []).append(bytes(message.data))
    except InputError:
        raise
    except _DAMAGED as error:
        place = f"line {lines.number}: " if lines.number else ""
        raise damaged(path, ValueError(f"{place}{error!r}"), _REMEDY) from error
    traffic.notes += [f"python-can: {words}" for words in said]
    if lines.errors:
        traffic.notes.append(f"{lines.errors} error frames left out")
    if remote:
        traffic.notes.append(f"{remote} remote frames left out")
    if lines.stamped > read + lines.errors:
        traffic.notes.append(
            f"{lines.stamped - read - lines.errors} lines that are not frames left out"
        )
    if not stamps:
        raise InputError(f"{path}: holds no data frames" + "".join(f"; {n}" for n in traffic.notes))
    first = min(times[0] for times in stamps.values())
    for key, times in stamps.items():
        traffic.frames[key] = _packed(np.array(times, np.float64) - first, data[key])
    return traffic


def _packed(stamps: Array, data: list[bytes]) -> Frames:
    lengths = np.array([len(one) for one in data], np.intp)
    longest = int(lengths.max())
    joined = b"".join(one.ljust(longest, b"\0") for one in data)
    return Frames(stamps, np.frombuffer(joined, np.uint8).reshape(len(data), longest), lengths)


def _messages(path: Path, kind: str, lines: Lines) -> Iterator[can.Message]:
    if kind == "blf":
        yield from _blf(path, lines)
        return
    if kind not in _READERS:
        yield from _mf4(path)
        return
    encoding = encoding_of(path)
    with open_text(path, encoding) as stream:
        yield from _READERS[kind](_Source(FILTERS[kind](lines, stream)))


class _Source:
    """File object of filtered lines, from which python-can reads."""

    def __init__(self, lines: Iterator[str]) -> None:
        self._lines = lines

    def __iter__(self) -> Iterator[str]:
        return self._lines

    def read(self, size: int = -1) -> str:
        """Return the next line; python-can requires this method."""
        return next(self._lines, "")

    def close(self) -> None:
        """Do nothing; the function that opened the stream closes it."""


def _mf4(path: Path) -> Iterator[can.Message]:
    """Yield the frames of the bus logging of an MF4 file, with times since its start."""
    library("asammdf", path, "MDF", "mdf")
    with heard("asammdf"), quiet_ends(), open_binary(path) as stream:
        reader = can.io.MF4Reader(cast(BinaryIO, stream))
        # Seconds since 1970 leave a double a quarter of a microsecond.
        reader._start_timestamp = 0.0
        yield from reader


def _blf(path: Path, lines: Lines) -> Iterator[can.Message]:
    """Yield the frames of a BLF file, with times since the start of the file."""
    with open_binary(path) as stream:
        reader = can.io.BLFReader(cast(BinaryIO, stream))
        # Seconds since 1970 leave a double a quarter of a microsecond.
        reader.start_timestamp = 0.0
        yielded = 0
        for message in reader:
            yielded += 1
            yield message
    size = path.stat().st_size if path.suffix.lower() == ".blf" else reader.file_size
    if size < reader.file_size:
        lines.notes.append(
            f"the file is cut off: {size} of {reader.file_size} bytes; the frames before the "
            "cut are read"
        )
    elif not reader.file_size:
        lines.notes.append("the logger did not close the file; its complete frames are read")
    if 0 < yielded < reader.object_count:
        lines.notes.append(f"{reader.object_count - yielded} objects that are not frames left out")
