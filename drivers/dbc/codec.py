"""Packs and unpacks signals of CAN frames by bit shifts, computes checksums, and holds the records
of a resolved map: messages, quantities and orders.

All functions are pure functions of bytes.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Final, Literal

from drivers.interfaces import ServoState

NO_LABELS: Final[Mapping[int, str]] = MappingProxyType({})
_FLOATS: Final = {32: ("<f", "<I"), 64: ("<d", "<Q")}


@dataclass(frozen=True)
class Signal:
    """Position and meaning of one signal of a DBC in its frame.

    A frame is read as one integer, with the most significant byte first if ``motorola``, else with
    the least significant byte first. The signal consists of the ``width`` bits of this integer from
    bit ``shift`` on.
    """

    name: str
    size: int
    shift: int  # position of the least significant bit
    width: int  # number of bits
    motorola: bool = False  # byte order (`@0` in the DBC)
    signed: bool = False  # whether the value is in two's complement
    real: bool = False  # whether the value is an IEEE 754 number of 32 or 64 bits
    factor: float = 1.0  # physical value of one raw unit
    offset: float = 0.0  # physical value at the raw value 0
    # Names of raw values (`VAL_`).
    labels: Mapping[int, str] = field(default_factory=lambda: NO_LABELS, compare=False)
    # In a multiplexed message, the signal whose value determines whether this signal is in the
    # frame, or None for a signal that is in every frame.
    selector: Signal | None = None
    pages: tuple[int, ...] = ()  # raw values of the selector for which this signal is in the frame

    @cached_property
    def mask(self) -> int:
        """Bit mask of the signal, not shifted."""
        return (1 << self.width) - 1

    @cached_property
    def covers(self) -> int:
        """Bits of the signal in the frame, read as one big-endian number."""
        return int.from_bytes(self.insert(bytes(self.size), self.mask), "big")

    @cached_property
    def order(self) -> Literal["little", "big"]:
        """Byte order of the frame, for :meth:`int.from_bytes`."""
        return "big" if self.motorola else "little"

    @cached_property
    def _half(self) -> int:
        return 1 << (self.width - 1)

    def bits(self, data: bytes) -> int:
        """Return the unsigned raw bits in a frame of :attr:`size` bytes."""
        return int.from_bytes(data, self.order) >> self.shift & self.mask

    def raw(self, data: bytes) -> float:
        """Return the raw value: an integer, or a float for a real signal."""
        bits = int.from_bytes(data, self.order) >> self.shift & self.mask
        if self.real:
            code, unsigned = _FLOATS[self.width]
            return float(struct.unpack(code, struct.pack(unsigned, bits))[0])
        return (bits ^ self._half) - self._half if self.signed else bits

    def reader(self, gain: float, bias: float) -> Callable[[bytes], float]:
        """Return a fast function that reads ``gain`` x raw + ``bias`` from a frame."""
        if self.real:
            return lambda data: self.raw(data) * gain + bias
        order, shift, mask = self.order, self.shift, self.mask
        if not self.signed:
            return lambda data: (int.from_bytes(data, order) >> shift & mask) * gain + bias
        half = self._half
        return lambda data: (
            ((int.from_bytes(data, order) >> shift & mask ^ half) - half) * gain + bias
        )

    def pack(self, raw: float) -> int:
        """Return the bits of a raw value, rounded to the nearest step.

        Raises:
            ValueError: The value does not fit into the signal; the message states the range in
                physical units.
        """
        if self.real:
            code, unsigned = _FLOATS[self.width]
            if not math.isfinite(raw):
                raise ValueError(f"{self.name}: {raw:g} is not a finite number")
            try:
                packed = struct.pack(code, raw)
            except OverflowError:
                raise ValueError(
                    f"{self.name}: {raw:g} does not fit into a floating-point number of "
                    f"{self.width} bits"
                ) from None
            return int(struct.unpack(unsigned, packed)[0])
        low, high = self.range
        whole = round(raw) if math.isfinite(raw) else None
        if whole is None or not low <= whole <= high:
            ends = sorted((low * self.factor + self.offset, high * self.factor + self.offset))
            found = raw * self.factor + self.offset
            raise ValueError(
                f"{self.name} = {found:g} is outside {ends[0]:g} to {ends[1]:g}, the range of the "
                "signal"
            )
        return whole & self.mask

    @cached_property
    def range(self) -> tuple[int, int]:
        """Least and greatest raw value of an integer signal."""
        return (-self._half, self._half - 1) if self.signed else (0, self.mask)

    def insert(self, data: bytes, bits: int) -> bytes:
        """Return the frame with the raw bits of this signal replaced by ``bits``."""
        word = int.from_bytes(data, self.order) & ~(self.mask << self.shift) | bits << self.shift
        return word.to_bytes(self.size, self.order)


def motorola_shift(start: int, width: int, size: int) -> int:
    """Return the lowest bit of a big-endian signal from the highest, ``start`` in a DBC."""
    from_left = start // 8 * 8 + 7 - start % 8
    return 8 * size - from_left - width


def _table(polynomial: int) -> bytes:
    out = bytearray()
    for value in range(256):
        for _ in range(8):
            value = (value << 1 ^ (polynomial if value & 0x80 else 0)) & 0xFF
        out.append(value)
    return bytes(out)


_J1850: Final = _table(0x1D)
_AUTOSAR: Final = _table(0x2F)


def _crc8(table: bytes, data: bytes) -> int:
    crc = 0xFF
    for byte in data:
        crc = table[crc ^ byte]
    return crc ^ 0xFF


def crc8_j1850(data: bytes) -> int:
    """CRC-8 of SAE J1850: polynomial 1Dh, initial value FFh, inverted."""
    return _crc8(_J1850, data)


def crc8_autosar(data: bytes) -> int:
    """CRC-8 of AUTOSAR (CRC8H2F): polynomial 2Fh, initial value FFh, inverted."""
    return _crc8(_AUTOSAR, data)


def sum8(data: bytes) -> int:
    """Sum of all bytes modulo 256."""
    return sum(data) & 0xFF


def xor8(data: bytes) -> int:
    """Exclusive or of all bytes."""
    result = 0
    for byte in data:
        result ^= byte
    return result


ChecksumKind = Literal["crc8_j1850", "crc8_autosar", "sum8", "xor8"]
CHECKSUMS: Final[Mapping[ChecksumKind, Callable[[bytes], int]]] = {
    "crc8_j1850": crc8_j1850,
    "crc8_autosar": crc8_autosar,
    "sum8": sum8,
    "xor8": xor8,
}
"""Checksum algorithms by name; :func:`checksum_of` selects the bytes to which they are applied."""


def checksum_of(
    kind: ChecksumKind, signal: Signal, prefix: bytes = b"", *, left_out: bool = False
) -> Callable[[bytes], int]:
    """Return the function that computes the checksum of a frame; the result does not depend on the
    present value of the checksum.

    Args:
        kind: The algorithm.
        signal: Signal of the checksum, 8 bits.
        prefix: Bytes that the checksum covers before those of the frame.
        left_out: Whether the byte of the checksum is omitted, which requires a signal of a whole
            byte; otherwise the checksum counts as zero.
    """
    algorithm = CHECKSUMS[kind]
    if not left_out:
        return lambda data: algorithm(prefix + signal.insert(data, 0))
    at = signal.covers
    byte = signal.size - 1 - (at & -at).bit_length() // 8
    return lambda data: algorithm(prefix + data[:byte] + data[byte + 1 :])


@dataclass(frozen=True)
class BoundMessage:
    """A message that the map uses, with counter and checksum."""

    name: str
    identifier: int
    size: int
    counter: Signal | None  # signal of the life counter, or None without a counter
    checksum: Signal | None  # signal of the checksum, or None without a checksum
    # Function that computes the checksum of a frame; the result does not depend on the present
    # value of the checksum.
    algorithm: Callable[[bytes], int]
    period_s: float  # sending period, s; 0 for every control cycle
    remote: bool = False  # whether the drive sends the message only in answer to a remote frame
    turn: int = 0  # number of values of the life counter, after which it starts again at 0


@dataclass(frozen=True)
class BoundPage:
    """One page of a multiplexed message that the drive sends."""

    message: str
    selector: Signal
    number: int  # raw value of the selector
    count: int  # number of pages of the message


@dataclass(frozen=True)
class BoundQuantity:
    """A quantity in SI units: SI = ``gain`` x raw + ``bias``.

    ``message`` is the name of the message that contains the quantity, or the key of a page in
    :attr:`Wiring.pages`.
    """

    message: str
    signal: Signal
    gain: float
    bias: float
    wraps_after: float | None = None

    @cached_property
    def read(self) -> Callable[[bytes], float]:
        """Function that returns the value of the quantity in a frame, in SI units."""
        return self.signal.reader(self.gain, self.bias)

    def bits(self, value: float) -> int:
        """Return the bits of a value in SI units.

        Raises:
            ValueError: The value does not fit into the signal; the message states the range.
        """
        raw = (value - self.bias) / self.gain
        if self.wraps_after is not None and math.isfinite(raw):
            raw = self._turned(raw, abs(self.wraps_after / self.gain))
        return self.signal.pack(raw)

    def _turned(self, raw: float, period: float) -> float:
        """Return the raw value in the signal's range that differs from ``raw`` by whole periods."""
        signal = self.signal
        low, high = (-period / 2, period / 2) if signal.real else signal.range
        if not signal.real:
            raw = round(raw)
            if abs(period - round(period)) < 1e-6:
                period = round(period)
        if low + period > high + 1:
            low = -period / 2
        return low + (raw - low) % period


