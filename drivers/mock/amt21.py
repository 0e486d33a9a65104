"""Simulated AMT21 encoder at the joint: answers serial requests with the bytes of a real AMT21."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from drivers.amt21.encoder import COUNTS_PER_TURN, EXTENDED, RESET, SET_ZERO, TURNS, encode
from drivers.amt21.line import DEFAULT_ADDRESS
from drivers.clock import NS, SimulatedClock
from drivers.mock.encoder import EXACT_COUNTS
from drivers.mock.sampler import Sampler

RESTART_S: Final = 0.2


class SimulatedAmt21:
    """A simulated multi-turn encoder; a :class:`~drivers.mock.wires.serial_line.Station`.

    The encoder ignores requests for 0.2 s after a reset and after its zero was set.

    Args:
        clock: Simulated time.
        sampler: Sampler of the machine.
        address: Address of the encoder, a multiple of 4.

    Attributes:
        distort: Function that changes the counts as a faulty sensor does, or None for a sensor
            without fault.
    """

    counts_per_turn: Final = COUNTS_PER_TURN

    def __init__(
        self, clock: SimulatedClock, sampler: Sampler, address: int = DEFAULT_ADDRESS
    ) -> None:
        self.distort: Callable[[int], int] | None = None
        self._clock = clock
        self._sampler = sampler
        self._address = address
        self._resolution = sampler.machine.constants.sensing.joint_counts_per_turn or EXACT_COUNTS
        self._zero = 0
        self._extended = False
        self._deaf_until_ns = 0

    def receive(self, data: bytes) -> bytes:
        """Return the answers to the requests in ``data``; requests to other addresses get no
        answer.
        """
        if self._clock.now_ns() < self._deaf_until_ns:
            return b""
        return b"".join(self._answer(byte) for byte in data)

    def _answer(self, byte: int) -> bytes:
        if self._extended:
            self._extended = False
            if byte == SET_ZERO:
                self._zero += self._counts()
            if byte in (SET_ZERO, RESET):
                self._deaf_until_ns = self._clock.now_ns() + round(RESTART_S * NS)
            return b""
        match byte - self._address:
            case 0:
                return encode(self._counts())
            case value if value == TURNS:
                return encode(self._counts() // COUNTS_PER_TURN)
            case value if value == EXTENDED:
                self._extended = True
        return b""

    def _counts(self) -> int:
        joint = self._sampler.peek(self._clock.now_ns()).joint_counts
        counts = joint * COUNTS_PER_TURN // self._resolution
        return (counts if self.distort is None else self.distort(counts)) - self._zero
