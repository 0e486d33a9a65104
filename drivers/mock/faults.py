"""Injects CAN bus faults: lost, repeated, late and corrupted frames, bus-off, device restarts."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drivers.clock import SimulatedClock
from drivers.mock.wires.bus import SimulatedBus

FOR_GOOD: Final = 0
"""Value of ``count`` for a permanent fault."""

GENERAL_ERROR: Final = 0x08000000
_SDO_REQUEST: Final = 0x600
_SDO_ANSWER: Final = 0x580
_SDO_ABORT: Final = 0x80

Frame = tuple[int, bytes]
Match = Callable[[int, bool], bool]
"""Function that selects frames by identifier and by whether the host sent them."""


@dataclass
class _Rule:
    match: Match
    left: int | None
    change: Callable[[int, bytes, bool], Frame | None]


class WireFaults:
    """Loses, repeats, delays and corrupts frames on a simulated bus.

    Several faults may be active at the same time.

    ``count`` is the number of affected frames, :data:`FOR_GOOD` for all frames from now on. A CAN
    controller repeats frames with a wrong CRC, so that a receiver never receives them; the injected
    corruption is one that the CRC does not detect.

    Args:
        bus: The bus; its ``frame_filters`` and ``down`` are used.
        clock: Simulated time.
    """

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock) -> None:
        self._bus = bus
        self._clock = clock
        self._ghost = bus.attach()
        self._rules: list[_Rule] = []
        self._let_pass: Counter[Frame] = Counter()
        bus.frame_filters.append(self._filter)

    def lose(self, match: Match, count: int) -> None:
        """Lose frames."""
        self._add(match, count, lambda _identifier, _data, _host: None)

    def repeat(self, match: Match, count: int) -> None:
        """Deliver frames twice, the second time as soon as the bus is free."""

        def change(identifier: int, data: bytes, host: bool) -> Frame:
            self._send_again(identifier, data, host)
            return identifier, data

        self._add(match, count, change)

    def delay(self, match: Match, count: int, by_s: float) -> None:
        """Deliver frames with a delay of ``by_s``."""

        def change(identifier: int, data: bytes, host: bool) -> None:
            due = self._clock.now_ns() + round(by_s * 1e9)
            self._clock.call_at(due, lambda: self._send_again(identifier, data, host))

        self._add(match, count, change)

    def flip(self, match: Match, count: int, bit: int) -> None:
        """Invert one data bit; shorter frames are unchanged."""

        def change(identifier: int, data: bytes, _host: bool) -> Frame:
            spoiled = bytearray(data)
            if bit >> 3 < len(spoiled):
                spoiled[bit >> 3] ^= 1 << (bit & 7)
            return identifier, bytes(spoiled)

        self._add(match, count, change)

    def shorten(self, match: Match, count: int) -> None:
        """Remove the last byte of frames."""
        self._add(match, count, lambda identifier, data, _host: (identifier, data[:-1]))

    def refuse_sdo(self, node_id: int, count: int, code: int = GENERAL_ERROR) -> None:
        """Answer SDO requests to a node with an abort as if from the node."""

        def change(_identifier: int, data: bytes, _host: bool) -> None:
            answer = bytes([_SDO_ABORT]) + data[1:4] + struct.pack("<I", code)
            self._ghost.send(_SDO_ANSWER + node_id, answer)

        self._add(
            lambda identifier, host: host and identifier == _SDO_REQUEST + node_id, count, change
        )

    def bus_off(self, for_s: float | None) -> None:
        """Put the host's controller into the state bus-off, for a time (s) or permanently
        (None).
        """
        self._bus.down = True
        if for_s is not None:
            self._clock.call_at(self._clock.now_ns() + round(for_s * 1e9), self._recover)

    def error_frames(self, count: int) -> None:
        """Deliver this number of error frames to the host."""
        for _ in range(count):
            self._bus.disturb()

    def restart(self, node_id: int) -> None:
        """Restart a node, as after a short failure of its supply."""
        self._ghost.send(0x000, bytes([129, node_id]))

    def _add(
        self, match: Match, count: int, change: Callable[[int, bytes, bool], Frame | None]
    ) -> None:
        self._rules.append(_Rule(match, count or None, change))

    def _recover(self) -> None:
        self._bus.down = False

    def _send_again(self, identifier: int, data: bytes, host: bool) -> None:
        if host:
            if self._bus.down:
                return
            self._let_pass[identifier, data] += 1
            self._bus.transmit(identifier, data)
        else:
            self._let_pass[identifier, data] += 1
            self._ghost.send(identifier, data)

    def _filter(self, _now: int, identifier: int, data: bytes, host: bool) -> Frame | None:
        if self._let_pass[identifier, data]:
            self._let_pass[identifier, data] -= 1
            return identifier, data
        for rule in self._rules:
            if rule.match(identifier, host):
                if rule.left is not None:
                    rule.left -= 1
                    if not rule.left:
                        self._rules.remove(rule)
                return rule.change(identifier, data, host)
        return identifier, data
