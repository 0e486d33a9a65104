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
    end, the complete messages are read, with a note. A topic whose messages cannot be decoded is
    left out, with a note that states the reason. Each topic has its own time base; the logger's
    time is the common clock.

    Raises:
        InputError: The file is damaged, holds no messages that can be read, or a library that
            decodes the messages is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: dict[str, list[dict[str, float]]] = {}
        self._left_out: dict[str, str] = {}
        self._own = self._cut = False
        try:
            with open_binary(path) as stream:
                self._take(make_reader(stream, validate_crcs=True).iter_messages())
        except InputError:
            raise
        except _DAMAGED as error:
            if not self._take_cut_off():
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
        listed = ", ".join(f"{topic} ({why})" for topic, why in sorted(self._left_out.items()))
        if not self._rows:
            found = f"; found {listed}" if listed else ""
            remedy = (
                "open a run of this program by its folder, not by this file"
                if self._own
                else "write the numbers as JSON, CDR or protobuf messages, with a complete "
                "definition of each message"
            )
            raise InputError(
                f"{path}: cannot be read: no JSON, CDR or protobuf messages that can be "
                f"decoded{found}; {remedy}"
            )
        if listed:
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

    def _take(self, messages: Iterable[tuple[Schema | None, Channel, Message]]) -> None:
        """Store the numbers of messages, and why topics are left out."""
        decoders = Decoders(self.path)
        known: dict[int, Decoder] = {}
        for schema, channel, message in messages:
            topic = channel.topic
            if topic in self._left_out:
                continue
            kind = channel.message_encoding
            kind += f" with {schema.encoding}" if schema and schema.encoding else ""
            try:
                if channel.id not in known:
                    own = schema is not None and schema.name == SAMPLE_SCHEMA
                    self._own |= own
                    decoder = None if own else decoders.of(channel.message_encoding, schema)
                    if decoder is None:
                        self._left_out[topic] = kind
                        continue
                    known[channel.id] = decoder
                fields = known[channel.id](message.data)
            except InputError:
                raise
            except Exception as error:  # noqa: BLE001 - some errors of the decoders have no base class
                said = str(error).strip().splitlines()
                reason = said[0] if said else type(error).__name__
                self._left_out[topic] = f"{kind}: cannot be decoded: {reason}"
                self._rows.pop(topic, None)
                continue
            fields[LOG_TIME] = Stamp(message.log_time)
            self._rows.setdefault(topic, []).append(fields)

    def _take_cut_off(self) -> bool:
        """Read the complete messages of a file whose writer ended before it closed the file.

        Returns:
            Whether the file is cut off and holds messages. From a complete file with damage inside,
            no message is read.
        """
        self._rows.clear()
        self._left_out.clear()
        try:
            with open_binary(self.path) as stream:
                self._take(until_cut(stream))
        except InputError:
            raise
        except _DAMAGED:
            return False
        self._cut = True
        count = sum(len(rows) for rows in self._rows.values())
        self.note(f"the file is cut off: its {count} complete messages are read")
        return bool(count or self._left_out)

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
