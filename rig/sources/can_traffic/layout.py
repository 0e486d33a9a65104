"""Signals of CAN messages: the places of their bits, and their values in many frames at once.

The functions depend only on their arguments, which are arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array
from rig.sources.can_traffic.frames import Frames
from rig.sources.formats.doubles import as_doubles

MOST_BITS = 64
_FLOATS = {16: (np.uint16, np.float16), 32: (np.uint32, np.float32), 64: (np.uint64, np.float64)}
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Part:
    """Neighbouring bits of a signal in one byte.

    Attributes:
        byte: Index of the byte in the frame.
        low: Number of the lowest of the bits in this byte.
        count: Number of bits.
        place: Number of the bit of the raw value that the lowest of the bits gives.
    """

    byte: int
    low: int
    count: int
    place: int


@dataclass(frozen=True)
class BusSignal:
    """One signal of a CAN message.

    Attributes:
        name: Name of the signal's column.
        parts: Bits of the signal, least significant first.
        width: Number of bits.
        signed: Whether the raw value is in two's complement.
        real: Whether the raw value is a number by IEEE 754.
        factor: Value of one raw unit.
        offset: Value at raw 0.
        unit: Unit as the source states it.
        low: Least value that the source allows, or None if the source states no range.
        high: Greatest value that the source allows, or None.
        selector: The multiplexer that determines whether the signal is in a frame, or None for a
            signal that is in every frame.
        pages: Raw values of the selector with which the signal is in the frame.
    """

    name: str
    parts: tuple[Part, ...]
    width: int
    signed: bool = False
    real: bool = False
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    low: float | None = None
    high: float | None = None
    selector: BusSignal | None = None
    pages: frozenset[int] = frozenset()

    @property
    def bytes(self) -> int:
        """Number of bytes that a frame must have to contain the signal."""
        return max(part.byte for part in self.parts) + 1

    def present(self, frames: Frames) -> Mask:
        """Return a mask of the frames that contain the signal, by their length and their
        multiplexers.
        """
        there: Mask = frames.lengths >= self.bytes
        if self.selector is not None:
            there = there & self.selector.present(frames)
            there = there & np.isin(self.selector.bits(frames), list(self.pages))
        return there

    def bits(self, frames: Frames) -> NDArray[np.uint64]:
        """Return the raw bits in each frame; zero if a frame is too short."""
        value = np.zeros(len(frames.data), np.uint64)
        for part in self.parts:
            if part.byte < frames.data.shape[1]:
                byte = frames.data[:, part.byte].astype(np.uint64)
                own = (byte >> np.uint64(part.low)) & np.uint64((1 << part.count) - 1)
                value |= own << np.uint64(part.place)
        return value

    def values(self, frames: Frames, rows: Mask) -> tuple[Array, str]:
        """Return the values in the given frames, and a note if values were changed."""
        bits = self.bits(frames)[rows]
        if self.real:
            unsigned, kind = _FLOATS[self.width]
            # The bits of a float may also represent NaN or infinity.
            with np.errstate(over="ignore", invalid="ignore"):
                raw = bits.astype(unsigned).view(kind).astype(np.float64)
                return raw * self.factor + self.offset, ""
        whole: NDArray[np.uint64] | NDArray[np.int64] = bits
        if self.signed:
            shift = np.uint64(MOST_BITS - self.width)
            whole = (bits << shift).view(np.int64) >> np.int64(shift)
        if self.factor == 1.0 and self.offset == 0.0:
            return as_doubles(whole)
        return whole.astype(np.float64) * self.factor + self.offset, ""


@dataclass(frozen=True)
class BusMessage:
    """One CAN message with its signals.

    Attributes:
        name: First part of the names of the columns; empty if the names of the signals suffice.
        identifier: Identifier, with the flag for 29 bits.
        signals: Signals in the order of the source.
        by_group: Whether frames with other priorities and source addresses are also this message,
            as in SAE J1939.
        left_out: Texts on the parts of the message that cannot be read.
        fault: Text on wrong places of bits in the source, which are read nevertheless; empty for
            none.
    """

    name: str
    identifier: int
    signals: tuple[BusSignal, ...]
    by_group: bool = False
    left_out: tuple[str, ...] = field(default=())
    fault: str = ""


def little_endian(start: int, width: int) -> tuple[Part, ...]:
    """Return the bits of a little-endian signal whose least significant bit is at ``start``."""
    return tuple(_parts(range(start, start + width)))


def big_endian(start: int, width: int) -> tuple[Part, ...]:
    """Return the bits of a big-endian signal whose most significant bit has the DBC number
    ``start``.
    """
    positions = []
    at = start
    for _ in range(width):
        positions.append(at)
        at = at + 15 if at % 8 == 0 else at - 1
    return tuple(_parts(positions[::-1]))


def _parts(positions: Sequence[int]) -> Iterator[Part]:
    """Yield the neighbouring bits in each byte; ``positions`` begin with the least significant
    bit.
    """
    first = 0
    for k in range(1, len(positions) + 1):
        broken = (
            k == len(positions)
            or positions[k] != positions[k - 1] + 1
            or positions[k] // 8 != positions[first] // 8
        )
        if broken:
            start = positions[first]
            yield Part(start // 8, start % 8, k - first, first)
            first = k
