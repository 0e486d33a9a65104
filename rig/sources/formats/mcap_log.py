"""MCAP logs with JSON messages, as robot and vehicle loggers write them."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message
from zstandard import ZstdError

from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.formats.cut_off import until_cut
from rig.sources.formats.json_numbers import Stamp, numbers, series
from rig.sources.formats.table import Table, damaged, open_binary

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
            fields = dict(numbers(json.loads(message.data), ""))
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
        return [series(self._rows[topic], field) for topic, field in wanted]
