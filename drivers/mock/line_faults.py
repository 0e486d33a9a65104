"""Injects serial line faults: lost, corrupted, late and repeated messages, unplugged line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drivers.clock import SimulatedClock
from drivers.epos.frames import DLE, ERROR, Opcode, encode
from drivers.mock.faults import GENERAL_ERROR
from drivers.mock.wires.serial_line import SimulatedLine

_BROKEN_STUFFING: Final = bytes([DLE, 0x01])
_HEAD: Final = 4


@dataclass
class _Rule:
    from_host: bool | None
    left: int | None
    change: Callable[[bytes, bool], bytes]


class LineFaults:
    """Loses, corrupts, delays and repeats messages on a simulated serial line.

    Several faults may be active at the same time.

    ``from_host`` selects requests (True), answers (False) or both (None); ``count`` is the number
    of affected messages, 0 for all messages from now on.

    Args:
        line: The line; its ``filters`` and ``cut`` are used.
        clock: Simulated time.
    """

    def __init__(self, line: SimulatedLine, clock: SimulatedClock) -> None:
        self._line = line
        self._clock = clock
        self._rules: list[_Rule] = []
        self._free_ns = {True: 0, False: 0}
        line.filters.append(self._filter)

    def lose(self, from_host: bool | None, count: int) -> None:
        """Lose messages."""
        self._add(from_host, count, lambda _data, _host: b"")

    def drop_byte(self, from_host: bool | None, count: int, at: int) -> None:
        """Lose byte number ``at``, counted from 0; in a shorter message, lose the last byte."""

        def change(data: bytes, _host: bool) -> bytes:
            place = min(at, len(data) - 1)
            return data[:place] + data[place + 1 :]

        self._add(from_host, count, change)

    def flip(self, from_host: bool | None, count: int, bit: int) -> None:
        """Invert bit number ``bit``, counted from the lowest bit of the first byte; in a shorter
        message, invert a bit of the last byte.
        """

        def change(data: bytes, _host: bool) -> bytes:
            spoiled = bytearray(data)
            spoiled[min(bit >> 3, len(spoiled) - 1)] ^= 1 << (bit & 7)
            return bytes(spoiled)

        self._add(from_host, count, change)

    def break_stuffing(self, from_host: bool | None, count: int) -> None:
        """Insert a single byte 90h after opcode and length; the byte stuffing requires two."""
        self._add(
            from_host, count, lambda data, _host: data[:_HEAD] + _BROKEN_STUFFING + data[_HEAD:]
        )

    def delay(self, from_host: bool | None, count: int, by_s: float) -> None:
        """Deliver messages with a delay of ``by_s``; later messages wait, because bytes keep their
        order on a line.
        """
        self._add(
            from_host,
            count,
            lambda data, host: self._hold(data, host, self._clock.now_ns() + round(by_s * 1e9)),
        )

    def repeat(self, from_host: bool | None, count: int) -> None:
        """Deliver messages twice in direct succession."""
        self._add(from_host, count, lambda data, _host: data + data)

    def refuse(self, count: int) -> None:
        """Answer an EPOS request with an error code as if from the drive."""

        def change(_data: bytes, _host: bool) -> bytes:
            self._line.deliver(encode(Opcode.ANSWER, ERROR.pack(GENERAL_ERROR)), False)
            return b""

        self._add(True, count, change)

    def cut(self, for_s: float | None) -> None:
        """Unplug the line, for a time (s) or permanently (None)."""
        self._line.cut = True
        if for_s is not None:
            self._clock.call_at(self._clock.now_ns() + round(for_s * 1e9), self._mend)

    def _hold(self, data: bytes, host: bool, until_ns: int) -> bytes:
        self._free_ns[host] = due = max(until_ns, self._free_ns[host])
        self._clock.call_at(due, lambda: self._line.deliver(data, host))
        return b""

    def _mend(self) -> None:
        self._line.cut = False

    def _add(
        self, from_host: bool | None, count: int, change: Callable[[bytes, bool], bytes]
    ) -> None:
        self._rules.append(_Rule(from_host, count or None, change))

    def _filter(self, now: int, data: bytes, host: bool) -> bytes:
        data = self._changed(data, host)
        return self._hold(data, host, now) if data and now < self._free_ns[host] else data

    def _changed(self, data: bytes, host: bool) -> bytes:
        for rule in self._rules:
            if data and rule.from_host in (None, host):
                if rule.left is not None:
                    rule.left -= 1
                    if not rule.left:
                        self._rules.remove(rule)
                return rule.change(data, host)
        return data
