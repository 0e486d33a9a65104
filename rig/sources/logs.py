"""MCAP logs with JSON messages, as robot and vehicle loggers write them."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message
from zstandard import ZstdError

from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.cut_off import until_cut
from rig.sources.table import Table, damaged, open_binary

LOG_TIME = "log_time"
# lz4 raises RuntimeError; a damaged length field may request more memory than available.
_DAMAGED = (
    McapError,
    ZstdError,
    struct.error,
    OSError,
    EOFError,
    ValueError,
    LookupError,
    RuntimeError,
    MemoryError,
)


class McapTable(Table):
    """One column per number in the JSON messages, named ``topic.field``, with dots for nesting.

    ``topic.log_time`` is the logger's time stamp in seconds since the first message of that topic.
    Elements of a list are ``topic.field[0]``; a stamp of ``sec`` and ``nanosec`` is one column. Of
    a file without an end, the whole messages are read, with a note.
    All columns read together must come from one topic, because only then do they share rows.

    Raises:
        InputError: The file is damaged, or holds no JSON messages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: dict[str, list[dict[str, float]]] = {}
        others: set[str] = set()
        try:
            with open_binary(path) as stream:
                self._take(make_reader(stream, validate_crcs=True).iter_messages(), others)
        except _DAMAGED as error:
            if not self._take_cut_off(others):
                remedy = "recover it first; a run of this program is opened by its folder"
                if self._cut:
                    raise InputError(
                        f"{path}: cannot be read: cut off before its first whole message; log in "
                        f"smaller chunks, or {remedy}"
                    ) from error
                raise damaged(path, error, remedy) from error
        if not self._rows:
            found = f"; found {', '.join(sorted(others))}" if others else ""
            raise InputError(
                f"{path}: no JSON messages{found}; a run of this program is opened by its folder, "
                f"not by this file"
            )
        self._columns = [
            (topic, field)
            for topic, rows in self._rows.items()
            for field in dict.fromkeys(field for row in rows for field in row)
        ]
        self.names = tuple(f"{topic}.{field}" for topic, field in self._columns)

    def _take(self, messages: Iterable[tuple[Any, Channel, Message]], others: set[str]) -> None:
        """Keep the numbers of JSON messages; ``others`` receives the rest of the topics."""
        for _, channel, message in messages:
            if channel.message_encoding != "json":
                others.add(f"{channel.topic} ({channel.message_encoding})")
                continue
            fields = dict(_numbers(json.loads(message.data), ""))
            fields[LOG_TIME] = Stamp(message.log_time)
            self._rows.setdefault(channel.topic, []).append(fields)

    def _take_cut_off(self, others: set[str]) -> bool:
        """Read the whole messages of a file whose writer ended before it closed the file.

        Returns:
            Whether the file is cut off and holds messages. Of a file with a sound end and damage
            inside, nothing is taken.
        """
        self._rows.clear()
        self._cut = False
        try:
            with open_binary(self.path) as stream:
                self._take(until_cut(stream), others)
        except _DAMAGED:
            return False
        self._cut = True
        count = sum(len(rows) for rows in self._rows.values())
        self.notes = (
            *self.notes,
            f"the file is cut off: read up to its last whole message, {count} messages",
        )
        return bool(count or others)

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`. A field absent from a message is NaN."""
        wanted = [self._columns[k] for k in columns]
        topics = sorted({topic for topic, _ in wanted})
        if len(topics) > 1:
            raise InputError(
                f"{self.path}: columns of several topics ({', '.join(topics)}) share no rows; use "
                f"those of one topic"
            )
        return [self._series(topic, field) for topic, field in wanted]

    def _series(self, topic: str, field: str) -> Array:
        rows = self._rows[topic]
        if any(isinstance(row.get(field), Stamp) for row in rows):
            # Nanoseconds since 1970 exceed a double's 53 bits; their differences do not.
            known = [row.get(field) for row in rows]
            first = next(stamp for stamp in known if isinstance(stamp, Stamp))
            return np.array(
                [(s - first) * 1e-9 if isinstance(s, Stamp) else np.nan for s in known], np.float64
            )
        return np.fromiter((row.get(field, np.nan) for row in rows), np.float64, len(rows))


class Stamp(int):
    """A time stamp in nanoseconds; read as seconds since the first of its topic."""


LONGEST_LIST = 64
"""Elements of a list that become columns; longer ones are images and the like, and are left out."""
_STAMPS = ({"sec", "nanosec"}, {"secs", "nsecs"}, {"sec", "nsec"}, {"seconds", "nanos"})


def _numbers(value: object, prefix: str) -> Iterator[tuple[str, float]]:
    """Yield dotted name and value of every number inside a JSON message.

    An element of a list is ``name[0]``. A time stamp of seconds and nanoseconds is one more column
    under the name of both.
    """
    if isinstance(value, dict):
        for key, child in value.items():
            yield from _numbers(child, f"{prefix}.{key}" if prefix else str(key))
        if prefix and set(value) in _STAMPS and all(isinstance(v, int) for v in value.values()):
            whole, rest = (value[key] for key in sorted(value, key=lambda key: key[0] == "n"))
            yield prefix, Stamp(whole * 10**9 + rest)
    elif isinstance(value, list) and len(value) <= LONGEST_LIST:
        for index, child in enumerate(value):
            yield from _numbers(child, f"{prefix}[{index}]")
    elif isinstance(value, bool | int | float):
        yield prefix, float(value)
