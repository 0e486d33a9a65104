"""Reads frames of recorded CAN traffic with python-can: candump, Vector ASC and BLF, PEAK TRC, and
the bus logging of MDF.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, cast

import can
import can.io
import can.io.blf
import numpy as np
from numpy.typing import NDArray

from drivers.can.port import EXTENDED_FLAG
from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.can_traffic.text_lines import FILTERS, Lines
from rig.sources.formats.library import heard, library, quiet_ends
from rig.sources.formats.table import damaged, format_of, open_binary
from rig.sources.formats.text_layout import encoding_of, open_text

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
