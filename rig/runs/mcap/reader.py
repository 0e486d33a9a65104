"""Reads an intact, damaged or growing recording: all undamaged records, and what was lost."""

from __future__ import annotations

import io
import json
import os
import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import lz4.frame
import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Statistics
from numpy.typing import NDArray

from rig.common.places import require_plain
from rig.runs.mcap.layout import (
    EVENT_TOPIC,
    SAMPLE_BYTES,
    SAMPLE_TOPIC,
    TOPICS,
    decode_samples,
)
from rig.runs.mcap.writer import FOOTER_START, MAGIC, MESSAGE

START = len(MAGIC)  # offset of the first record
HEADER = struct.Struct("<BQ")  # header of every record: opcode and length
_CHUNK = struct.Struct("<QQQI")
_TIMES = struct.Struct("<QQ")  # first and last log time of a chunk, at the start of its content
_FOOTER = struct.Struct("<BQQQI")
MAX_RECORD = 1 << 28  # length above which a record counts as damaged, bytes
OPCODES = frozenset(map(int, Opcode))
_CHECKED = re.compile(rb"[\x06\x09](?=[\s\S]{4}\x00\x00\x00\x00)")
"""First bytes of a chunk or an attachment of less than 4 GiB, the records with a checksum."""
_DATA_END_BYTES = 4
_TOLD = 3  # number of damaged places that a message describes; further places are only counted
BLOCK_BYTES = 1 << 20


class DamageError(Exception):
    """A record is damaged."""


class CutOffError(DamageError):
    """The file ends before the record is complete."""


class NotARecordingError(DamageError):
    """The file is not a recording of this program."""

    def __init__(self, begin: bytes) -> None:
        said = begin.hex(" ") or "missing"
        super().__init__(f"not an MCAP recording; the first bytes are {said}")


class Message(NamedTuple):
    """One message of a recording."""

    time_ns: int
    data: bytes


Messages = tuple[tuple[str, Message], ...]
"""Topics and messages in recorded order."""


class Piece(NamedTuple):
    """One record of a recording."""

    messages: Messages  # empty for a record without messages
    following: int | None  # offset of the next record, or None for the last record


class Record(NamedTuple):
    """One top-level record: its opcode and content, and the offset of its end."""

    opcode: int
    content: bytes
    end: int


def chunk(content: bytes) -> bytes:
    """Return a chunk's records, checked against its CRC."""
    try:
        _, _, size, crc = _CHUNK.unpack_from(content)
        (name_length,) = struct.unpack_from("<I", content, _CHUNK.size)
        name_start = _CHUNK.size + 4
        compression = content[name_start : name_start + name_length]
        records = content[name_start + name_length + 8 :]
        if size > MAX_RECORD:
            raise DamageError(f"a chunk states the impossible size of {size} bytes")
        if compression == b"lz4":
            records = lz4.frame.decompress(records)
    except (struct.error, RuntimeError) as error:
        raise DamageError(f"a chunk cannot be unpacked ({error})") from error
    if len(records) != size or zlib.crc32(records) != crc:
        raise DamageError("a chunk does not agree with its checksum")
    return records


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


def require_samples(messages: Iterable[bytes]) -> None:
    """Raise DamageError unless all messages have the size of a sample."""
    for size in {*map(len, messages)} - {SAMPLE_BYTES}:
        raise DamageError(
            f"a sample has {size} bytes, expected {SAMPLE_BYTES}: another program wrote this "
            "recording"
        )


def _messages(records: bytes, wanted: Sequence[str] = TOPICS) -> tuple[Messages, int]:
    """Return the messages of the wanted topics in a chunk's records, and the number of all."""
    found = []
    offset, size, count = 0, len(records), 0
    unpack, head, body, kind = HEADER.unpack_from, HEADER.size, MESSAGE.size, int(Opcode.MESSAGE)
    while offset < size:
        opcode, length = unpack(records, offset)
        end = offset + head + length
        if opcode == kind:
            count += 1
            number = records[offset + head] | records[offset + head + 1] << 8
            if not 1 <= number <= len(TOPICS):
                raise DamageError(
                    f"a message on channel {number}, which runs do not have: "
                    "another program wrote this recording"
                )
            if (topic := TOPICS[number - 1]) in wanted:
                time_ns = MESSAGE.unpack_from(records, offset)[4]
                found.append((topic, Message(time_ns, records[offset + body : end])))
        offset = end
    return tuple(found), count


