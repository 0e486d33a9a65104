"""Reads a recording back, whole or damaged: everything up to the damage, and a word on what is lost."""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata
from numpy.typing import NDArray

from rig.mcap_layout import EVENT_TOPIC, FRAMES_TOPIC, SAMPLE_BYTES, SAMPLE_TOPIC, decode_samples
from rig.mcap_writer import MAGIC, MESSAGE

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQI")
MAX_CHUNK = 1 << 28


class NotARecordingError(ValueError):
    """The file is not a recording, or holds no samples; the message names it."""


class Message(NamedTuple):
    """One message as logged."""

    time_ns: int
    data: bytes


@dataclass(frozen=True)
class Log:
    """What a recording holds.

    Attributes:
        samples: Field of :class:`rig.sample.Sample` to array, shape (n,).
        events: In order; each has ``time`` and ``event``.
        messages: Topic to the messages as recorded; those of ``/frames`` unpack with
            :func:`rig.mcap_layout.decode_frames`.
        attachments: Name to content.
        metadata: Name to keys and values.
        damage: None for a complete file, else where reading stopped and why, in words.
    """

    samples: Mapping[str, NDArray[np.float64]]
    events: tuple[Mapping[str, Any], ...]
    messages: Mapping[str, Sequence[Message]]
    attachments: Mapping[str, bytes]
    metadata: Mapping[str, Mapping[str, str]]
    damage: str | None


class _DamageError(Exception):
    """Reading cannot go on past this place."""


def read_run(path: Path) -> Log:
    """Read a recording, stopping at the first damage.

    Raises:
        NotARecordingError: It is not one of this program's recordings at all.
        OSError: It cannot be opened.
    """
    data = path.read_bytes()
    if not data.startswith(MAGIC):
        raise NotARecordingError(f"{path}: not an MCAP recording; its first bytes are {data[:8].hex(' ') or 'missing'}")
    channels: dict[int, str] = {}
    messages: dict[str, list[Message]] = {SAMPLE_TOPIC: [], EVENT_TOPIC: [], FRAMES_TOPIC: []}
    attachments: dict[str, bytes] = {}
    metadata: dict[str, Mapping[str, str]] = {}
    damage: str | None = None
    intact = len(MAGIC)
    try:
        for opcode, content, end in _records(data):
            if opcode == Opcode.CHUNK:
                _take_messages(_chunk(content), channels, messages)
            elif opcode == Opcode.CHANNEL:
                channel = _channel(content)
                channels[channel.id] = channel.topic
            elif opcode == Opcode.ATTACHMENT:
                attachment = _attachment(content)
                attachments[attachment.name] = attachment.data
            elif opcode == Opcode.METADATA:
                item = _metadata(content)
                metadata[item.name] = item.metadata
            elif opcode == Opcode.DATA_END:
                break
            intact = end
        else:
            raise _DamageError("the end of the recording was never written")
        if not data.endswith(MAGIC):
            raise _DamageError("the index at its end is cut off")
    except _DamageError as error:
        damage = f"whole up to byte {intact} of {len(data)}: {error}; {len(messages[SAMPLE_TOPIC])} samples recovered"
    samples = b"".join(m.data for m in messages[SAMPLE_TOPIC])
    return Log(
        samples=decode_samples(samples),
        events=tuple(json.loads(m.data) for m in messages[EVENT_TOPIC]),
        messages=messages,
        attachments=attachments,
        metadata=metadata,
        damage=damage,
    )


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(content))


def _records(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Yield opcode, content and the offset of its end for each top-level record, to the file's end."""
    offset = len(MAGIC)
    size = len(data)
    while offset < size:
        if offset + _RECORD.size > size:
            raise _DamageError("cut off inside a record header")
        opcode, length = _RECORD.unpack_from(data, offset)
        start = offset + _RECORD.size
        if opcode == 0 or start + length > size:
            raise _DamageError("cut off inside a record" if opcode else "zeros where a record should be")
        offset = start + length
        yield opcode, data[start:offset], offset


def _attachment(content: bytes) -> Attachment:
    if len(content) < 4 or zlib.crc32(content[:-4]) != struct.unpack("<I", content[-4:])[0]:
        raise _DamageError("an attachment fails its checksum")
    attachment: Attachment = Attachment.read(_stream(content))
    return attachment


def _metadata(content: bytes) -> Metadata:
    with _undamaged("metadata"):
        metadata: Metadata = Metadata.read(_stream(content))
        return metadata


def _channel(content: bytes) -> Channel:
    with _undamaged("a channel"):
        channel: Channel = Channel.read(_stream(content))
        return channel


@contextmanager
def _undamaged(what: str) -> Iterator[None]:
    """These records carry no checksum; what the library cannot read is damage."""
    try:
        yield
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise _DamageError(f"{what} cannot be read ({error})") from error


def _chunk(content: bytes) -> bytes:
    """Return a chunk's records, checked against its CRC."""
    try:
        _, _, size, crc = _CHUNK.unpack_from(content)
        (name_length,) = struct.unpack_from("<I", content, _CHUNK.size)
        name_start = _CHUNK.size + 4
        compression = content[name_start : name_start + name_length]
        records = content[name_start + name_length + 8 :]
        if size > MAX_CHUNK:
            raise _DamageError(f"a chunk claims {size} bytes")
        if compression == b"lz4":
            records = lz4.frame.decompress(records)
    except (struct.error, RuntimeError) as error:
        raise _DamageError(f"a chunk cannot be unpacked ({error})") from error
    if len(records) != size or (crc and zlib.crc32(records) != crc):
        raise _DamageError("a chunk fails its checksum")
    return records


def _take_messages(records: bytes, channels: dict[int, str], messages: dict[str, list[Message]]) -> None:
    """Sort a chunk's messages by topic."""
    offset = 0
    size = len(records)
    while offset < size:
        opcode, length = _RECORD.unpack_from(records, offset)
        end = offset + _RECORD.size + length
        if opcode == Opcode.MESSAGE:
            _, _, channel, _, log_time, _ = MESSAGE.unpack_from(records, offset)
            topic = channels.get(channel, "")
            content = records[offset + MESSAGE.size : end]
            if topic == SAMPLE_TOPIC and len(content) != SAMPLE_BYTES:
                raise _DamageError(
                    f"a sample of {len(content)} bytes, expected {SAMPLE_BYTES}: another program's recording"
                )
            if topic in messages:
                messages[topic].append(Message(log_time, content))
        offset = end
