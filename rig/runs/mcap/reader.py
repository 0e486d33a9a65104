"""Reads an intact or damaged recording: all undamaged records, and what was lost."""

from __future__ import annotations

import io
import json
import re
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, Self

import lz4.frame
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Statistics
from numpy.typing import NDArray

from rig.common.places import read_bytes, require_plain
from rig.runs.mcap.layout import (
    EVENT_TOPIC,
    SAMPLE_BYTES,
    SAMPLE_TOPIC,
    TOPICS,
    decode_samples,
)
from rig.runs.mcap.writer import FOOTER_START, MAGIC, MESSAGE

HEADER = struct.Struct("<BQ")  # header of every record: opcode and length
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


def _record_at(data: bytes, offset: int) -> Found:
    """Extract the record at ``offset``."""
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


def _next_sound(data: bytes, offset: int) -> int | None:
    """Return the offset of the next chunk or attachment with a correct checksum, or None."""
    for match in _CHECKED.finditer(data, offset):
        try:
            found = _record_at(data, match.start())
            if found.opcode == Opcode.CHUNK:
                chunk(found.content)
            else:
                attachment(found.content)
        except DamageError:
            continue
        return match.start()
    return None


def attachment(content: bytes) -> Attachment:
    """Return an attachment, checked against its CRC."""
    if len(content) < 4 or zlib.crc32(content[:-4]) != struct.unpack("<I", content[-4:])[0]:
        raise DamageError("an attachment does not agree with its checksum")
    found: Attachment = _parsed(Attachment, content, "an attachment")
    return found


def _parsed(kind: Any, content: bytes, what: str) -> Any:
    """Return a record without a checksum, in the library's form."""
    try:
        return kind.read(ReadDataStream(io.BytesIO(content)))
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise DamageError(f"{what} cannot be read ({error})") from error


def statistics(data: bytes, offset: int, before: int = 0) -> Statistics:
    """Return the counts at the end of a complete recording, whose summary begins at ``offset``;
    their CRC is checked.

    ``before`` is the number of bytes of the recording before ``data``.
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
        found = _record_at(data, offset)
        if found.opcode == Opcode.STATISTICS:
            counts: Statistics = _parsed(Statistics, found.content, "the statistics")
            return counts
        offset = found.end
    raise DamageError("the index at the end of the file holds no statistics")


def chunk(content: bytes) -> bytes:
    """Return a chunk's records, checked against its CRC."""
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


_DATA_END_BYTES = 4
_TOLD = 3  # number of damaged places that a message describes; further places are only counted


class NotARecordingError(ValueError):
    """The file is not a recording, or holds no samples; the message names the file."""


class Message(NamedTuple):
    """One message of a recording."""

    time_ns: int
    data: bytes


@dataclass(frozen=True)
class Log:
    """Content of a recording."""

    samples: Mapping[str, NDArray[np.float64]]  # arrays of shape (n,), by field of `Sample`
    events: tuple[Mapping[str, Any], ...]  # events in order; each has `time` and `event`
    # Messages as recorded, by topic; `decode_frames` unpacks those of `/frames`.
    messages: Mapping[str, Sequence[Message]]
    attachments: Mapping[str, bytes]  # contents of attachments by name
    metadata: Mapping[str, Mapping[str, str]]  # keys and values of metadata by name
    # None for a complete file, else the place and cause of the damage and the loss.
    damage: str | None


def read_run(path: Path) -> Log:
    """Read a recording.

    After a damaged place, reading continues at the next record with a correct checksum.

    Raises:
        NotARecordingError: The file is not a recording of this program.
        OSError: The file cannot be opened.
    """
    data = read_bytes(path)
    if not data.startswith(MAGIC):
        raise NotARecordingError(
            f"{path}: not an MCAP recording; the first bytes are {data[:8].hex(' ') or 'missing'}"
        )
    reading = _Reading(data)
    reading.read()
    messages = reading.messages
    return Log(
        samples=reading.samples(),
        events=tuple(json.loads(m.data) for m in messages[EVENT_TOPIC]),
        messages=messages,
        attachments=reading.attachments,
        metadata=reading.metadata,
        damage=reading.damage(),
    )