class RecordFile:
    """An open recording, which may be damaged or still grow. A context manager.

    Raises:
        OSError: The file cannot be opened.
        NotARecordingError: The file is not a recording.
    """

    def __init__(self, path: Path) -> None:
        require_plain(path)
        self._stream = open(path, "rb")  # noqa: SIM115 - closed by :meth:`__exit__`
        self.begin = self._stream.read(len(MAGIC))
        if not MAGIC.startswith(self.begin):
            self._stream.close()
            raise NotARecordingError(self.begin)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the file."""
        self._stream.close()

    @property
    def size(self) -> int:
        """Present length of the file, bytes."""
        return os.fstat(self._stream.fileno()).st_size

    def record(self, offset: int) -> Record:
        """Read the record at ``offset``.

        Raises:
            CutOffError: The record is not complete, or not complete yet.
            DamageError: No record begins there.
        """
        opcode, end = self._head(offset)
        if end > self.size:
            raise CutOffError("cut off inside a record")
        return Record(opcode, self._stream.read(end - self._stream.tell()), end)

    def at(self, offset: int) -> Piece | None:
        """Read the record at ``offset``; return None if the record is not complete yet."""
        try:
            found = self.record(offset)
        except CutOffError:
            return None
        if found.opcode == Opcode.DATA_END:
            return Piece((), None)
        whole = found.opcode == Opcode.CHUNK
        return Piece(_messages(chunk(found.content))[0] if whole else (), found.end)

    def since(self, seconds: float) -> int:
        """Return the offset of the first chunk with data of the last ``seconds`` of the recording;
        only the heads of the records are read.
        """
        chunks: list[tuple[int, int]] = []
        offset = START
        while True:
            try:
                opcode, end = self._head(offset)
            except CutOffError:
                break
            times = self._stream.read(_TIMES.size)
            if opcode == Opcode.DATA_END or len(times) < _TIMES.size:
                break
            if opcode == Opcode.CHUNK:
                chunks.append((offset, _TIMES.unpack(times)[1]))
            offset = end
        latest = max((end for _, end in chunks), default=0)
        recent = (at for at, end in chunks if end >= latest - seconds * 1e9)
        return next(recent, START)

    def next_sound(self, offset: int) -> int | None:
        """Return the offset of the next chunk or attachment with a correct checksum, or None."""
        while True:
            self._stream.seek(offset)
            block = self._stream.read(BLOCK_BYTES)
            for match in _CHECKED.finditer(block):
                try:
                    found = self.record(offset + match.start())
                    (chunk if found.opcode == Opcode.CHUNK else attachment)(found.content)
                except DamageError:
                    continue
                return offset + match.start()
            if len(block) < BLOCK_BYTES:
                return None
            offset += len(block) - HEADER.size + 1

    def statistics(self, start: int) -> Statistics:
        """Return the counts in the summary of a complete recording, whose CRC is checked.

        ``start``: offset of the summary.
        """
        self._stream.seek(start)
        summary = self._stream.read()
        footer_at = len(summary) - len(MAGIC) - _FOOTER.size
        if not summary.endswith(MAGIC) or footer_at < 0:
            raise DamageError("the index at the end of the file is cut off")
        opcode, _, stated, _, crc = _FOOTER.unpack_from(summary, footer_at)
        right = zlib.crc32(summary[: footer_at + FOOTER_START.size]) == crc
        if opcode != Opcode.FOOTER or stated != start or not right:
            raise DamageError("the index at the end of the file does not agree with its checksum")
        offset = start
        while offset < start + footer_at:
            found = self.record(offset)
            if found.opcode == Opcode.STATISTICS:
                counts: Statistics = _parsed(Statistics, found.content, "the statistics")
                return counts
            offset = found.end
        raise DamageError("the index at the end of the file holds no statistics")

    def _head(self, offset: int) -> tuple[int, int]:
        """Return opcode and end of the record at ``offset``; leave the stream at its content."""
        self._stream.seek(offset)
        head = self._stream.read(HEADER.size)
        if len(head) < HEADER.size:
            raise CutOffError("cut off inside a record header")
        opcode, length = HEADER.unpack(head)
        if opcode == 0:
            raise DamageError("zeros in place of a record")
        if opcode not in OPCODES:
            raise DamageError(f"no record begins with the byte {opcode:02X}h")
        if length > MAX_RECORD:
            raise DamageError(f"a record states the impossible length of {length} bytes")
        return opcode, offset + HEADER.size + length


def first_attachment(path: Path, name: str) -> bytes:
    """Return an attachment that was written before the first messages.

    Raises:
        DamageError: No attachment has this name, or the attachment is damaged.
    """
    with RecordFile(path) as file:
        found = file.record(START)
        while found.opcode not in (Opcode.CHUNK, Opcode.DATA_END):
            if found.opcode == Opcode.ATTACHMENT:
                own = attachment(found.content)
                if own.name == name:
                    return bytes(own.data)
            found = file.record(found.end)
    raise DamageError(f"{name} is not attached before the first messages")


@dataclass
class _Loss:
    """A damaged place: a message, and the samples before and after it; empty for none."""

    words: str
    before: bytes
    after: bytes = b""

    def told(self) -> str:
        """Return the message with the times of the samples before and after."""
        if not (self.before and self.after):
            return self.words
        last, first = decode_samples(self.before + self.after)["time"].tolist()
        return f"{self.words} (lost between {last:.3f} and {first:.3f} s)"


class _Reading:
    """One pass over a recording. After a damaged place, it continues at the next record with a
    correct checksum.

    Args:
        file: The recording.
        wanted: Topics whose messages are read.
        only_messages: Whether to skip attachments, metadata and channels.
    """

    def __init__(
        self, file: RecordFile, wanted: Sequence[str] = TOPICS, only_messages: bool = False
    ) -> None:
        if len(file.begin) < len(MAGIC):
            raise NotARecordingError(file.begin)
        self._file, self._wanted, self._only_messages = file, wanted, only_messages
        self._losses: list[_Loss] = []
        self._latest_ns = 0
        self._last = b""
        self._samples = self._messages = 0

    def contents(self) -> Iterator[Attachment | Metadata | Messages]:
        """Yield the content of each undamaged record to the end of the file."""
        offset = START
        while offset < self._file.size:
            try:
                found = self._file.record(offset)
                if found.opcode == Opcode.DATA_END and len(found.content) == _DATA_END_BYTES:
                    self._compare(found.end)
                    return
                content = self._content(found)
                offset = found.end
            except DamageError as error:
                sound = self._file.next_sound(offset + 1)
                self._note(offset, sound, str(error))
                if sound is None:
                    return
                offset = sound
            else:
                if content is not None:
                    yield content
        self._note(offset, None, "the end of the recording was never written")

    @property
    def damage(self) -> str | None:
        """Message on the damage so far, with the number of samples, or None without damage."""
        if not self._losses:
            return None
        told = [loss.told() for loss in self._losses[:_TOLD]]
        if len(self._losses) > _TOLD:
            told.append(f"and {len(self._losses) - _TOLD} more places")
        return f"{'; '.join(told)}; {self._samples} samples recovered"

    def _note(self, offset: int, sound: int | None, why: str) -> None:
        where = (
            f"whole up to byte {offset} of {self._file.size}"
            if not self._losses
            else f"damaged again at byte {offset}"
        )
        rest = "" if sound is None else f", sound again from byte {sound}"
        self._losses.append(_Loss(f"{where}: {why}{rest}", self._last))

    def _content(self, found: Record) -> Attachment | Metadata | Messages | None:
        """Return what a record contains; None for a record that only describes others."""
        match found.opcode:
            case Opcode.CHUNK:
                return self._checked(chunk(found.content))
            case _ if self._only_messages:
                return None
            case Opcode.ATTACHMENT:
                return attachment(found.content)
            case Opcode.METADATA:
                item: Metadata = _parsed(Metadata, found.content, "metadata")
                return item
            case Opcode.CHANNEL:
                channel = _parsed(Channel, found.content, "a channel")
                if (channel.id, channel.topic) not in enumerate(TOPICS, start=1):
                    raise DamageError(
                        f"channel {channel.id} is {channel.topic!r}, which is not a topic of a run"
                    )
        return None

    def _checked(self, records: bytes) -> Messages:
        """Return the wanted messages of a chunk; an error in one of them drops the whole chunk."""
        messages, count = _messages(records, self._wanted)
        samples = [message.data for topic, message in messages if topic == SAMPLE_TOPIC]
        require_samples(samples)
        if messages:
            if messages[0][1].time_ns < self._latest_ns:
                raise DamageError("a chunk is older than the chunk before it")
            self._latest_ns = messages[-1][1].time_ns
        if samples:
            for loss in self._losses:
                loss.after = loss.after or samples[0]
            self._last = samples[-1]
        self._samples += len(samples)
        self._messages += count
        return messages

    def _compare(self, summary: int) -> None:
        """Compare the number of messages with the counts in the summary of the file."""
        try:
            stated = self._file.statistics(summary).message_count
        except DamageError as error:
            self._note(summary, None, str(error))
            return
        if (missing := stated - self._messages) and not self._losses:
            self._losses.append(_Loss(f"{missing} of {stated} messages are missing", self._last))


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
    """Read a recording as a whole.

    Raises:
        NotARecordingError: The file is not a recording of this program.
        OSError: The file cannot be read.
    """
    messages: dict[str, list[Message]] = {topic: [] for topic in TOPICS}
    attachments: dict[str, bytes] = {}
    metadata: dict[str, Mapping[str, str]] = {}
    with RecordFile(path) as file:
        reading = _Reading(file)
        for content in reading.contents():
            if isinstance(content, Attachment):
                attachments[content.name] = content.data
            elif isinstance(content, Metadata):
                metadata[content.name] = content.metadata
            else:
                for topic, message in content:
                    messages[topic].append(message)
    return Log(
        samples=decode_samples(b"".join(m.data for m in messages[SAMPLE_TOPIC])),
        events=tuple(json.loads(m.data) for m in messages[EVENT_TOPIC]),
        messages=messages,
        attachments=attachments,
        metadata=metadata,
        damage=reading.damage,
    )


class Block(NamedTuple):
    """Consecutive samples: arrays of shape (n,), by field."""

    samples: Mapping[str, NDArray[np.float64]]


class Happening(NamedTuple):
    """One recorded event, with ``time`` and ``event``."""

    event: Mapping[str, Any]


class Damage(NamedTuple):
    """Place and cause of the damage of a recording, and the loss."""

    words: str


def run_items(
    path: Path, fields: Sequence[str], *, only_samples: bool = False
) -> Iterator[Block | Happening | Attachment | Damage]:
    """Yield the content of a recording except its frames, in blocks of about :data:`BLOCK_BYTES`;
    of a damaged one at last the damage.

    Events come before the block with the samples of the same time.

    ``fields``: fields of :class:`rig.common.sample.Sample` in the blocks. ``only_samples``: whether
    to yield blocks of samples, and the damage, only.

    Raises:
        NotARecordingError: The file is not a recording of this program.
        OSError: The file cannot be read.
    """
    pending: list[bytes] = []
    with RecordFile(path) as file:
        topics = (SAMPLE_TOPIC,) if only_samples else (SAMPLE_TOPIC, EVENT_TOPIC)
        reading = _Reading(file, topics, only_messages=only_samples)
        for content in reading.contents():
            if isinstance(content, Attachment):
                yield content
            elif not isinstance(content, Metadata):
                for topic, message in content:
                    if topic == EVENT_TOPIC:
                        yield Happening(json.loads(message.data))
                    else:
                        pending.append(message.data)
            if len(pending) * SAMPLE_BYTES >= BLOCK_BYTES:
                yield _block(pending, fields)
                pending.clear()
    if pending:
        yield _block(pending, fields)
    if reading.damage is not None:
        yield Damage(reading.damage)


def _block(samples: Sequence[bytes], fields: Sequence[str]) -> Block:
    every = decode_samples(b"".join(samples))
    return Block({name: every[name] for name in fields})
