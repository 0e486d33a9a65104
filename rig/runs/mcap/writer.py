"""Writes MCAP files, with a fast path for messages.

The writer of the ``mcap`` library needs 2.6 microseconds per message, and a control cycle writes
two messages. In this module, one ``struct.pack`` writes a message; the record types of the library
write all records that occur once. Chunks, message indexes and summary follow the specification
(https://mcap.dev/spec), so that every reader can seek.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from itertools import chain
from typing import BinaryIO

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 16 * 1024
"""Size of a chunk, bytes. A killed writer loses at most the present chunk; a chunk of the usual
size of 1 MiB contains seconds of samples.
"""
MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time, publish time; the data follow."""
_MESSAGE_HEADER = MESSAGE.size - 9
FOOTER_START = struct.Struct("<BQQQ")  # part of the footer that the checksum of the footer covers


class McapWriter:
    """Writes one MCAP file. Channels are registered before the first message.

    Args:
        stream: A seekable buffered stream at its start, which this class does not close.

    Raises:
        OSError: The stream cannot be written; every method may raise this error.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._parts: list[bytes] = []
        self._size = 0
        self._index: dict[int, list[tuple[int, int]]] = {}
        self._counts: dict[int, int] = {}
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        stream.write(MAGIC)
        self._write(Header("", "loadrig"))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema; return its number."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._write(schema)
        return schema.id

    def channel(self, topic: str, encoding: str, schema: int) -> int:
        """Register a channel; return its number. Schema 0 means that the channel has no schema."""
        number = len(self._channels) + 1
        channel = Channel(
            id=number, topic=topic, message_encoding=encoding, schema_id=schema, metadata={}
        )
        self._channels.append(channel)
        self._index[number] = []
        self._counts[number] = 0
        self._write(channel)
        return number

    def message(self, channel: int, time_ns: int, data: bytes) -> None:
        """Add a message to the present chunk, and write the chunk when it is full."""
        length = len(data) + _MESSAGE_HEADER
        self._parts += (MESSAGE.pack(Opcode.MESSAGE, length, channel, 0, time_ns, time_ns), data)
        self._index[channel].append((time_ns, self._size))
        self._size += length + 9
        if self._size > CHUNK_BYTES:
            self._finish_chunk()

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        offset, length = self._write(
            Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        )
        index = AttachmentIndex(
            offset=offset,
            length=length,
            create_time=0,
            log_time=0,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._attachments.append(index)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write key-value metadata."""
        offset, length = self._write(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def flush(self) -> None:
        """Write the present chunk, and pass all data to the operating system."""
        self._finish_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the remaining data, the summary and the end of the file."""
        self._finish_chunk()
        self._write(DataEnd(0))
        start = self._stream.tell()
        records = [
            *self._schemas,
            *self._channels,
            Statistics(
                attachment_count=len(self._attachments),
                channel_count=len(self._channels),
                channel_message_counts={
                    channel: count for channel, count in self._counts.items() if count
                },
                chunk_count=len(self._chunks),
                message_count=sum(self._counts.values()),
                message_start_time=min((c.message_start_time for c in self._chunks), default=0),
                message_end_time=max((c.message_end_time for c in self._chunks), default=0),
                metadata_count=len(self._metadata),
                schema_count=len(self._schemas),
            ),
        ]
        summary = _encoded(*records, *self._chunks, *self._attachments, *self._metadata)
        crc = zlib.crc32(FOOTER_START.pack(Opcode.FOOTER, 20, start, 0), zlib.crc32(summary))
        self._stream.write(summary)
        self._write(Footer(summary_start=start, summary_offset_start=0, summary_crc=crc))
        self._stream.write(MAGIC)
        self._stream.flush()

    def _write(self, record: McapRecord) -> tuple[int, int]:
        """Write one record; return its offset and length."""
        offset, data = self._stream.tell(), _encoded(record)
        self._stream.write(data)
        return offset, len(data)

    def _finish_chunk(self) -> None:
        if not self._parts:
            return
        records = b"".join(self._parts)
        index = {channel: entries for channel, entries in self._index.items() if entries}
        times = [time_ns for entries in index.values() for time_ns, _ in entries]
        start, end = min(times), max(times)
        data = lz4.frame.compress(records)
        offset, length = self._write(
            Chunk(
                compression="lz4",
                data=data,
                message_start_time=start,
                message_end_time=end,
                uncompressed_crc=zlib.crc32(records),
                uncompressed_size=len(records),
            )
        )
        offsets = {}
        for channel, entries in index.items():
            offsets[channel] = self._stream.tell()
            self._stream.write(_message_index(channel, entries))
            self._counts[channel] += len(entries)
            self._index[channel] = []
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=offset,
                chunk_length=length,
                message_start_time=start,
                message_end_time=end,
                message_index_offsets=offsets,
                message_index_length=self._stream.tell() - offset - length,
                compression="lz4",
                compressed_size=len(data),
                uncompressed_size=len(records),
            )
        )
        self._parts.clear()
        self._size = 0


def _encoded(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _message_index(channel: int, entries: list[tuple[int, int]]) -> bytes:
    size = 16 * len(entries)
    return struct.pack(
        f"<BQHI{2 * len(entries)}Q",
        Opcode.MESSAGE_INDEX,
        size + 6,
        channel,
        size,
        *chain.from_iterable(entries),
    )
