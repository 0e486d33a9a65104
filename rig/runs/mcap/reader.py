"""Reads an intact or damaged recording: returns all undamaged records, and a message on the lost
records.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from rig.common.places import read_bytes, require_plain
from rig.runs.mcap.layout import (
    EVENT_TOPIC,
    SAMPLE_BYTES,
    SAMPLE_SIZES,
    SAMPLE_TOPIC,
    TOPICS,
    decode_samples,
)
from rig.runs.mcap.records import (
    HEADER,
    MAX_CHUNK,
    OPCODES,
    DamageError,
    Found,
    attachment,
    channel,
    chunk,
    metadata,
    next_sound,
    record_at,
    statistics,
)
from rig.runs.mcap.writer import MAGIC, MESSAGE

_DATA_END_BYTES = 4
_TOLD = 3
"""Number of damaged places that a message describes; further places are only counted."""


class NotARecordingError(ValueError):
    """The file is not a recording, or holds no samples; the message names the file."""


class Message(NamedTuple):
    """One message of a recording."""

    time_ns: int
    data: bytes


@dataclass(frozen=True)
class Log:
    """Content of a recording.

    Attributes:
        samples: Arrays of shape (n,), by field of :class:`rig.common.sample.Sample`.
        events: Events in order; each has ``time`` and ``event``.
        messages: Messages as recorded, by topic; :func:`rig.runs.mcap.layout.decode_frames` unpacks
            those of ``/frames``.
        attachments: Contents of attachments by name.
        metadata: Keys and values of metadata by name.
        damage: None for a complete file, else the place and cause of the damage and the loss.
    """

    samples: Mapping[str, NDArray[np.float64]]
    events: tuple[Mapping[str, Any], ...]
    messages: Mapping[str, Sequence[Message]]
    attachments: Mapping[str, bytes]
    metadata: Mapping[str, Mapping[str, str]]
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
        self._sample_bytes = 0
        self._damage: list[tuple[str, int]] = []
        self.messages: dict[str, list[Message]] = {topic: [] for topic in TOPICS}
        self.attachments: dict[str, bytes] = {}
        self.metadata: dict[str, Mapping[str, str]] = {}

    def read(self) -> None:
        """Read to the end of the file, and note every damaged place."""
        data, offset = self._data, len(MAGIC)
        while offset < len(data):
            try:
                found = record_at(data, offset)
                if found.opcode == Opcode.DATA_END and len(found.content) == _DATA_END_BYTES:
                    self._compare(found.end)
                    return
                self._take(found)
                offset = found.end
            except DamageError as error:
                sound = next_sound(data, offset + 1)
                self._note(offset, sound, str(error))
                if sound is None:
                    return
                offset = sound
        self._note(offset, None, "the end of the recording was never written")

    def samples(self) -> dict[str, NDArray[np.float64]]:
        """Return the samples, one array per field."""
        return decode_samples(
            b"".join(m.data for m in self.messages[SAMPLE_TOPIC]),
            self._sample_bytes or SAMPLE_BYTES,
        )

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
        """Store the content of one record by its kind.

        Raises:
            DamageError: The record is damaged.
        """
        match found.opcode:
            case Opcode.CHUNK:
                self._take_messages(chunk(found.content))
            case Opcode.CHANNEL:
                described = channel(found.content)
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
                item = metadata(found.content)
                self.metadata[item.name] = item.metadata

    def _take_messages(self, records: bytes) -> None:
        """Sort the messages of a chunk by topic; an error in one message drops the whole chunk.

        Raises:
            DamageError: The chunk was written by another program, or is older than the preceding
                chunk.
        """
        taken = _messages(records)
        latest_ns, sample_bytes = self._latest_ns, self._sample_bytes
        for topic, message in taken:
            size = len(message.data)
            if topic == SAMPLE_TOPIC and size != sample_bytes:
                if sample_bytes or size not in SAMPLE_SIZES:
                    sizes = " or ".join(map(str, sorted({sample_bytes} - {0} or SAMPLE_SIZES)))
                    raise DamageError(
                        f"a sample has {size} bytes, expected {sizes}: another program wrote this "
                        "recording"
                    )
                sample_bytes = size
            if message.time_ns < latest_ns:
                raise DamageError("a chunk is older than the chunk before it")
            latest_ns = message.time_ns
        self._latest_ns, self._sample_bytes = latest_ns, sample_bytes
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


def _lost(times: NDArray[np.float64], before: int) -> str:
    """Return a text with the times of the samples before and after a loss; empty without samples on
    both sides.
    """
    return (
        f" (lost between {times[before - 1]:.3f} and {times[before]:.3f} s)"
        if 0 < before < len(times)
        else ""
    )


START = len(MAGIC)
"""Offset of the first record."""
_TIMES = struct.Struct("<QQ")
"""First and last log time of a chunk, at the start of its content."""


class Piece(NamedTuple):
    """One record of a recording.

    Attributes:
        messages: Topic and message, in recorded order; empty for a record without messages.
        following: Offset of the next record, or None for the last record.
    """

    messages: tuple[tuple[str, Message], ...]
    following: int | None


class Tail:
    """An open recording that may still grow. A context manager.

    Args:
        path: The recording.

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
        """Read the record at ``offset``; return None if the record is not complete yet.

        Raises:
            OSError: The file cannot be read.
            DamageError: The record is damaged, or was written by another program.
        """
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

        Raises:
            OSError: The file cannot be read.
            DamageError: A record's head is damaged.
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
        """Return opcode and length of the record at ``offset``, or None if opcode and length are
        not written yet.
        """
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
    """Return the messages of a chunk's records.

    Raises:
        DamageError: A message is on a channel that no run has.
    """
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
