"""A serial line in simulated time, on which each byte takes its time at the bit rate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from drivers.clock import NS, SimulatedClock

ByteFilter = Callable[[int, bytes, bool], bytes]
"""Function of (time in ns, bytes, whether the host sent them) that returns the bytes to deliver."""

_BITS_PER_BYTE = 10


class Station(Protocol):
    """The device at the other end of a line."""

    def receive(self, data: bytes) -> bytes:
        """Process received bytes, if any, and return the bytes that are due."""
        ...


class SimulatedLine:
    """The line with the interface of the host: a :class:`~drivers.serial_port.BytePort`.

    To read advances the clock.

    A message arrives as a whole at the time of its last byte, and the station answers at this time.

    Args:
        clock: Simulated time.
        baud: Bit rate, bit/s, with 8N1.
        station: The device at the far end.
        echo: Whether the host's adapter returns the bytes that it sends (echo).
    """

    def __init__(
        self, clock: SimulatedClock, baud: int, station: Station, echo: bool = False
    ) -> None:
        self.station = station  # the device at the far end
        # Hooks for fault injection, applied in order to every message.
        self.filters: list[ByteFilter] = []
        # Whether the line is unplugged, so that nothing arrives in either direction.
        self.cut = False
        self._clock = clock
        self._byte_ns = _BITS_PER_BYTE * NS // baud
        self._echo = echo
        self._received = b""
        self._free_ns = 0
        self._closed = False

    def write(self, data: bytes) -> None:
        """Send bytes after the bytes that are still being sent."""
        self._require_open()
        arrival = max(self._clock.now_ns(), self._free_ns) + len(data) * self._byte_ns
        self._free_ns = arrival
        self._clock.call_at(arrival, lambda: self._arrived(data))

    def read(self, timeout_s: float) -> bytes:
        """Return the received bytes; without any, simulated time advances until a byte arrives."""
        self._require_open()
        clock = self._clock
        deadline = clock.now_ns() + round(timeout_s * NS)
        while not self._received:
            due = clock.next_event_ns()
            if due is None or due > deadline:
                clock.sleep_until_ns(deadline)
                return b""
            clock.fire_next(deadline)
        data, self._received = self._received, b""
        return data

    def discard(self) -> None:
        """Discard the received bytes."""
        self._require_open()
        self._received = b""

    def close(self) -> None:
        """Close the line."""
        self._closed = True

    def deliver(self, data: bytes, from_host: bool) -> None:
        """Deliver a message to its receiver without the filters; the answer passes the filters."""
        if self.cut:
            return
        if not from_host:
            self._received += data
            return
        answer = self.station.receive(data)
        if answer:
            due = self._clock.now_ns() + len(answer) * self._byte_ns
            self._clock.call_at(due, lambda: self.deliver(self._filtered(answer, False), False))

    def _arrived(self, data: bytes) -> None:
        if self._echo:
            self._received += data
        self.deliver(self._filtered(data, True), True)

    def _filtered(self, data: bytes, from_host: bool) -> bytes:
        for change in self.filters:
            data = change(self._clock.now_ns(), data, from_host)
        return data

    def _require_open(self) -> None:
        if self._closed:
            raise OSError("the simulated line is closed")
