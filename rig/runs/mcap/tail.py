"""Reads a recording record by record while the run still writes it."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple, Self

from mcap.opcode import Opcode

from drivers.plain_file import require_plain
from rig.runs.mcap.layout import TOPICS
from rig.runs.mcap.reader import Message
from rig.runs.mcap.records import HEADER, MAX_CHUNK, DamageError, chunk
from rig.runs.mcap.writer import MAGIC, MESSAGE

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
        if opcode not in _OPCODES or (opcode == Opcode.CHUNK and length > MAX_CHUNK):
            raise DamageError(f"no record begins at byte {offset}")
        return opcode, length

    def _size(self) -> int:
        return self._stream.seek(0, 2)


_OPCODES = frozenset(map(int, Opcode))


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
