"""Converts recorded CAN traffic to a table: one column per signal, one time base per message."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.can.port import EXTENDED_FLAG, hexadecimal
from identification.recording import Array
from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.can_traffic.bench_map import (
    BusMessage,
    BusSignal,
    Mask,
    messages_of,
    messages_of_bench,
)
from rig.sources.can_traffic.frames import Frames, Key, read_traffic
from rig.sources.formats.table import Table

STAMPS = "time"
"""Name of the column of a message's time stamps."""
_OTHER_STAMPS = "frame_time"
_MOST_NAMED = 6
_DESTINATION_FORMATS = 240
"""PDU format of SAE J1939 below which the PDU specific byte is a destination address, and not a
group extension.
"""


class _Base(NamedTuple):
    """Frames that contain certain signals: all frames of a message, or the frames of some of its
    pages.
    """

    frames: Frames
    rows: Mask


class _Column(NamedTuple):
    base: int
    signal: BusSignal | None
    """Signal of the column, or None for the column of time stamps."""


class CanTable(Table):
    """Table with one column per signal, named ``Message.Signal``, and the time stamps of each
    message, ``Message.time``, in s since the first frame of the file.

    Each message has its own time base. Signals that a multiplexer puts into only some frames of a
    message also have their own time base (``Message.Signal.time``). All time bases are on the clock
    of the file. The name of a message that occurs on several buses begins with the bus. Error
    frames, remote frames and frames of unknown messages are left out and counted.

    Args:
        path: The file.
        options: The DBC files or the bench file, and the bus.

    Raises:
        InputError: No DBC or bench file is given or can be read, none of its messages is in the
            file, or the file is damaged.
    """

    def __init__(self, path: Path, options: ReadSection) -> None:
        self.path = path
        traffic = read_traffic(path)
        for words in traffic.notes:
            self.note(words)
        frames = self._of_bus(traffic.frames, options.bus)
        if not options.dbc_files and options.bench is None:
            raise InputError(
                f"{path}: CAN traffic, {_listed(frames)}; the meaning of the frames is unknown: "
                "give a DBC file (read.dbc, or --dbc), or the bench file of the drive "
                "(read.bench, or --bench)"
            )
        known = [message for name in options.dbc_files for message in messages_of(Path(name))]
        if options.bench is not None:
            known = messages_of_bench(Path(options.bench))
        named = self._named(frames, _by_identifier(known, {i for _, i in frames}))
        self._bases: list[_Base] = []
        self._columns: list[_Column] = []
        names: list[str] = []
        base_names: list[str] = []
        for name, message, found in named:
            for suffix, base, signals in _pages(message, found):
                place = len(self._bases)
                self._bases.append(base)
                prefix = f"{name}." if name else ""
                base_names.append(f"{name}{suffix}")
                self._columns += [_Column(place, None), *(_Column(place, s) for s in signals)]
                taken = {signal.name for signal in message.signals}
                stamps = _OTHER_STAMPS if STAMPS in taken else STAMPS
                names.append(f"{prefix}{suffix[1:]}.{stamps}" if suffix else f"{prefix}{stamps}")
                names += [f"{prefix}{signal.name}" for signal in signals]
        if not names:
            raise InputError(f"{path}: no signal of the map fits into the frames of the file")
        self.names = tuple(names)
        self.base_names = tuple(base_names)
        self.bases = tuple(column.base for column in self._columns)
        self.units = tuple("s" if c.signal is None else c.signal.unit for c in self._columns)
        self.counts = {
            k: (c.signal.factor, c.signal.offset)
            for k, c in enumerate(self._columns)
            if c.signal is not None and not c.signal.real
        }

    def _of_bus(self, frames: Mapping[Key, Frames], bus: str | int | None) -> dict[Key, Frames]:
        """Return the frames of one bus, or of all buses.

        Raises:
            InputError: The file has no such bus.
        """
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
        self, frames: Mapping[Key, Frames], known: Mapping[int, BusMessage]
    ) -> list[tuple[str, BusMessage, Frames]]:
        """Return name, message and frames of each message that is in the file, and note the frames
        of unknown messages.

        Raises:
            InputError: None of the known messages is in the file.
        """
        groups = {_group(m.identifier): m for m in known.values() if m.by_group}
        found: list[tuple[str, int, BusMessage, Frames]] = []
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
                f"holds {_listed(frames)}; name the DBC file of this bus or, with a bench file, "
                "check its node numbers"
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
            name = message.name
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

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        self.require_one_base(columns)
        found = []
        for k in columns:
            base, signal = self._bases[self._columns[k].base], self._columns[k].signal
            if signal is None:
                found.append(base.frames.stamps[base.rows])
                continue
            values, note = signal.values(base.frames, base.rows)
            if note:
                self.note(f"`{self.names[k]}`: {note}")
            self._check_range(self.names[k], signal, values)
            found.append(values)
        return found

    def _check_range(self, name: str, signal: BusSignal, values: Array) -> None:
        if signal.low is None or signal.high is None:
            return
        slack = 1e-9 * max(abs(signal.low), abs(signal.high))
        outside = int(np.sum((values < signal.low - slack) | (values > signal.high + slack)))
        if outside:
            self.note(
                f"`{name}`: {outside} of {len(values)} values are outside of {signal.low:g} to "
                f"{signal.high:g}, the range in the DBC file; some devices send such values if "
                f"they have no valid value"
            )

    def stamps(self, base: int) -> Array | None:
        """Return the time stamps of a message's frames; see :meth:`Table.stamps`."""
        found = self._bases[base]
        return found.frames.stamps[found.rows]


def _pages(message: BusMessage, frames: Frames) -> Iterator[tuple[str, _Base, list[BusSignal]]]:
    """Yield groups of signals that occur in equal sets of frames, each with a suffix for the name
    of the group's time base.
    """
    every = np.ones(len(frames.stamps), dtype=np.bool_)
    groups: dict[bytes, tuple[Mask, list[BusSignal]]] = {every.tobytes(): (every, [])}
    for signal in message.signals:
        rows = signal.present(frames)
        if rows.any():
            groups.setdefault(rows.tobytes(), (rows, []))[1].append(signal)
    for rows, signals in groups.values():
        if signals:
            suffix = "" if rows.all() else f".{signals[0].name}"
            yield suffix, _Base(frames, rows), signals


def _by_identifier(messages: Iterable[BusMessage], seen: Set[int]) -> dict[int, BusMessage]:
    """Return messages by identifier.

    Raises:
        InputError: Two messages have one identifier, and the file has frames with this identifier.
    """
    found: dict[int, BusMessage] = {}
    for message in messages:
        other = found.setdefault(message.identifier, message)
        if other is not message and message.identifier in seen:
            raise InputError(
                f"{other.name} and {message.name} of the DBC files both have the identifier "
                f"{hexadecimal(message.identifier)}; name only the DBC file of one bus, and set "
                "read.bus to this bus"
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
