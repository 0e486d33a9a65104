"""Exports the raw CAN traffic of a run in the formats of candump and of Vector's tools.

Identifiers, data, direction and order are exact; times are rounded to microseconds, the resolution
of both formats.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TextIO

from drivers.interfaces import ERROR_FLAG, EXTENDED_FLAG, IDENTIFIER_BITS, REMOTE_FLAG, RawFrame
from rig.common.errors import InputError
from rig.common.timing import instant
from rig.runs.mcap import ros
from rig.runs.mcap.layout import CLOCK_METADATA, FRAMES_TOPIC, decode_frames
from rig.runs.mcap.reader import START, Message, Tail
from rig.runs.mcap.records import DamageError
from rig.runs.mcap.stream import first_metadata
from rig.runs.run_record import PartRecord, RunRecord

INTERFACE = "can0"
"""Name of the bus in a candump log."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def messages(folder: Path, part: PartRecord) -> Iterator[tuple[str, Message]]:
    """Yield topic and message of one recording of a run, in recorded order.

    If the recording was never closed, all messages up to its last complete chunk are yielded.

    Raises:
        InputError: The recording is damaged, or cannot be read.
    """
    path = folder / part.file
    with _readable(path, folder), Tail(path) as tail:
        offset: int | None = START
        while offset is not None and (piece := tail.at(offset)) is not None:
            yield from piece.messages
            offset = piece.following


@contextmanager
def _readable(path: Path, folder: Path) -> Iterator[None]:
    """Name a recording that is damaged or cannot be read, and the remedy."""
    try:
        yield
    except DamageError as error:
        raise InputError(f"{path}: damaged ({error}); use `rig recover {folder}`") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def utc_ns(created: str) -> int:
    """Return an ISO time as ns since 1970."""
    return (instant(created) - _EPOCH) // timedelta(microseconds=1) * 1000


class FrameClock:
    """Converts the time stamps of the raw frames of one recording to UTC: the recording starts at
    the time ``created`` of its part.

    Frames in recordings of earlier versions count from an unknown origin; their first frame is
    assumed to be at the start of the recording.

    Raises:
        InputError: The recording is damaged, or cannot be read.
    """

    def __init__(self, folder: Path, part: PartRecord) -> None:
        self.created_ns = utc_ns(part.created)
        path = folder / part.file
        with _readable(path, folder):
            known = first_metadata(path, CLOCK_METADATA)
        self._origin_ns = None if known is None else 0

    def at(self, frame: RawFrame) -> RawFrame:
        """Return the frame and its time, ns since 1970."""
        if self._origin_ns is None:
            self._origin_ns = frame.time_ns
        return frame._replace(time_ns=self.created_ns + frame.time_ns - self._origin_ns)


@dataclass
class Count:
    """Numbers of the written frames, and of data that the format cannot contain."""

    frames: int = 0
    serial: int = 0
    errors: int = 0
    parts: list[str] = field(default_factory=list)


def can_frames(folder: Path, record: RunRecord, count: Count) -> Iterator[RawFrame]:
    """Yield the CAN frames of all recordings of a run and their times, ns since 1970; bytes of
    serial lines are only counted.

    Raises:
        InputError: A recording is damaged, or cannot be read.
    """
    for part in record.parts:
        clock = FrameClock(folder, part)
        for topic, message in messages(folder, part):
            if topic != FRAMES_TOPIC:
                continue
            for frame in decode_frames(message.data):
                placed = clock.at(frame)
                if ros.is_serial(frame):
                    count.serial += 1
                else:
                    count.frames += 1
                    count.errors += bool(frame.identifier & ERROR_FLAG)
                    yield placed