class _Reading:
    """State while a recording is read."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._latest_ns = 0
        self._damage: list[tuple[str, int]] = []
        self.messages: dict[str, list[Message]] = {topic: [] for topic in TOPICS}
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, Mapping[str, str]] = {}

    def read(self) -> None:
        """Read to the end of the file, and note every damaged place."""
        data, offset = self._data, len(MAGIC)
        while offset < len(data):
            try:
                found = _record_at(data, offset)
                if found.opcode == Opcode.DATA_END and len(found.content) == _DATA_END_BYTES:
                    self._compare(found.end)
                    return
                self._take(found)
                offset = found.end
            except DamageError as error:
                sound = _next_sound(data, offset + 1)
                self._note(offset, sound, str(error))
                if sound is None:
                    return
                offset = sound
        self._note(offset, None, "the end of the recording was never written")

    def samples(self) -> dict[str, NDArray[np.float64]]:
        """Return the samples, one array per field."""
        return decode_samples(b"".join(m.data for m in self.messages[SAMPLE_TOPIC]))

    def damage(self) -> str | None:
        """Return a message on the damage, with the number of remaining samples."""
        if not self._damage:
            return None
        times = self.samples()["time"]
        told = [words + _lost(times, before) for words, before in self._damage[:_TOLD]]
        if len(self._damage) > _TOLD:
            told.append(f"and {len(self._damage) - _TOLD} more places")
        return f"{'; '.join(told)}; {len(times)} samples recovered"

    def _note(self, offset: int, sound: int | None, why: str) -> None:
        size = len(self._data)
        where = (
            f"whole up to byte {offset} of {size}"
            if not self._damage
            else f"damaged again at byte {offset}"
        )
        rest = "" if sound is None else f", sound again from byte {sound}"
        self._damage.append((f"{where}: {why}{rest}", len(self.messages[SAMPLE_TOPIC])))

    def _take(self, found: Found) -> None:
        """Store the content of one record by its kind."""
        match found.opcode:
            case Opcode.CHUNK:
                self._take_messages(chunk(found.content))
            case Opcode.CHANNEL:
                described = _parsed(Channel, found.content, "a channel")
                if (
                    not 1 <= described.id <= len(TOPICS)
                    or TOPICS[described.id - 1] != described.topic
                ):
                    raise DamageError(
                        f"channel {described.id} is {described.topic!r}, which is not a topic "
                        "of a run"
                    )
            case Opcode.ATTACHMENT:
                file = attachment(found.content)
                self.attachments[file.name] = file.data
            case Opcode.METADATA:
                item = _parsed(Metadata, found.content, "metadata")
                self.metadata[item.name] = item.metadata

    def _take_messages(self, records: bytes) -> None:
        """Sort the messages of a chunk by topic; an error in one message drops the whole chunk."""
        taken = _messages(records)
        latest_ns = self._latest_ns
        for topic, message in taken:
            if topic == SAMPLE_TOPIC:
                require_sample(message.data)
            if message.time_ns < latest_ns:
                raise DamageError("a chunk is older than the chunk before it")
            latest_ns = message.time_ns
        self._latest_ns = latest_ns
        for topic, message in taken:
            self.messages[topic].append(message)

    def _compare(self, offset: int) -> None:
        """Compare the number of messages with the counts at the end of the file."""
        try:
            counts = statistics(self._data, offset)
        except DamageError as error:
            self._note(offset, None, str(error))
            return
        missing = counts.message_count - sum(map(len, self.messages.values()))
        if missing and not self._damage:
            samples = len(self.messages[SAMPLE_TOPIC])
            self._damage.append(
                (f"{missing} of {counts.message_count} messages are missing", samples)
            )


def require_sample(data: bytes) -> None:
    """Raise DamageError unless a message has the size of a sample."""
    if len(data) != SAMPLE_BYTES:
        raise DamageError(
            f"a sample has {len(data)} bytes, expected {SAMPLE_BYTES}: another program wrote this "
            "recording"
        )


def _lost(times: NDArray[np.float64], before: int) -> str:
    """Return the times of the samples before and after a loss as text."""
    return (
        f" (lost between {times[before - 1]:.3f} and {times[before]:.3f} s)"
        if 0 < before < len(times)
        else ""
    )


START = len(MAGIC)  # offset of the first record
_TIMES = struct.Struct("<QQ")  # first and last log time of a chunk, at the start of its content


class Piece(NamedTuple):
    """One record of a recording."""

    # Topic and message, in recorded order; empty for a record without messages.
    messages: tuple[tuple[str, Message], ...]
    following: int | None  # offset of the next record, or None for the last record


class Tail:
    """An open recording that may still grow. A context manager.

    Raises:
        OSError: The file cannot be opened.
        DamageError: The file is not a recording.
    """

    def __init__(self, path: Path) -> None:
        require_plain(path)
        self._stream = open(path, "rb")  # noqa: SIM115 - closed by :meth:`__exit__`
        magic = self._stream.read(len(MAGIC))
        if not MAGIC.startswith(magic):
            self._stream.close()
            raise DamageError("not an MCAP recording")

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the file."""
        self._stream.close()

    def at(self, offset: int) -> Piece | None:
        """Read the record at ``offset``; return None if the record is not complete yet."""
        head = self._head(offset)
        if head is None:
            return None
        opcode, length = head
        if opcode == Opcode.DATA_END:
            return Piece((), None)
        end = offset + HEADER.size + length
        if opcode != Opcode.CHUNK:
            return Piece((), end) if self._size() >= end else None
        content = self._stream.read(length)
        return Piece(_messages(chunk(content)), end) if len(content) == length else None

    def since(self, seconds: float) -> int:
        """Return the offset of the first chunk with data of the last ``seconds`` of the recording;
        only the heads of the records are read.
        """
        chunks: list[tuple[int, int]] = []
        offset = START
        while (head := self._head(offset)) is not None and head[0] != Opcode.DATA_END:
            if head[0] == Opcode.CHUNK:
                times = self._stream.read(_TIMES.size)
                if len(times) < _TIMES.size:
                    break
                chunks.append((offset, _TIMES.unpack(times)[1]))
            offset += HEADER.size + head[1]
        latest = max((end for _, end in chunks), default=0)
        recent = (at for at, end in chunks if end >= latest - seconds * 1e9)
        return next(recent, START)

    def _head(self, offset: int) -> tuple[int, int] | None:
        """Return opcode and length of the record at ``offset``, or None if not written yet."""
        self._stream.seek(offset)
        head = self._stream.read(HEADER.size)
        if len(head) < HEADER.size:
            return None
        opcode, length = HEADER.unpack(head)
        if opcode not in OPCODES or (opcode == Opcode.CHUNK and length > MAX_CHUNK):
            raise DamageError(f"no record begins at byte {offset}")
        return opcode, length

    def _size(self) -> int:
        return self._stream.seek(0, 2)


