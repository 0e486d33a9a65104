"""A map bound to its DBC: all layouts precomputed, no names left to look up."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from drivers.dbc.codec import Signal
from drivers.interfaces import ServoState


@dataclass(frozen=True)
class BoundMessage:
    """A message in use, with counter and checksum.

    Attributes:
        name: Name in the DBC.
        identifier: CAN identifier.
        size: Number of bytes.
        counter: Its life counter signal, if any.
        checksum: Its checksum signal, if any.
        algorithm: Computes that checksum of a frame, whatever is in its place.
        turn: Number of values of the life counter.
        period_s: Sending period, s; 0 for every control cycle.
        remote: Whether the drive sends it only in answer to a remote frame.
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
        selector: The signal that numbers the page.
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

    ``message`` is the name of its message, or the key of its page in :attr:`Wiring.pages`.
    """

    message: str
    signal: Signal
    gain: float
    bias: float
    wraps_after: float | None = None

    @cached_property
    def read(self) -> Callable[[bytes], float]:
        """Returns the quantity in a frame, SI."""
        return self.signal.reader(self.gain, self.bias)

    def bits(self, value: float) -> int:
        """Return the bits of a value in SI.

        Raises:
            ValueError: The value does not fit; names the range.
        """
        raw = (value - self.bias) / self.gain
        if self.wraps_after is not None and math.isfinite(raw):
            raw = self._turned(raw, abs(self.wraps_after / self.gain))
        return self.signal.pack(raw)

    def _turned(self, raw: float, period: float) -> float:
        """Return the raw value of the signal's range that means the same after whole periods."""
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
    """The signals that set and report a limit; ``held`` is None where none reports it."""

    set: BoundQuantity
    held: BoundQuantity | None


Images = Mapping[str, bytes]
"""Message name to the frame with values in place and zeros elsewhere."""


@dataclass(frozen=True)
class Order:
    """The frames of one order.

    Attributes:
        frames: A frame of every message that is sent in each cycle, and of those that are sent only
            with an order, the ones that this order names.
        own_target: Whether the order sets bits of the target itself; the target is then not put
            into its frame.
    """

    frames: Images
    own_target: bool = False


@dataclass(frozen=True)
class Wiring:
    """A map bound to its DBC.

    Attributes:
        received: Messages the drive sends, by name.
        pages: Pages of multiplexed messages in use, by their key.
        sampled: Names of the received messages, and keys of the pages, that make up a sample.
        sent: Messages the host sends periodically, by name.
        once: Messages the host sends only with an order that names them, by name.
        settings: Messages that carry limits, by name.
        inputs: Quantities by name in the map.
        limits: Limits that can be written, by name in the map.
        status_message: Message or page that carries the state.
        status: Signal of the state.
        states: Raw status value to state.
        asked: Whether messages without a period come only in answer to a command.
        target: Signal of the commanded position.
        torque_offset: Signal of the torque that the drive adds, if there is one.
        disable: Takes the power off.
        stop: Brakes.
        reset: Clears a fault.
        enable: Leads toward power, by state.
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
