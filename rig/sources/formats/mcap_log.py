"""Reads MCAP logs with JSON, CDR (ROS 2) and protobuf messages, which robot and vehicle loggers
write.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from zstandard import ZstdError

from identification.recording import Array
from rig.common.errors import InputError
from rig.runs.mcap.layout import SAMPLE_SCHEMA
from rig.sources.formats.cut_off import until_cut
from rig.sources.formats.json_numbers import Stamp, series
from rig.sources.formats.mcap_messages import Decoder, Decoders
from rig.sources.formats.table import Table, damaged, open_binary

LOG_TIME = "log_time"
# lz4 raises RuntimeError; a damaged length field may request more memory than available; the error
# of protobuf is a ValueError.
_DAMAGED = (
    McapError,
    ZstdError,
    struct.error,
    OSError,
    EOFError,
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    RuntimeError,
    MemoryError,
)


class McapTable(Table):
    """Table with one column for each number in the messages, named ``topic.field``, with dots for
    nesting.

    Messages are JSON, CDR of ROS 2 or protobuf. ``topic.log_time`` is the logger's time stamp in
    seconds since the first message of this topic. Elements of lists, including lists of messages,
    are ``topic.field[0]``; a stamp of ``sec`` and ``nanosec`` is one column. In a file without an
    end, the complete messages are read, with a note. Each topic has its own time base; the logger's
    time is the common clock.

    Raises:
        InputError: The file is damaged, holds no messages that can be read, or a library that
            decodes the messages is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: dict[str, list[dict[str, float]]] = {}
        self._cut = False
        others: set[str] = set()
        try:
            with open_binary(path) as stream:
                self._take(make_reader(stream, validate_crcs=True).iter_messages(), others)
        except InputError:
            raise
        except _DAMAGED as error:
            if not self._take_cut_off(others):
                remedy = (
                    "recover this file with `mcap recover`; open a run of this program by its "
                    "folder"
                )
                if self._cut:
                    raise InputError(
                        f"{path}: cannot be read: cut off before the first complete message; write "
                        f"logs with smaller chunks, or {remedy}"
                    ) from error
                raise damaged(path, error, remedy) from error
        listed = ", ".join(sorted(others))
        if not self._rows:
            found = f"; found {listed}" if others else ""
            raise InputError(
                f"{path}: no JSON, CDR or protobuf messages{found}; open a run of this program "
                f"by its folder, not by this file"
            )
        if others:
            self.note(f"left out: {listed}")
        self._topics = list(self._rows)
        self._columns = [
            (topic, field)
            for topic, rows in self._rows.items()
            for field in dict.fromkeys(field for row in rows for field in row)
        ]
        self.names = tuple(f"{topic}.{field}" for topic, field in self._columns)
        self.bases = tuple(self._topics.index(topic) for topic, _ in self._columns)
        self.base_names = tuple(self._topics)

    def _take(
        self, messages: Iterable[tuple[Schema | None, Channel, Message]], others: set[str]
    ) -> None:
        """Store the numbers of messages; ``others`` receives the topics that cannot be read."""
        decoders = Decoders(self.path)
        known: dict[int, Decoder | None] = {}
        for schema, channel, message in messages:
            if channel.id not in known:
                own = schema is not None and schema.name == SAMPLE_SCHEMA
                decoder = None if own else decoders.of(channel.message_encoding, schema)
                known[channel.id] = decoder
                if decoder is None:
                    kind = channel.message_encoding
                    kind += f" with {schema.encoding}" if schema and schema.encoding else ""
                    others.add(f"{channel.topic} ({kind})")
            decode = known[channel.id]
            if decode is None:
                continue
            fields = decode(message.data)
            fields[LOG_TIME] = Stamp(message.log_time)
            self._rows.setdefault(channel.topic, []).append(fields)

    def _take_cut_off(self, others: set[str]) -> bool:
        """Read the complete messages of a file whose writer ended before it closed the file.

        Returns:
            Whether the file is cut off and holds messages. From a complete file with damage inside,
            no message is read.
        """
        self._rows.clear()
        try:
            with open_binary(self.path) as stream:
                self._take(until_cut(stream), others)
        except InputError:
            raise
        except _DAMAGED:
            return False
        self._cut = True
        count = sum(len(rows) for rows in self._rows.values())
        self.note(f"the file is cut off: its {count} complete messages are read")
        return bool(count or others)

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`. A field absent from a message is NaN."""
        self.require_one_base(columns)
        found = []
        for k in columns:
            topic, field = self._columns[k]
            values, note = series(self._rows[topic], field)
            if note:
                self.note(f"`{self.names[k]}`: {note}")
            found.append(values)
        return found

    def stamps(self, base: int) -> Array | None:
        """Return the logger's time stamps of a topic, s since the first message of the file."""
        first = min(rows[0][LOG_TIME] for rows in self._rows.values())
        rows: list[dict[str, Any]] = [{LOG_TIME: first}, *self._rows[self._topics[base]]]
        return series(rows, LOG_TIME)[0][1:]
