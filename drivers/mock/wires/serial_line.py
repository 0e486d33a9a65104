"""A serial line in simulated time: bytes take their time at the baud rate; no wall clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from drivers.clock import NS, SimulatedClock

ByteFilter = Callable[[int, bytes, bool], bytes]
"""Called with (time in ns, bytes, sent by the host); returns the bytes to deliver."""

_BITS_PER_BYTE = 10


class Station(Protocol):
    """The device at the far end of a line."""

    def receive(self, data: bytes) -> bytes:
        """Process received bytes, possibly none, and return the answer or unsolicited bytes that
        are due.
        """
        ...


class SimulatedLine:
    """The line as the host sees it: a :class:`~drivers.serial_port.BytePort`.

    Reading advances the clock.

    A message arrives as a whole when its last byte does; the far end answers in that instant.

    Args:
        clock: Simulated time.
        baud: Bit/s, 8N1.
        station: The device at the far end.
        echo: Whether the host's adapter echoes its own bytes.

    Attributes:
        station: The device at the far end.
        filters: Hooks for fault injection, applied in order to every message.
        cut: True while the line is unplugged: nothing arrives either way.
    """

    def __init__(
        self, clock: SimulatedClock, baud: int, station: Station, echo: bool = False
    ) -> None:
        self.station = station
        self.filters: list[ByteFilter] = []
        self.cut = False
        self._clock = clock
        self._byte_ns = _BITS_PER_BYTE * NS // baud
        self._echo = echo
        self._received = b""
        self._free_ns = 0
        self._closed = False

    def write(self, data: bytes) -> None:
        """Send bytes, after those still being sent.

        Raises:
            OSError: The line is closed.
        """
        self._require_open()
        arrival = max(self._clock.now_ns(), self._free_ns) + len(data) * self._byte_ns
        self._free_ns = arrival
        self._clock.call_at(arrival, lambda: self._arrived(data))

    def read(self, timeout_s: float) -> bytes:
        """Return what has come in, advancing simulated time while there is nothing.

        Raises:
            OSError: The line is closed.
        """
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
        """Drop what has come in."""
        self._require_open()
        self._received = b""

    def close(self) -> None:
        """Close the line."""
        self._closed = True

    def deliver(self, data: bytes, from_host: bool) -> None:
        """Deliver a message to its receiver without the filters; its answer is sent as usual."""
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