def write_candump(stream: TextIO, frames: Iterator[RawFrame]) -> None:
    """Write a log in the format of ``candump -L -x``: time since 1970, interface, identifier, data,
    and T for frames that the host sent.
    """
    for frame in frames:
        flags = frame.identifier
        seconds, microseconds = divmod(_microseconds(frame.time_ns), 1_000_000)
        if flags & ERROR_FLAG:
            identifier = f"{flags & (IDENTIFIER_BITS | ERROR_FLAG):08X}"
        elif flags & EXTENDED_FLAG:
            identifier = f"{flags & IDENTIFIER_BITS:08X}"
        else:
            identifier = f"{flags & IDENTIFIER_BITS:03X}"
        data = "R" if flags & REMOTE_FLAG else frame.data.hex().upper()
        direction = "T" if frame.sent else "R"
        stream.write(
            f"({seconds:010d}.{microseconds:06d}) {INTERFACE} {identifier}#{data} {direction}\n"
        )


def write_asc(stream: TextIO, frames: Iterator[RawFrame]) -> None:
    """Write a log in the format of Vector's CANalyzer: seconds since the start of the log, channel
    1, identifier, direction and data. In this format an error frame has neither identifier nor
    data.

    The log starts at the whole second before its first frame, because the format states the date of
    the start only to milliseconds.
    """
    first = next(frames, None)
    start = 0 if first is None else _microseconds(first.time_ns) // 1_000_000 * 1_000_000
    begun = _date(start)
    stream.write(f"date {begun}\nbase hex  timestamps absolute\ninternal events logged\n")
    stream.write(
        f"// version 9.0.0\nBegin Triggerblock {begun}\n   0.000000 Start of measurement\n"
    )
    while first is not None:
        seconds = (_microseconds(first.time_ns) - start) / 1e6
        stream.write(f"{seconds:11.6f} 1  {_asc(first)}\n")
        first = next(frames, None)
    stream.write("End TriggerBlock\n")


def _asc(frame: RawFrame) -> str:
    flags = frame.identifier
    if flags & ERROR_FLAG:
        return "ErrorFrame"
    identifier = f"{flags & IDENTIFIER_BITS:X}{'x' if flags & EXTENDED_FLAG else ''}"
    head = f"{identifier:<15} {'Tx' if frame.sent else 'Rx'}  "
    if flags & REMOTE_FLAG:
        return f"{head} r"
    return f"{head} d {len(frame.data)} {frame.data.hex(' ').upper()}".rstrip()


_DAYS = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


def _date(microseconds: int) -> str:
    """Return a date in the form of Vector's tools: in the computer's local time, and in English for
    every locale.
    """
    at = (_EPOCH + timedelta(microseconds=microseconds)).astimezone()
    noon = "am" if at.hour < 12 else "pm"
    clock = f"{(at.hour + 11) % 12 + 1:02d}:{at:%M:%S}.{at.microsecond // 1000:03d} {noon}"
    return f"{_DAYS[at.weekday()]} {_MONTHS[at.month - 1]} {at.day:02d} {clock} {at.year}"


def _microseconds(time_ns: int) -> int:
    return (time_ns + 500) // 1000


TRAFFIC: Mapping[str, tuple[str, Callable[[TextIO, Iterator[RawFrame]], None]]] = {
    "candump": ("log", write_candump),
    "asc": ("asc", write_asc),
}
"""Extension of the files, and writer, by format."""


def export_traffic(folder: Path, record: RunRecord, path: Path, kind: str) -> Count:
    """Write the raw CAN frames of a run.

    Raises:
        InputError: The run has no CAN frames, or a recording is damaged.
        OSError: The file cannot be written.
    """
    count = Count(parts=[part.file for part in record.parts])
    with open(path, "w", encoding="ascii", newline="\n") as stream:
        TRAFFIC[kind][1](stream, can_frames(folder, record, count))
    if not count.frames:
        wire = "its bus is a serial line" if count.serial else "none was recorded"
        raise InputError(
            f"{folder}: no CAN frames to export ({wire}); --format mcap also exports serial bytes"
        )
    return count
