"""Encodes and decodes frames of the maxon EPOS4 over RS-232 and USB, and the services in them. This
module has no input and output.

A frame is ``90 02 opcode length data CRC``. The length is in 16-bit words, all fields are
little-endian, and every byte 90h after the first two bytes is doubled, also in the CRC (EPOS4
Communication Guide, "USB & RS232 Communication").
"""

from __future__ import annotations

import binascii
import struct
from enum import IntEnum
from typing import Final, NamedTuple

DLE: Final = 0x90
STX: Final = 0x02
_START: Final = bytes([DLE, STX])
_DLE: Final = bytes([DLE])
_STUFFED: Final = bytes([DLE, DLE])
_HEAD: Final = 2
_CRC: Final = 2
MAX_WORDS: Final = 255
SEGMENT_BYTES: Final = 255
"""Greatest number of data bytes of one segment; the length field has one byte."""

WRITE_BYTES: Final = 30
READ_BYTES: Final = 32
"""Greatest number of bytes of one WriteObject or ReadObject with its answer, all 90h doubled."""
_BITS_PER_BYTE: Final = 10


class Opcode(IntEnum):
    """Services."""

    ANSWER = 0x00
    READ_OBJECT = 0x60
    SEGMENT_READ = 0x62
    WRITE_OBJECT = 0x68
    SEND_NMT = 0x70
    INITIATE_SEGMENTED_READ = 0x81


class Frame(NamedTuple):
    """One frame: opcode, and data of a whole number of words."""

    opcode: int
    data: bytes


OBJECT: Final = struct.Struct("<BHB")  # node identifier, index and subindex
TOTAL: Final = struct.Struct("<I")  # number of bytes of an object that is transferred in segments
ERROR: Final = struct.Struct("<I")
"""First field of every answer: 0 if the request was accepted, or an error code."""
NMT: Final = struct.Struct("<HH")  # node identifier and command specifier
TOGGLE: Final = 0x01
LAST: Final = 0x02  # bits of a segment's control byte


def crc(words: bytes) -> int:
    """Return the CRC-16 (1021h, initial value 0) of the words of a frame from the opcode on."""
    swapped = bytearray(len(words))
    swapped[0::2], swapped[1::2] = words[1::2], words[0::2]
    return binascii.crc_hqx(swapped, 0)


def encode(opcode: int, data: bytes) -> bytes:
    """Return the bytes of a frame as sent over the line; ``data`` of odd length is padded with a
    dummy byte.

    Raises:
        ValueError: More than 255 words.
    """
    if len(data) % 2:
        data += b"\0"
    count = len(data) // 2
    if count > MAX_WORDS:
        raise ValueError(
            f"{len(data)} bytes do not fit into a frame, which has at most {2 * MAX_WORDS}: send "
            "segments"
        )
    body = bytes([opcode, count]) + data
    body += crc(body).to_bytes(2, "little")
    return _START + body.replace(_DLE, _STUFFED)


class FrameDecoder:
    """Decodes received bytes into whole frames; never raises.

    A frame with a wrong CRC or wrong byte stuffing is dropped. The search for the next frame
    continues after the first two bytes of the dropped frame, so that a good frame behind or within
    the damaged bytes is found.
    """

    def __init__(self) -> None:
        self.bad = 0  # number of frames dropped so far
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that are complete with ``data``, oldest first."""
        buffer = self._buffer
        buffer += data
        frames = []
        at = 0
        while (start := buffer.find(_START, at)) >= 0:
            end, frame = _parse(buffer, start + _HEAD)
            if end == 0:
                at = start
                break
            if frame is None:
                self.bad += 1
                at = start + 1
            else:
                frames.append(frame)
                at = end
        else:
            # The last byte may be the first of the two start bytes of the next frame.
            at = max(at, len(buffer) - (buffer[-1:] == _DLE))
        del buffer[:at]
        return frames

    def clear(self) -> None:
        """Discard the bytes received so far."""
        self._buffer.clear()


def _parse(buffer: bytearray, start: int) -> tuple[int, Frame | None]:
    """Return the end (0: incomplete) and the frame (None: bad) with its opcode at ``start``."""
    wanted = _HEAD + _CRC
    if len(buffer) - start >= _HEAD:
        wanted += 2 * buffer[start + 1]
    body = buffer[start : start + wanted]
    end = start + wanted
    if DLE in body:
        body, end = bytearray(), start
        wanted = _HEAD + _CRC
        while len(body) < wanted:
            if end >= len(buffer) or (buffer[end] == DLE and end + 1 >= len(buffer)):
                return 0, None
            byte = buffer[end]
            if byte == DLE:
                end += 1
                if buffer[end] != DLE:
                    return end, None
            end += 1
            body.append(byte)
            if len(body) == _HEAD:
                wanted += 2 * byte
    elif len(body) < wanted:
        return 0, None
    if crc(bytes(body[:-_CRC])) != body[-2] | body[-1] << 8:
        return end, None
    return end, Frame(body[0], bytes(body[_HEAD:-_CRC]))


def segment(chunk: bytes, toggle: int, last: bool) -> bytes:
    """Return the fields of one segment: length, control byte, data."""
    return bytes([len(chunk), toggle | (LAST if last else 0)]) + chunk


def cycle_bits(writes: int, reads: int) -> int:
    """Return the greatest number of bit times of a cycle with so many writes and reads."""
    return _BITS_PER_BYTE * (writes * WRITE_BYTES + reads * READ_BYTES)
