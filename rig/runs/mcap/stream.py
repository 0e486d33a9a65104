"""Reads a whole recording piece by piece; the required memory does not grow with the length of the
recording.

The module is for recordings that were closed regularly. A damaged recording is read by
:func:`rig.runs.mcap.reader.read_run`, which keeps the whole recording in memory and finds sound
records after the damage.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from rig.common.places import require_plain
from rig.runs.mcap.layout import EVENT_TOPIC, SAMPLE_SIZES, SAMPLE_TOPIC, TOPICS, decode_samples
from rig.runs.mcap.records import (
    HEADER,
    DamageError,
    attachment,
    chunk,
    metadata,
    statistics,
)
from rig.runs.mcap.writer import MAGIC, MESSAGE

BLOCK_BYTES = 1 << 20
MAX_ATTACHMENT = 1 << 26
"""Length of a record before the first messages above which the record counts as damaged, bytes."""
_SAMPLES = TOPICS.index(SAMPLE_TOPIC) + 1
_EVENTS = TOPICS.index(EVENT_TOPIC) + 1
_ATTACHMENTS = 0
"""Key of attachments; the key of messages is the number of their channel."""


class Block(NamedTuple):
    """Consecutive samples: arrays of shape (n,), by field."""

    samples: Mapping[str, NDArray[np.float64]]


class Happening(NamedTuple):
    """One recorded event, with ``time`` and ``event``."""

    event: Mapping[str, Any]


class Attached(NamedTuple):
    """One attachment of a recording."""

    name: str
    content: bytes


def sample_blocks(path: Path, fields: Sequence[str]) -> Iterator[dict[str, NDArray[np.float64]]]:
    """Yield the samples in order, in blocks of about :data:`BLOCK_BYTES`.

    Args:
        path: The recording.
        fields: Fields of :class:`rig.common.sample.Sample` to read.

        Yields:
            Arrays of shape (n,), by field.

    Raises:
        DamageError: The recording is not complete; all samples yielded so far are valid.
        OSError: The file cannot be read.
    """
    for item in _items(path, fields, frozenset({_SAMPLES})):
        if isinstance(item, Block):
            yield dict(item.samples)


def run_items(path: Path, fields: Sequence[str]) -> Iterator[Block | Happening | Attached]:
    """Yield the content of a recording except its frames.

    Events come before the block with the samples of the same time.

    Args:
        path: The recording.
        fields: Fields of :class:`rig.common.sample.Sample` in the blocks.

    Raises:
        DamageError: The recording is not complete; all items yielded so far are valid.
        OSError: The file cannot be read.
    """
    return _items(path, fields, frozenset({_SAMPLES, _EVENTS, _ATTACHMENTS}))


def first_attachment(path: Path, name: str) -> bytes:
    """Return an attachment that was written before the first messages.

    Raises:
        DamageError: No attachment has this name, or the attachment is damaged.
        OSError: The file cannot be read.
    """
    for opcode, content in _before_messages(path):
        if opcode == Opcode.ATTACHMENT and (found := attachment(content)).name == name:
            return bytes(found.data)
    raise DamageError(f"{name} is not attached before the first messages")


def first_metadata(path: Path, name: str) -> Mapping[str, str] | None:
    """Return metadata that were written before the first messages, or None if there are none of
    this name.

    Raises:
        DamageError: The metadata are damaged.
        OSError: The file cannot be read.
    """
    for opcode, content in _before_messages(path):
        if opcode == Opcode.METADATA and (found := metadata(content)).name == name:
            return dict(found.metadata)
    return None


def _before_messages(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record before the first messages."""
    require_plain(path)
    with open(path, "rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise DamageError("not an MCAP recording")
        while len(head := stream.read(HEADER.size)) == HEADER.size:
            opcode, length = HEADER.unpack(head)
            if opcode in (Opcode.CHUNK, Opcode.DATA_END) or length > MAX_ATTACHMENT:
                break
            yield opcode, stream.read(length)


def _items(
    path: Path, fields: Sequence[str], wanted: frozenset[int]
) -> Iterator[Block | Happening | Attached]:
    pending: list[bytes] = []
    size = waiting = 0
    require_plain(path)
    with open(path, "rb") as stream:
        for kind, contents in _contents(stream, wanted):
            if kind == _EVENTS:
                yield from (Happening(json.loads(content)) for content in contents)
            elif kind == _ATTACHMENTS:
                yield from (Attached(file.name, file.data) for file in map(attachment, contents))
            else:
                size = size or len(contents[0])
                wrong = next((len(content) for content in contents if len(content) != size), None)
                if wrong is not None or size not in SAMPLE_SIZES:
                    raise DamageError(
                        f"a sample has {wrong or size} bytes, a size that this program does "
                        "not write: another program wrote this recording"
                    )
                pending += contents
                waiting += size * len(contents)
                if waiting >= BLOCK_BYTES:
                    yield _block(pending, size, fields)
                    pending, waiting = [], 0
    if pending:
        yield _block(pending, size, fields)


def _block(contents: Sequence[bytes], size: int, fields: Sequence[str]) -> Block:
    every = decode_samples(b"".join(contents), size)
    return Block({name: every[name] for name in fields})


def _contents(stream: BinaryIO, wanted: frozenset[int]) -> Iterator[tuple[int, list[bytes]]]:
    """Yield channel and contents of the wanted messages, chunk by chunk, events first.

    At the end the number of messages is compared with the count in the file.

    Raises:
        DamageError: The file is incomplete or damaged.
    """
    if stream.read(len(MAGIC)) != MAGIC:
        raise DamageError("not an MCAP recording")
    count = 0
    while True:
        head = stream.read(HEADER.size)
        if len(head) < HEADER.size:
            raise DamageError("the end of the recording was never written")
        opcode, length = HEADER.unpack(head)
        content = stream.read(length)
        if len(content) < length:
            raise DamageError("cut off inside a record")
        if opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            sorted_out, among = chunk_messages(chunk(content), wanted)
            count += among
            yield from (
                (kind, sorted_out[kind]) for kind in (_EVENTS, _SAMPLES) if kind in sorted_out
            )
        elif opcode == Opcode.ATTACHMENT and _ATTACHMENTS in wanted:
            yield _ATTACHMENTS, [content]
    end = stream.tell()
    if statistics(stream.read(), 0, end).message_count != count:
        raise DamageError("messages are missing")


def chunk_messages(records: bytes, wanted: frozenset[int]) -> tuple[dict[int, list[bytes]], int]:
    """Return the contents of the wanted messages of a chunk by channel, and the number of all
    messages in the chunk.
    """
    found: dict[int, list[bytes]] = {}
    offset, size, count = 0, len(records), 0
    unpack, head, body = HEADER.unpack_from, HEADER.size, MESSAGE.size
    while offset < size:
        opcode, length = unpack(records, offset)
        end = offset + head + length
        if opcode == Opcode.MESSAGE:
            count += 1
            number = records[offset + 9] | records[offset + 10] << 8
            if number in wanted:
                found.setdefault(number, []).append(records[offset + body : end])
        offset = end
    return found, count
