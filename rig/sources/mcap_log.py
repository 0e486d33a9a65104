"""Reads MCAP logs with JSON, CDR (ROS 2) and protobuf messages."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final

import lz4.frame
import zstandard
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader

from rig.common.errors import InputError
from rig.runs.mcap.layout import SAMPLE_SCHEMA
from rig.runs.mcap.reader import HEADER
from rig.runs.mcap.writer import MAGIC
from rig.sources.table import Array, library, open_binary
from rig.sources.text import (
    LONGEST_LIST,
    Duration,
    RowsTable,
    Stamp,
    numbers,
    parse,
    series,
)

_CHUNK_HEAD = struct.Struct("<QQQII")
"""Head of a chunk: start, end, size, checksum and length of the compression's name."""

Found = tuple[Schema | None, Channel, Message]


def _until_cut(stream: IO[bytes]) -> Iterator[Found]:
    data = _rest(stream)
    if not data.startswith(MAGIC):
        raise McapError("not an MCAP file")
    if data.endswith(MAGIC) and len(data) > len(MAGIC):
        raise McapError("the file is complete, but its content is damaged")
    expanded = [MAGIC]
    for opcode, content, whole in _records(data[len(MAGIC) :]):
        if opcode == Opcode.CHUNK:
            expanded.append(_unpacked(content, whole))
        elif whole:
            expanded.append(HEADER.pack(opcode, len(content)) + content)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with suppress(EndOfFile):
        for record in StreamReader(io.BytesIO(b"".join(expanded))).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                yield schemas.get(channel.schema_id), channel, record


def _rest(stream: IO[bytes]) -> bytes:
    """Return the readable bytes of a file, which may be an incomplete gzip file."""
    parts = []
    with suppress(EOFError, zlib.error):
        while part := stream.read(1 << 16):
            parts.append(part)
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
    """Return the records of a chunk; of an incomplete chunk, the records that are in the file."""
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


Decoder = Callable[[bytes], dict[str, float]]
"""Function that returns dotted name and value of every number in a message."""
_LIBRARIES: Final = {
    "cdr": ("mcap_ros2.decoder", "CDR messages of ROS 2"),
    "protobuf": ("mcap_protobuf.decoder", "protobuf messages"),
}
"""Module of the decoder, and name of the encoding for messages, by encoding."""
_DURATION = "Duration"


class Decoders:
    """Chooses the decoder of each channel."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._factories: dict[str, Any] = {}

    def of(self, encoding: str, schema: Schema | None) -> Decoder | None:
        """Return the decoder of a channel, or None; InputError if its library is missing."""
        if encoding == "json":
            return lambda data: dict(numbers(parse(data.decode("utf-8")), ""))
        if encoding not in _LIBRARIES:
            return None
        if encoding not in self._factories:
            module, words = _LIBRARIES[encoding]
            self._factories[encoding] = library(module, self._path, words, "mcap").DecoderFactory()
        decode = self._factories[encoding].decoder_for(encoding, schema)
        if decode is None:
            return None
        return lambda data: dict(numbers(_plain(decode(data)), ""))


def _plain(value: Any) -> Any:
    """Return a decoded message of ROS or protobuf, or a value inside one, as numbers, mappings and
    lists; text, long lists, and fields of protobuf without value and default are left out.
    """
    if isinstance(value, bytes | bytearray | str):
        return None
    descriptor = getattr(value, "DESCRIPTOR", None)
    # protobuf's Struct and ListValue are messages that behave as a mapping and a list.
    if descriptor is not None and not hasattr(value, "__len__"):
        kind = descriptor.full_name
        fields = (f for f in descriptor.fields if not f.has_presence or value.HasField(f.name))
        members = {field.name: _plain(getattr(value, field.name)) for field in fields}
    elif hasattr(type(value), "_type"):
        kind = type(value)._type
        members = {name: _plain(getattr(value, name)) for name in type(value).__slots__}
    elif hasattr(value, "keys"):
        return {str(key): _plain(value[key]) for key in list(value)[:LONGEST_LIST]}
    elif hasattr(value, "__len__"):
        return list(map(_plain, value)) if len(value) <= LONGEST_LIST else None
    else:
        return value
    return Duration(members) if str(kind).endswith(_DURATION) else members


LOG_TIME = "log_time"


class McapTable(RowsTable):
    """Table with one column for each number in the messages, named ``topic.field``, with dots for
    nesting.

    Messages are JSON, CDR of ROS 2 or protobuf. ``topic.log_time`` is the logger's time stamp in
    seconds since the first message of this topic. Elements of lists, including lists of messages,
    are ``topic.field[0]``; a stamp of ``sec`` and ``nanosec`` is one column. In a file without an
    end, the complete messages are read, with a note. A topic whose messages cannot be decoded is
    left out, with a note that states the reason. Each topic has its own time base; the logger's
    time is the common clock.
    """

    remedy = "recover this file with `mcap recover`; open a run of this program by its folder"

    def __init__(self, path: Path, _: object = None) -> None:
        self.path = path
        self._rows: dict[str, list[dict[str, float]]] = {}
        self._left_out: dict[str, str] = {}
        self._own = self._cut = False
        try:
            with open_binary(path) as stream:
                self._take(make_reader(stream, validate_crcs=True).iter_messages())
        except InputError:
            raise
        except Exception as error:
            if not self._take_cut_off():
                if not self._cut:
                    raise
                raise InputError(
                    f"{path}: cannot be read: cut off before the first complete message; write "
                    f"logs with smaller chunks, or {self.remedy}"
                ) from error
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
        self._take_rows(self._rows.items(), True)

    def _take(self, messages: Iterable[tuple[Schema | None, Channel, Message]]) -> None:
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
        """Read the complete messages of a file whose writer ended before it closed the file."""
        self._rows.clear()
        self._left_out.clear()
        try:
            with open_binary(self.path) as stream:
                self._take(_until_cut(stream))
        except InputError:
            raise
        except Exception:  # noqa: BLE001 - the library raises anything on damage
            return False
        self._cut = True
        count = sum(len(rows) for rows in self._rows.values())
        self.note(f"the file is cut off: its {count} complete messages are read")
        return bool(count or self._left_out)

    def stamps(self, base: int) -> Array | None:
        """Return the logger's time stamps of a topic, s since the first message of the file."""
        first = min(rows[0][LOG_TIME] for rows in self._rows.values())
        rows: list[dict[str, Any]] = [{LOG_TIME: first}, *self._bases[base]]
        return series(rows, LOG_TIME)[0][1:]
