"""Extracts and checks records of a recording, and finds the next undamaged record after damage."""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import lz4.frame
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Statistics

from rig.runs.mcap.writer import FOOTER_START, MAGIC

HEADER = struct.Struct("<BQ")
"""Header of every record: opcode and length."""
_CHUNK = struct.Struct("<QQQI")
MAX_CHUNK = 1 << 28
OPCODES = frozenset(map(int, Opcode))
_CHECKED = re.compile(rb"[\x06\x09](?=[\s\S]{4}\x00\x00\x00\x00)")
"""First bytes of a chunk or an attachment of less than 4 GiB, the records with a checksum."""
_FOOTER = struct.Struct("<BQQQI")


class DamageError(Exception):
    """A record is damaged."""


class Found(NamedTuple):
    """One top-level record: its opcode and content, and the offset of its end."""

    opcode: int
    content: bytes
    end: int


def record_at(data: bytes, offset: int) -> Found:
    """Extract the record at ``offset``.

    Raises:
        DamageError: No complete record begins at ``offset``.
    """
    if offset + HEADER.size > len(data):
        raise DamageError("cut off inside a record header")
    opcode, length = HEADER.unpack_from(data, offset)
    start = offset + HEADER.size
    if opcode == 0:
        raise DamageError("zeros in place of a record")
    if opcode not in OPCODES:
        raise DamageError(f"no record begins with the byte {opcode:02X}h")
    if start + length > len(data):
        raise DamageError("cut off inside a record")
    return Found(opcode, data[start : start + length], start + length)


def next_sound(data: bytes, offset: int) -> int | None:
    """Return the offset of the first chunk or attachment with correct checksum from ``offset``
    on, or None.
    """
    for match in _CHECKED.finditer(data, offset):
        try:
            found = record_at(data, match.start())
            if found.opcode == Opcode.CHUNK:
                chunk(found.content)
            else:
                attachment(found.content)
        except DamageError:
            continue
        return match.start()
    return None


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(content))


def attachment(content: bytes) -> Attachment:
    """Return an attachment, checked against its CRC.

    Raises:
        DamageError: The CRC does not agree with the attachment.
    """
    if len(content) < 4 or zlib.crc32(content[:-4]) != struct.unpack("<I", content[-4:])[0]:
        raise DamageError("an attachment does not agree with its checksum")
    with _undamaged("an attachment"):
        found: Attachment = Attachment.read(_stream(content))
        return found


def metadata(content: bytes) -> Metadata:
    """Return metadata, which have no checksum.

    Raises:
        DamageError: The metadata cannot be read.
    """
    with _undamaged("metadata"):
        found: Metadata = Metadata.read(_stream(content))
        return found


def channel(content: bytes) -> Channel:
    """Return a channel, which has no checksum.

    Raises:
        DamageError: The channel cannot be read.
    """
    with _undamaged("a channel"):
        found: Channel = Channel.read(_stream(content))
        return found


def statistics(data: bytes, offset: int, before: int = 0) -> Statistics:
    """Return the counts at the end of a complete recording, whose summary begins at ``offset``;
    their CRC is checked.

    ``before`` is the number of bytes of the recording before ``data``.

    Raises:
        DamageError: The summary is incomplete or damaged.
    """
    footer_at = len(data) - len(MAGIC) - _FOOTER.size
    if not data.endswith(MAGIC) or footer_at < offset:
        raise DamageError("the index at the end of the file is cut off")
    opcode, _, start, _, crc = _FOOTER.unpack_from(data, footer_at)
    if (
        opcode != Opcode.FOOTER
        or start != before + offset
        or zlib.crc32(data[offset : footer_at + FOOTER_START.size]) != crc
    ):
        raise DamageError("the index at the end of the file does not agree with its checksum")
    while offset < footer_at:
        found = record_at(data, offset)
        if found.opcode == Opcode.STATISTICS:
            with _undamaged("the statistics"):
                counts: Statistics = Statistics.read(_stream(found.content))
                return counts
        offset = found.end
    raise DamageError("the index at the end of the file holds no statistics")


@contextmanager
def _undamaged(what: str) -> Iterator[None]:
    """Raise :class:`DamageError` in place of errors of the library."""
    try:
        yield
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise DamageError(f"{what} cannot be read ({error})") from error


def chunk(content: bytes) -> bytes:
    """Return a chunk's records, checked against its CRC.

    Raises:
        DamageError: The CRC does not agree with the records.
    """
    try:
        _, _, size, crc = _CHUNK.unpack_from(content)
        (name_length,) = struct.unpack_from("<I", content, _CHUNK.size)
        name_start = _CHUNK.size + 4
        compression = content[name_start : name_start + name_length]
        records = content[name_start + name_length + 8 :]
        if size > MAX_CHUNK:
            raise DamageError(f"a chunk states the impossible size of {size} bytes")
        if compression == b"lz4":
            records = lz4.frame.decompress(records)
    except (struct.error, RuntimeError) as error:
        raise DamageError(f"a chunk cannot be unpacked ({error})") from error
    if len(records) != size or zlib.crc32(records) != crc:
        raise DamageError("a chunk does not agree with its checksum")
    return records
