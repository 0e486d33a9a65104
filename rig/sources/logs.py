"""MCAP logs with JSON messages, as robot and vehicle loggers write them."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from zstandard import ZstdError

from identification.recording import Array
from rig.common.errors import InputError
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
                for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
                    if channel.message_encoding != "json":
                        others.add(f"{channel.topic} ({channel.message_encoding})")
                        continue
                    fields = dict(_numbers(json.loads(message.data), ""))
                    fields[LOG_TIME] = message.log_time * 1e-9
                    self._rows.setdefault(channel.topic, []).append(fields)
        except _DAMAGED as error:
            raise damaged(
                path, error, "recover it first; a run of this program is opened by its folder"
            ) from error
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
        values = np.fromiter((row.get(field, np.nan) for row in rows), np.float64, len(rows))
        return values - values[0] if field == LOG_TIME else values


def _numbers(value: object, prefix: str) -> Iterator[tuple[str, float]]:
    """Yield dotted name and value of every number inside a JSON message."""
    if isinstance(value, dict):
        for key, child in value.items():
            yield from _numbers(child, f"{prefix}.{key}" if prefix else str(key))
    elif isinstance(value, bool | int | float):
        yield prefix, float(value)
