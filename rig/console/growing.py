"""Reads a recording in blocks while the run still writes it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from mcap.opcode import Opcode

from drivers.plain_file import require_plain
from identification.recording import Array
from rig.runs.mcap.layout import EVENT_TOPIC, SAMPLE_SIZES, SAMPLE_TOPIC, TOPICS, decode_samples
from rig.runs.mcap.records import HEADER, MAX_CHUNK, DamageError, chunk
from rig.runs.mcap.stream import chunk_messages
from rig.runs.mcap.writer import MAGIC

READ_BYTES = 1 << 19
"""Greatest number of bytes that one call reads, so that a long recording does not block the
console.
"""
_SAMPLES = TOPICS.index(SAMPLE_TOPIC) + 1
_EVENTS = TOPICS.index(EVENT_TOPIC) + 1


class News(NamedTuple):
    """Content that was added to a recording.

    Attributes:
        samples: Arrays of shape (n,), by field of :class:`rig.common.sample.Sample`; empty without
            samples.
        events: Events, each with ``time`` and ``event``.
        more: Whether more content can be read immediately.
    """

    samples: Mapping[str, Array]
    events: tuple[Mapping[str, Any], ...]
    more: bool


class Growing:
    """A recording that may still grow.

    Args:
        path: The recording.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0

    def read(self) -> News:
        """Read the bytes that were added since the last call, at most :data:`READ_BYTES`.

        Raises:
            OSError: The file cannot be read.
            DamageError: The file is damaged, or another program wrote it.
        """
        require_plain(self._path)
        samples: list[bytes] = []
        events: list[Mapping[str, Any]] = []
        with open(self._path, "rb") as stream:
            if not self._offset:
                if not self._begins(stream.read(len(MAGIC))):
                    return News({}, (), False)
                self._offset = len(MAGIC)
            stream.seek(self._offset)
            data = stream.read(READ_BYTES)
            used = _records(data, samples, events)
            length = HEADER.unpack_from(data)[1] if not used and len(data) >= HEADER.size else 0
            if READ_BYTES < length + HEADER.size <= MAX_CHUNK:
                # One record is larger than the block: an attachment, or a chunk of another writer.
                data += stream.read(length + HEADER.size - len(data))
                used = _records(data, samples, events)
        self._offset += used
        return News(_decoded(samples), tuple(events), used > 0 and len(data) >= READ_BYTES)

    def _begins(self, magic: bytes) -> bool:
        """Return whether the file has the complete first bytes of a recording.

        Raises:
            DamageError: The first bytes are not those of a recording.
        """
        if not MAGIC.startswith(magic):
            raise DamageError(f"{self._path}: not an MCAP recording")
        return magic == MAGIC


def _records(data: bytes, samples: list[bytes], events: list[Mapping[str, Any]]) -> int:
    """Sort the messages of complete records into samples and events; return the length of these
    records, bytes.

    Raises:
        DamageError: A record is damaged.
    """
    samples.clear()
    events.clear()
    offset = 0
    while offset + HEADER.size <= len(data):
        opcode, length = HEADER.unpack_from(data, offset)
        start, end = offset + HEADER.size, offset + HEADER.size + length
        if opcode not in _OPCODES:
            raise DamageError(f"no record begins with the byte {opcode:02X}h")
        if end > len(data):
            break
        if opcode == Opcode.CHUNK:
            found, _ = chunk_messages(chunk(data[start:end]), frozenset({_SAMPLES, _EVENTS}))
            samples += found.get(_SAMPLES, [])
            events += [json.loads(content) for content in found.get(_EVENTS, [])]
        offset = end
    return offset


_OPCODES = frozenset(map(int, Opcode))


def _decoded(samples: list[bytes]) -> dict[str, Array]:
    if not samples:
        return {}
    size = len(samples[0])
    if size not in SAMPLE_SIZES or any(len(sample) != size for sample in samples):
        raise DamageError(f"a sample has {size} bytes, a size that this program does not write")
    return decode_samples(b"".join(samples), size)
