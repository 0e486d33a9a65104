"""Reads the samples of a whole recording block by block, in memory that does not grow with its length.

For recordings that were closed in order; what is damaged is read by :func:`rig.mcap_reader.read_run`, which holds all
of it and finds what is sound behind a damaged place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from drivers.plain_file import require_plain
from rig.mcap_layout import SAMPLE_SIZES, SAMPLE_TOPIC, TOPICS, decode_samples
from rig.mcap_records import HEADER, DamageError, chunk, statistics
from rig.mcap_writer import MAGIC, MESSAGE

BLOCK_BYTES = 1 << 20
_SAMPLES = TOPICS.index(SAMPLE_TOPIC) + 1


def sample_blocks(path: Path, fields: Sequence[str]) -> Iterator[dict[str, NDArray[np.float64]]]:
    """Yield the samples in order, a block of about :data:`BLOCK_BYTES` at a time.

    Args:
        path: The recording.
        fields: Of :class:`rig.sample.Sample`.

    Yields:
        Field to array, shape (n,).

    Raises:
        DamageError: It is not a whole recording; what was yielded before is sound.
        OSError: It cannot be read.
    """
    pending: list[bytes] = []
    size = waiting = 0
    require_plain(path)
    with open(path, "rb") as stream:
        for content in _sample_messages(stream):
            size = size or len(content)
            if len(content) != size or size not in SAMPLE_SIZES:
                raise DamageError(f"a sample of {len(content)} bytes: another program's recording")
            pending.append(content)
            waiting += size
            if waiting >= BLOCK_BYTES:
                yield _block(pending, size, fields)
                pending, waiting = [], 0
    if pending:
        yield _block(pending, size, fields)


def _block(contents: Sequence[bytes], size: int, fields: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    every = decode_samples(b"".join(contents), size)
    return {name: every[name] for name in fields}


def _sample_messages(stream: BinaryIO) -> Iterator[bytes]:
    """Yield each sample as recorded; at the end hold the number of messages against the file's own count.

    Raises:
        DamageError: The file is not whole.
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
            for number, message in _messages(chunk(content)):
                count += 1
                if number == _SAMPLES:
                    yield message
    end = stream.tell()
    if statistics(stream.read(), 0, end).message_count != count:
        raise DamageError("messages are missing")


def _messages(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield channel and content of each message of a chunk."""
    offset = 0
    while offset < len(records):
        opcode, length = HEADER.unpack_from(records, offset)
        end = offset + HEADER.size + length
        if opcode == Opcode.MESSAGE:
            yield int.from_bytes(records[offset + 9 : offset + 11], "little"), records[offset + MESSAGE.size : end]
        offset = end
