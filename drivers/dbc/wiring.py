"""A map bound to its DBC: all layouts precomputed, no names left to look up."""

from __future__ import annotations

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
        algorithm: Computes that checksum.
        period_s: Sending period, s; 0 for every control cycle.
    """

    name: str
    identifier: int
    size: int
    counter: Signal | None
    checksum: Signal | None
    algorithm: Callable[[bytes], int]
    period_s: float


@dataclass(frozen=True)
class BoundQuantity:
    """A quantity in SI units: SI = ``gain`` x raw + ``bias``."""

    message: str
    signal: Signal
    gain: float
    bias: float

    @cached_property
    def read(self) -> Callable[[bytes], float]:
        """Returns the quantity in a frame, SI."""
        return self.signal.reader(self.gain, self.bias)

    def bits(self, value: float) -> int:
        """Return the bits of a value in SI.

        Raises:
            ValueError: The value does not fit; names the range.
        """
        return self.signal.pack((value - self.bias) / self.gain)


@dataclass(frozen=True)
class BoundLimit:
    """The signals that set and report a limit."""

    set: BoundQuantity
    held: BoundQuantity


Images = Mapping[str, bytes]
"""Message name to the frame with an order and zeros elsewhere."""


@dataclass(frozen=True)
class Wiring:
    """A map bound to its DBC.

    Attributes:
        received: Messages the drive sends, by name.
        sampled: Names of the received messages that make up a sample.
        sent: Messages the host sends, by name, except the stop frame and the settings.
        settings: Messages that carry limits, by name.
        inputs: Quantities by name in the map.
        limits: Limits that can be written, by name in the map.
        status_message: Message that carries the state.
        status: Signal of the state.
        states: Raw status value to state.
        target: Signal of the commanded position.
        disable: Frames that take the power off.
        stop: Frames that brake.
        reset: Frames that clear a fault.
        enable: Frames toward power, by state.
        stop_frame: Identifier and data of the stop frame.
    """

    received: Mapping[str, BoundMessage]
    sampled: frozenset[str]
    sent: Mapping[str, BoundMessage]
    settings: Mapping[str, BoundMessage]
    inputs: Mapping[str, BoundQuantity]
    limits: Mapping[str, BoundLimit]
    status_message: str
    status: Signal
    states: Mapping[float, ServoState]
    target: BoundQuantity
    disable: Images
    stop: Images
    reset: Images
    enable: Mapping[ServoState, Images]
    stop_frame: tuple[int, bytes]
