"""Reads the messages of an incomplete MCAP file, whose writer ended before it closed the file.

The checksum of each complete chunk is checked. The last chunk may be incomplete, so that its
checksum cannot be checked; its complete messages are used.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from typing import IO, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from rig.runs.mcap.records import HEADER

MAGIC = b"\x89MCAP0\r\n"
_CHUNK_HEAD = struct.Struct("<QQQII")
"""Format of the head of a chunk: start time, end time, size, checksum and length of the
compression's name.
"""

Found = tuple[Schema | None, Channel, Message]


def until_cut(stream: IO[bytes]) -> Iterator[Found]:
    """Yield the messages of an incomplete file.

    Args:
        stream: The file, at its start.

    Raises:
        McapError: The file is complete but damaged, or is not an MCAP file.
    """
    data = _rest(stream)
    if not data.startswith(MAGIC):
        raise McapError("not an MCAP file")
    if data.endswith(MAGIC) and len(data) > len(MAGIC):
        raise McapError("the file is complete, but its content is damaged")
    known = _Known({}, {})
    for opcode, content, whole in _records(data[len(MAGIC) :]):
        if opcode == Opcode.CHUNK:
            for inner, record, complete in _records(_unpacked(content, whole)):
                if complete:
                    yield from _message(inner, record, known)
        elif whole:
            yield from _message(opcode, content, known)


def _rest(stream: IO[bytes]) -> bytes:
    """Return the readable bytes of a file, which may be an incomplete gzip file."""
    parts = []
    try:
        while part := stream.read(1 << 16):
            parts.append(part)
    except (EOFError, zlib.error):
        pass
    return b"".join(parts)


def _records(data: bytes) -> Iterator[tuple[int, bytes, bool]]:
    """Yield opcode and content of each record, and whether the record is complete."""
    offset = 0
    while offset + HEADER.size <= len(data):
        opcode, length = HEADER.unpack_from(data, offset)
        offset += HEADER.size
        yield opcode, data[offset : offset + length], offset + length <= len(data)
        offset += length


def _unpacked(content: bytes, whole: bool) -> bytes:
    """Return the records of a chunk; of an incomplete chunk, the records that are in the file.

    Raises:
        McapError: A complete chunk is damaged, or its compression is unknown.
    """
    if len(content) < _CHUNK_HEAD.size:
        return b""
    _, _, size, crc, length = _CHUNK_HEAD.unpack_from(content)
    name = content[_CHUNK_HEAD.size : _CHUNK_HEAD.size + length]
    packed = content[_CHUNK_HEAD.size + length + 8 :]
    try:
        if name == b"zstd":
            records = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
        elif name == b"lz4":
            records = lz4.frame.LZ4FrameDecompressor().decompress(packed)
        elif name == b"":
            records = packed
        else:
            raise McapError(f"a chunk has the unknown compression {name!r}")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise McapError(f"a chunk cannot be unpacked ({error})") from error
    if whole and (len(records) != size or (crc and zlib.crc32(records) != crc)):
        raise McapError("a chunk fails its checksum")
    return records


class _Known(NamedTuple):
    """Channels and schemas that have been read, by number."""

    channels: dict[int, Channel]
    schemas: dict[int, Schema]


def _message(opcode: int, content: bytes, known: _Known) -> Iterator[Found]:
    stream = ReadDataStream(io.BytesIO(content))
    if opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        known.channels[channel.id] = channel
    elif opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        known.schemas[schema.id] = schema
    elif opcode == Opcode.MESSAGE:
        message = Message.read(stream, len(content))
        channel = known.channels[message.channel_id]
        yield known.schemas.get(channel.schema_id), channel, message