@dataclass(frozen=True)
class BoundLimit:
    """The signals that set and report a limit; ``held`` is None if no signal reports the limit."""

    set: BoundQuantity
    held: BoundQuantity | None


Images = Mapping[str, bytes]  # frame of each message by name; all bits that no value sets are zero


@dataclass(frozen=True)
class Order:
    """The frames of one order."""

    # A frame of every message that is sent in each cycle, and of the messages that this order names
    # and that are sent only with an order.
    frames: Images
    # Whether the order sets bits of the target itself; the program then does not write the target
    # into the frame.
    own_target: bool = False


@dataclass(frozen=True)
class Wiring:
    """A signal map after its names were resolved."""

    received: Mapping[str, BoundMessage]  # messages that the drive sends, by name
    pages: Mapping[str, BoundPage]  # pages of multiplexed messages that the map uses, by key
    # Names of the received messages, and keys of the pages, that make up a sample.
    sampled: frozenset[str]
    sent: Mapping[str, BoundMessage]  # messages that the host sends periodically, by name
    # Messages that the host sends only with an order that contains them, by name.
    once: Mapping[str, BoundMessage]
    settings: Mapping[str, BoundMessage]  # messages that contain limits, by name
    inputs: Mapping[str, BoundQuantity]  # quantities by name in the map
    limits: Mapping[str, BoundLimit]  # limits that can be written, by name in the map
    status_message: str  # message or page that contains the state
    status: Signal  # signal of the state
    states: Mapping[float, ServoState]  # state of each raw status value
    asked: bool  # whether the drive sends messages without a period only in answer to a command
    target: BoundQuantity  # signal of the commanded position
    # Signal of the torque offset, or None without a torque offset.
    torque_offset: BoundQuantity | None
    disable: Order
    stop: Order
    reset: Order
    enable: Mapping[ServoState, Order]  # orders that lead toward power, by state
    stop_message: BoundMessage  # message of the stop frame
    stop_image: bytes  # data of the stop frame, without counter and checksum

    @cached_property
    def reported(self) -> Mapping[str, BoundQuantity]:
        """Signals that report a limit, by name in the map."""
        limits = self.limits.items()
        return {name: limit.held for name, limit in limits if limit.held is not None}
