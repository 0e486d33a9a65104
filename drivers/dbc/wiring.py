"""Records of a signal map after its names were resolved: bit layouts of all messages and orders."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from drivers.dbc.codec import Signal
from drivers.interfaces import ServoState


@dataclass(frozen=True)
class BoundMessage:
    """A message that the map uses, with counter and checksum.

    Attributes:
        name: Name in the DBC.
        identifier: CAN identifier.
        size: Number of bytes.
        counter: Signal of the life counter, or None without a counter.
        checksum: Signal of the checksum, or None without a checksum.
        algorithm: Function that computes the checksum of a frame; the result does not depend on the
            present value of the checksum.
        turn: Number of values of the life counter, after which it starts again at 0.
        period_s: Sending period, s; 0 for every control cycle.
        remote: Whether the drive sends the message only in answer to a remote frame.
    """

    name: str
    identifier: int
    size: int
    counter: Signal | None
    checksum: Signal | None
    algorithm: Callable[[bytes], int]
    period_s: float
    remote: bool = False
    turn: int = 0


@dataclass(frozen=True)
class BoundPage:
    """One page of a multiplexed message that the drive sends.

    Attributes:
        message: Name of the message.
        selector: The signal whose value selects the page.
        number: Raw value of the selector.
        count: Number of pages of the message.
    """

    message: str
    selector: Signal
    number: int
    count: int


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


Images = Mapping[str, bytes]
"""Frame of each message by name; all bits that no value sets are zero."""


@dataclass(frozen=True)
class Order:
    """The frames of one order.

    Attributes:
        frames: A frame of every message that is sent in each cycle, and of the messages that this
            order names and that are sent only with an order.
        own_target: Whether the order sets bits of the target itself; the program then does not
            write the target into the frame.
    """

    frames: Images
    own_target: bool = False


@dataclass(frozen=True)
class Wiring:
    """A signal map after its names were resolved.

    Attributes:
        received: Messages that the drive sends, by name.
        pages: Pages of multiplexed messages that the map uses, by key.
        sampled: Names of the received messages, and keys of the pages, that make up a sample.
        sent: Messages that the host sends periodically, by name.
        once: Messages that the host sends only with an order that contains them, by name.
        settings: Messages that contain limits, by name.
        inputs: Quantities by name in the map.
        limits: Limits that can be written, by name in the map.
        status_message: Message or page that contains the state.
        status: Signal of the state.
        states: State of each raw status value.
        asked: Whether the drive sends messages without a period only in answer to a command.
        target: Signal of the commanded position.
        torque_offset: Signal of the torque offset, or None without a torque offset.
        disable: Order that switches the power off.
        stop: Order that brakes.
        reset: Order that clears a fault.
        enable: Orders that lead toward power, by state.
        stop_message: Message of the stop frame.
        stop_image: Data of the stop frame, without counter and checksum.
    """

    received: Mapping[str, BoundMessage]
    pages: Mapping[str, BoundPage]
    sampled: frozenset[str]
    sent: Mapping[str, BoundMessage]
    once: Mapping[str, BoundMessage]
    settings: Mapping[str, BoundMessage]
    inputs: Mapping[str, BoundQuantity]
    limits: Mapping[str, BoundLimit]
    status_message: str
    status: Signal
    states: Mapping[float, ServoState]
    asked: bool
    target: BoundQuantity
    torque_offset: BoundQuantity | None
    disable: Order
    stop: Order
    reset: Order
    enable: Mapping[ServoState, Order]
    stop_message: BoundMessage
    stop_image: bytes

    @cached_property
    def reported(self) -> Mapping[str, BoundQuantity]:
        """Signals that report a limit, by name in the map."""
        limits = self.limits.items()
        return {name: limit.held for name, limit in limits if limit.held is not None}