def _messages(records: bytes) -> tuple[tuple[str, Message], ...]:
    """Return the messages of a chunk's records."""
    found = []
    offset = 0
    while offset < len(records):
        opcode, length = HEADER.unpack_from(records, offset)
        end = offset + HEADER.size + length
        if opcode == Opcode.MESSAGE:
            _, _, number, _, time_ns, _ = MESSAGE.unpack_from(records, offset)
            if not 1 <= number <= len(TOPICS):
                raise DamageError(
                    f"a message on channel {number}, which runs do not have: "
                    "another program wrote this recording"
                )
            message = Message(time_ns, records[offset + MESSAGE.size : end])
            found.append((TOPICS[number - 1], message))
        offset = end
    return tuple(found)


BLOCK_BYTES = 1 << 20
MAX_ATTACHMENT = 1 << 26
"""Length of a record before the first messages above which the record counts as damaged, bytes."""
_SAMPLES = TOPICS.index(SAMPLE_TOPIC) + 1
_EVENTS = TOPICS.index(EVENT_TOPIC) + 1
_ATTACHMENTS = 0  # key of attachments; the key of messages is the number of their channel


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


def run_items(
    path: Path, fields: Sequence[str], *, only_samples: bool = False
) -> Iterator[Block | Happening | Attached]:
    """Yield the content of a recording except its frames, in blocks of about :data:`BLOCK_BYTES`.

    Events come before the block with the samples of the same time.

    ``fields``: fields of :class:`rig.common.sample.Sample` in the blocks. ``only_samples``: whether
    to yield blocks of samples only.

    Raises:
        DamageError: The recording is not complete; all items yielded so far are valid.
        OSError: The file cannot be read.
    """
    wanted = frozenset({_SAMPLES} if only_samples else {_SAMPLES, _EVENTS, _ATTACHMENTS})
    pending: list[bytes] = []
    waiting = 0
    require_plain(path)
    with open(path, "rb") as stream:
        for kind, contents in _contents(stream, wanted):
            if kind == _EVENTS:
                yield from (Happening(json.loads(content)) for content in contents)
            elif kind == _ATTACHMENTS:
                yield from (Attached(file.name, file.data) for file in map(attachment, contents))
            else:
                for content in contents:
                    require_sample(content)
                pending += contents
                waiting += SAMPLE_BYTES * len(contents)
                if waiting >= BLOCK_BYTES:
                    yield _block(pending, fields)
                    pending, waiting = [], 0
    if pending:
        yield _block(pending, fields)


def first_attachment(path: Path, name: str) -> bytes:
    """Return an attachment that was written before the first messages.

    Raises:
        DamageError: No attachment has this name, or the attachment is damaged.
    """
    for opcode, content in _before_messages(path):
        if opcode == Opcode.ATTACHMENT and (found := attachment(content)).name == name:
            return bytes(found.data)
    raise DamageError(f"{name} is not attached before the first messages")


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


def _block(contents: Sequence[bytes], fields: Sequence[str]) -> Block:
    every = decode_samples(b"".join(contents))
    return Block({name: every[name] for name in fields})


def _contents(stream: BinaryIO, wanted: frozenset[int]) -> Iterator[tuple[int, list[bytes]]]:
    """Yield channel and contents of the wanted messages, chunk by chunk, events first."""
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
            sorted_out, among = _chunk_messages(chunk(content), wanted)
            count += among
            yield from (
                (kind, sorted_out[kind]) for kind in (_EVENTS, _SAMPLES) if kind in sorted_out
            )
        elif opcode == Opcode.ATTACHMENT and _ATTACHMENTS in wanted:
            yield _ATTACHMENTS, [content]
    end = stream.tell()
    if statistics(stream.read(), 0, end).message_count != count:
        raise DamageError("messages are missing")


def _chunk_messages(records: bytes, wanted: frozenset[int]) -> tuple[dict[int, list[bytes]], int]:
    """Return contents of the wanted messages by channel, and the number of all messages."""
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
