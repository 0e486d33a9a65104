"""Reads recorded CAN traffic with python-can (candump, Vector ASC and BLF, PEAK TRC, and the bus
logging of MDF), and its signals by a DBC file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TextIO, cast

import can
import can.io
import numpy as np
from numpy.typing import NDArray

from drivers.can.port import ERROR_FLAG, EXTENDED_FLAG, hexadecimal
from drivers.dbc.file import load_dbc
from drivers.errors import ConfigurationError
from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.repair import Mask
from rig.sources.table import (
    Array,
    Column,
    Table,
    as_doubles,
    damaged,
    format_of,
    heard,
    library,
    open_binary,
)
from rig.sources.text import encoding_of, open_text

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
    """State of the filtering of a file: the current line, and the counts of dropped lines."""

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
    """Yield the frames of ``candump -L``, with times since the first, or raise an InputError."""
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
    """Yield the lines of a PEAK TRC file without its date; InputError for an unknown version."""
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


_REMEDY = "check that the file was copied completely"
_TEXTS: Mapping[str, tuple[Any, Callable[[Lines, TextIO], Iterator[str]]]] = {
    "log": (can.io.CanutilsLogReader, candump),
    "asc": (can.io.ASCReader, asc),
    "trc": (can.io.TRCReader, trc),
}
"""Reader and filter of the lines of text formats, by file extension."""
_FROM_ZERO = frozenset({"asc", "blf"})
"""Formats in which channels are numbered from 1, but by python-can from 0."""

Key = tuple[str, int]
"""Bus and identifier of a frame; in a 29-bit identifier, :data:`EXTENDED_FLAG` is set."""


@dataclass(frozen=True)
class Frames:
    """All frames of one identifier on one bus."""

    stamps: Array  # time since the first frame of the file, s, shape (n,)
    data: NDArray[np.uint8]  # data bytes, zero beyond the length of each frame, shape (n, longest)
    lengths: NDArray[np.intp]  # number of data bytes of each frame, shape (n,)


def _read_traffic(path: Path) -> tuple[dict[Key, Frames], list[str]]:
    """Return data frames by bus and identifier, in order of appearance, and notes."""
    kind = format_of(path)
    lines = Lines(path)
    notes = lines.notes
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
    except Exception as error:
        place = f"line {lines.number}: " if lines.number else ""
        raise damaged(path, f"{place}{error!r}", _REMEDY) from error
    notes += [f"python-can: {words}" for words in said]
    if lines.errors:
        notes.append(f"{lines.errors} error frames left out")
    if remote:
        notes.append(f"{remote} remote frames left out")
    if lines.stamped > read + lines.errors:
        notes.append(f"{lines.stamped - read - lines.errors} lines that are not frames left out")
    if not stamps:
        raise InputError(f"{path}: holds no data frames" + "".join(f"; {n}" for n in notes))
    first = min(times[0] for times in stamps.values())
    frames = {}
    for key, times in stamps.items():
        lengths = np.array([len(one) for one in data[key]], np.intp)
        longest = int(lengths.max())
        joined = b"".join(one.ljust(longest, b"\0") for one in data[key])
        packed = np.frombuffer(joined, np.uint8).reshape(len(times), longest)
        frames[key] = Frames(np.array(times, np.float64) - first, packed, lengths)
    return frames, notes


def _messages(path: Path, kind: str, lines: Lines) -> Iterator[can.Message]:
    if kind == "blf":
        yield from _blf(path, lines)
    elif kind not in _TEXTS:
        yield from _mf4(path)
    else:
        reader, lines_of = _TEXTS[kind]
        with open_text(path, encoding_of(path)) as stream:
            yield from reader(_Source(lines_of(lines, stream)))


class _Source:
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
    library("asammdf", path, "MDF", "mdf")
    with heard("asammdf"), open_binary(path) as stream:
        reader = can.io.MF4Reader(cast(BinaryIO, stream))
        # Seconds since 1970 leave a double a quarter of a microsecond.
        reader._start_timestamp = 0.0
        yield from reader


def _blf(path: Path, lines: Lines) -> Iterator[can.Message]:
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


MOST_BITS = 64
_FLOATS = {16: (np.uint16, np.float16), 32: (np.uint32, np.float32), 64: (np.uint64, np.float64)}
"""Types of the bits and of the value of a floating-point number, by its width, bits."""


@dataclass(frozen=True)
class _Signal:
    """A signal of a CAN message, and where it is in a frame."""

    stated: Any  # the signal of the DBC file, in the form of cantools
    # Numbers of the bits in the frame, least significant first; bit 0 is the lowest bit of the
    # first byte.
    positions: Sequence[int]
    # The multiplexer that determines whether the signal is in a frame, or None for a signal that is
    # in every frame.
    selector: _Signal | None

    @property
    def scale(self) -> tuple[float, float]:
        """Factor and offset of the value."""
        return float(self.stated.scale), float(self.stated.offset)

    def present(self, frames: Frames) -> Mask:
        """Return a mask of the frames that contain the signal, by their length and multiplexers."""
        there: Mask = frames.lengths > max(self.positions) // 8
        if self.selector is not None:
            there = there & self.selector.present(frames)
            there = there & np.isin(self.selector.bits(frames), self.stated.multiplexer_ids)
        return there

    def bits(self, frames: Frames) -> NDArray[np.uint64]:
        """Return the raw bits in each frame; zero if a frame is too short."""
        value = np.zeros(len(frames.data), np.uint64)
        for place, position in enumerate(self.positions):
            byte, low = divmod(position, 8)
            if byte < frames.data.shape[1]:
                bit = (frames.data[:, byte] >> np.uint8(low)) & np.uint8(1)
                value |= bit.astype(np.uint64) << np.uint64(place)
        return value

    def values(self, frames: Frames, rows: Mask) -> tuple[Array, str]:
        """Return the values in the given frames, and a note if values were changed."""
        bits, (factor, offset) = self.bits(frames)[rows], self.scale
        if self.stated.is_float:
            unsigned, kind = _FLOATS[len(self.positions)]
            # The bits of a float may also represent NaN or infinity.
            with np.errstate(over="ignore", invalid="ignore"):
                return bits.astype(unsigned).view(kind).astype(np.float64) * factor + offset, ""
        whole: NDArray[np.uint64] | NDArray[np.int64] = bits
        if self.stated.is_signed:
            shift = np.uint64(MOST_BITS - len(self.positions))
            whole = (bits << shift).view(np.int64) >> np.int64(shift)
        if (factor, offset) == (1.0, 0.0):
            return as_doubles(whole)
        return whole.astype(np.float64) * factor + offset, ""


class _Message(NamedTuple):
    """A CAN message of the DBC file, its signals that can be read, and what is wrong with it."""

    stated: Any
    identifier: int
    signals: tuple[_Signal, ...]
    left_out: tuple[str, ...]
    fault: str


def _big_endian(start: int, width: int) -> tuple[int, ...]:
    """Return the bits of a big-endian signal by the DBC number of its highest, lowest first."""
    positions = [start]
    while len(positions) < width:
        at = positions[-1]
        positions.append(at + 15 if at % 8 == 0 else at - 1)
    return tuple(positions[::-1])


def _messages_of(path: Path) -> list[_Message]:
    try:
        database, faults = load_dbc(path)
    except ConfigurationError as error:
        raise InputError(str(error)) from error
    return [_message(message, faults.get(at, "")) for at, message in enumerate(database.messages)]


def _message(message: Any, fault: str) -> _Message:
    found: dict[str, _Signal] = {}
    left_out: list[str] = []
    if message.is_container:
        left_out.append(f"{message.name} (a container of other messages)")
    by_name = {signal.name: signal for signal in message.signals}
    for signal in message.signals:
        words = _obstacle(signal)
        if words:
            left_out.append(f"{message.name}.{signal.name} ({words})")
        elif not message.is_container:
            _add_signal(signal, by_name, found)
    signals = tuple(found[name] for name in by_name if name in found)
    flag = EXTENDED_FLAG if message.is_extended_frame else 0
    return _Message(message, message.frame_id | flag, signals, tuple(left_out), fault)


def _obstacle(signal: Any) -> str:
    if signal.length > MOST_BITS:
        return f"{signal.length} bits, at most {MOST_BITS} are read"
    if signal.is_float and signal.length not in _FLOATS:
        return f"a floating-point number of {signal.length} bits"
    return ""


def _add_signal(signal: Any, by_name: dict[str, Any], found: dict[str, _Signal]) -> None:
    """Add a signal and its multiplexers to ``found``, unless one of them cannot be read."""
    if signal.name in found:
        return
    selector = None
    if signal.multiplexer_ids and signal.multiplexer_signal:
        above = by_name.get(signal.multiplexer_signal)
        if above is None or above is signal or _obstacle(above):
            return
        _add_signal(above, by_name, found)
        selector = found.get(above.name)
        if selector is None:
            return
    positions = (
        range(signal.start, signal.start + signal.length)
        if signal.byte_order == "little_endian"
        else _big_endian(signal.start, signal.length)
    )
    found[signal.name] = _Signal(signal, positions, selector)


STAMPS = "time"  # name of the column of a message's time stamps
_OTHER_STAMPS = "frame_time"
_MOST_NAMED = 6
_DESTINATION_FORMATS = 240
"""PDU format of SAE J1939 below which the PDU specific byte is a destination address."""


class _Base(NamedTuple):
    """Frames with certain signals: all of a message, or those of some of its pages."""

    frames: Frames
    rows: Mask


class CanTable(Table):
    """Table with one column per signal, named ``Message.Signal``, and the time stamps of each
    message, ``Message.time``, in s since the first frame of the file.

    Each message has its own time base. Signals that a multiplexer puts into only some frames of a
    message also have their own time base (``Message.Signal.time``). All time bases are on the clock
    of the file. The name of a message that occurs on several buses begins with the bus. Error
    frames, remote frames and frames of unknown messages are left out and counted.
    """

    def __init__(self, path: Path, options: ReadSection) -> None:
        self.path = path
        found_frames, notes = _read_traffic(path)
        for words in notes:
            self.note(words)
        frames = self._of_bus(found_frames, options.bus)
        if not options.dbc_files:
            raise InputError(
                f"{path}: CAN traffic, {_listed(frames)}; the meaning of the frames is unknown: "
                "give a DBC file (read.dbc, or --dbc)"
            )
        known = [message for name in options.dbc_files for message in _messages_of(Path(name))]
        named = self._named(frames, _by_identifier(known, {i for _, i in frames}))
        self._bases: list[_Base] = []
        columns: list[Column] = []
        base_names: list[str] = []
        for name, message, found in named:
            taken = {signal.stated.name for signal in message.signals}
            stamps = _OTHER_STAMPS if STAMPS in taken else STAMPS
            for suffix, base, signals in _pages(message, found):
                place = len(self._bases)
                self._bases.append(base)
                base_names.append(f"{name}{suffix}")
                columns.append(Column(f"{name}{suffix}.{stamps}", None, "s", place))
                for signal in signals:
                    stated = signal.stated
                    scale = None if stated.is_float else signal.scale
                    whole_name, unit = f"{name}.{stated.name}", str(stated.unit or "")
                    columns.append(Column(whole_name, signal, unit, place, scale))
        if not columns:
            raise InputError(f"{path}: no signal of the map fits into the frames of the file")
        self._lay_out(columns, base_names)

    def _of_bus(self, frames: Mapping[Key, Frames], bus: str | int | None) -> dict[Key, Frames]:
        """Return the frames of one bus, or of all buses."""
        if bus is None:
            return dict(frames)
        kept = {key: found for key, found in frames.items() if key[0] == str(bus)}
        if not kept:
            there = ", ".join(dict.fromkeys(key[0] for key in frames))
            raise InputError(
                f"{self.path}: the file has no bus {bus}; set read.bus to one of {there}"
            )
        return kept

    def _named(
        self, frames: Mapping[Key, Frames], known: Mapping[int, _Message]
    ) -> list[tuple[str, _Message, Frames]]:
        """Return name, message and frames of each message in the file; note the unknown frames."""
        groups = {
            _group(m.identifier): m
            for m in known.values()
            if m.stated.protocol == "j1939" and m.stated.is_extended_frame
        }
        found: list[tuple[str, int, _Message, Frames]] = []
        unknown: dict[Key, Frames] = {}
        for (bus, identifier), one in frames.items():
            message = known.get(identifier)
            if message is None and identifier & EXTENDED_FLAG:
                message = groups.get(_group(identifier))
            if message is None:
                unknown[bus, identifier] = one
            else:
                found.append((bus, identifier, message, one))
        if not found:
            raise InputError(
                f"{self.path}: none of the {len(known)} messages of the map is in the file, which "
                f"holds {_listed(frames)}; name the DBC file of this bus"
            )
        if unknown:
            count = sum(len(one.stamps) for one in unknown.values())
            self.note(f"{count} frames of unknown messages left out: {_listed(unknown)}")
        result = []
        for bus, identifier, message, one in found:
            for words in message.left_out:
                self.note(f"left out: {words}")
            if message.fault:
                self.note(
                    f"{message.fault}: every signal is read from the bits that the DBC states; the "
                    f"values of these signals are doubtful; correct the DBC file"
                )
            same = [(b, i) for b, i, m, _ in found if m is message]
            name = message.stated.name
            if len({b for b, _ in same}) > 1:
                name = f"{bus}.{name}"
            if len({i for _, i in same}) > 1:
                name = f"{name}[{identifier & 0xFF:02X}h]"
            if identifier != message.identifier:
                self.note(
                    f"{name}: matched by its J1939 parameter group, source address "
                    f"{identifier & 0xFF:02X}h"
                )
            result.append((name, message, one))
        return result

    def _read(self, columns: Sequence[int]) -> list[Array]:
        found = []
        for k in columns:
            base, signal = self._bases[self.bases[k]], self._sources[k]
            if signal is None:
                found.append(base.frames.stamps[base.rows])
                continue
            values, note = signal.values(base.frames, base.rows)
            if note:
                self.note(f"`{self.names[k]}`: {note}")
            self._check_range(self.names[k], signal, values)
            found.append(values)
        return found

    def _check_range(self, name: str, signal: _Signal, values: Array) -> None:
        low, high = signal.stated.minimum, signal.stated.maximum
        if low is None or high is None or not low < high:
            return
        low, high = float(low), float(high)
        slack = 1e-9 * max(abs(low), abs(high))
        outside = int(np.sum((values < low - slack) | (values > high + slack)))
        if outside:
            self.note(
                f"`{name}`: {outside} of {len(values)} values are outside of {low:g} to "
                f"{high:g}, the range in the DBC file; some devices send such values if "
                f"they have no valid value"
            )

    def stamps(self, base: int) -> Array | None:
        """Return the time stamps of a message's frames; see :meth:`Table.stamps`."""
        found = self._bases[base]
        return found.frames.stamps[found.rows]


def _pages(message: _Message, frames: Frames) -> Iterator[tuple[str, _Base, list[_Signal]]]:
    """Yield signals that occur in equal sets of frames, with a suffix for their time base."""
    every = np.ones(len(frames.stamps), dtype=np.bool_)
    groups: dict[bytes, tuple[Mask, list[_Signal]]] = {every.tobytes(): (every, [])}
    for signal in message.signals:
        rows = signal.present(frames)
        if rows.any():
            groups.setdefault(rows.tobytes(), (rows, []))[1].append(signal)
    for rows, signals in groups.values():
        if signals:
            suffix = "" if rows.all() else f".{signals[0].stated.name}"
            yield suffix, _Base(frames, rows), signals


def _by_identifier(messages: Iterable[_Message], seen: Set[int]) -> dict[int, _Message]:
    found: dict[int, _Message] = {}
    for message in messages:
        other = found.setdefault(message.identifier, message)
        if other is not message and message.identifier in seen:
            raise InputError(
                f"{other.stated.name} and {message.stated.name} of the DBC files both have the "
                f"identifier {hexadecimal(message.identifier)}; name only the DBC file of one bus, "
                "and set read.bus to this bus"
            )
    return found


def _group(identifier: int) -> int:
    """Return the parameter group of a 29-bit identifier (SAE J1939-21)."""
    group = identifier >> 8 & 0x3FFFF
    return group & 0x3FF00 if group >> 8 & 0xFF < _DESTINATION_FORMATS else group


def _listed(frames: Mapping[Key, Frames]) -> str:
    several = len({bus for bus, _ in frames}) > 1
    names = [
        f"{hexadecimal(identifier)}{f' on {bus}' if several else ''}" for bus, identifier in frames
    ]
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f"identifiers {', '.join(names[:_MOST_NAMED])}{more}"
