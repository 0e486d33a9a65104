"""Driver of the AMT21 absolute encoder on RS-485; checks the plausibility of its answers.

The check bits of an answer do not detect 46 % of double-bit errors and 25 % of random words;
therefore every position must also be one that the joint can have reached
(:class:`PlausibilityGate`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from drivers.amt21.line import Amt21Line
from drivers.can.timing import ANSWER_SHARE
from drivers.clock import NS
from drivers.errors import ConfigurationError, DeviceError
from drivers.interfaces import Encoder, EncoderSample, Identity
from drivers.objects import refusal
from drivers.units import EncoderScales, nearest

COUNTS_PER_TURN: Final = 1 << 14
TURNS: Final = 1
EXTENDED: Final = 2
RESET: Final = 0x75
SET_ZERO: Final = 0x5E
"""Offsets added to the address, and the commands sent after ``address + EXTENDED``."""

_ODD: Final = 0x2AAA
_EVEN: Final = 0x1555
_VALUE: Final = 0x3FFF
_PROBES: Final = 5
_STILL_COUNTS: Final = 2


def encode(value: int) -> bytes:
    """Return the answer with a 14-bit value; bit 15 checks the odd bits, bit 14 the even bits."""
    value &= _VALUE
    odd = 1 - ((value & _ODD).bit_count() & 1)
    even = 1 - ((value & _EVEN).bit_count() & 1)
    return (value | odd << 15 | even << 14).to_bytes(2, "little")


def decode(answer: bytes) -> int | None:
    """Return the 14-bit value of an answer, or None if its length or a check bit is wrong."""
    if len(answer) != 2:
        return None
    value = (answer[0] | answer[1] << 8) & _VALUE
    return value if encode(value) == answer else None


class PlausibilityGate:
    """Tracks positions modulo a turn, and rejects positions that the joint cannot have reached
    since the last good position.

    Args:
        speed_counts_s: Greatest speed.
        acceleration_counts_s2: Greatest acceleration.
    """

    SLACK_COUNTS: Final = 2.0
    """Largest effect of rounding to counts on a difference of two positions."""
    PATIENCE_S: Final = 0.02
    PATIENCE_PERIODS: Final = 3
    """Number of periods without a good value after which the joint may be anywhere; then every
    value is rejected until the next start.
    """

    def __init__(self, speed_counts_s: float, acceleration_counts_s2: float) -> None:
        self._fastest = speed_counts_s
        self._strongest = acceleration_counts_s2
        self._seen_ns: int | None = None
        self._interval_s = 0.0
        self._patience_s = 0.0
        self._speed = 0.0
        self.position = 0

    def start(self, value: int, period_s: float, near: int = 0) -> None:
        """Start from a trusted position: of all turns, the turn nearest to ``near`` is taken.

        The joint is assumed at rest until the next position; that position may differ by the motion
        of one period.
        """
        self.position = nearest(value, COUNTS_PER_TURN, near)
        self._seen_ns = None
        self._interval_s = period_s
        self._patience_s = max(self.PATIENCE_S, self.PATIENCE_PERIODS * period_s)
        self._speed = 0.0

    def admit(self, value: int, time_ns: int) -> bool:
        """Accept a new value into :attr:`position`, or reject it and change nothing."""
        elapsed_s = self._interval_s if self._seen_ns is None else (time_ns - self._seen_ns) / NS
        if not 0.0 < elapsed_s <= self._patience_s:
            return False
        half = COUNTS_PER_TURN // 2
        moved = (value - self.position + half) % COUNTS_PER_TURN - half
        if abs(moved) > self._fastest * elapsed_s + self.SLACK_COUNTS:
            return False
        # The speed comes from two rounded positions; its error grows with the time of
        # extrapolation.
        slack = self.SLACK_COUNTS * (1.0 + elapsed_s / self._interval_s)
        if abs(moved - self._speed * elapsed_s) > self._strongest * elapsed_s * elapsed_s + slack:
            return False
        self.position += moved
        self._seen_ns, self._interval_s, self._speed = time_ns, elapsed_s, moved / elapsed_s
        return True


@dataclass(frozen=True)
class Gate:
    """Highest joint speed, rad/s, and acceleration, rad/s^2, for which a position is accepted."""

    speed_rad_s: float
    acceleration_rad_s2: float


class Amt21Encoder(Encoder):
    """The encoder on its line.

    After a bad or implausible answer the angle is unchanged and the sample is not fresh.

    Args:
        line: Exchanged once a cycle by an :class:`~drivers.amt21.link.EncoderLink`.
        scales: Its sense and zero, from the bench file; 16384 counts per turn.
        gate: Limits of plausible motion.
    """

    def __init__(self, line: Amt21Line, scales: EncoderScales, gate: Gate) -> None:
        if scales.counts_per_turn != COUNTS_PER_TURN:
            raise ConfigurationError(
                f"an AMT21 has {COUNTS_PER_TURN} counts per turn, but the bench file states "
                f"{scales.counts_per_turn}"
            )
        self.line = line
        self._scales = scales
        per_rad = 1.0 / abs(scales.rad_per_count)
        self._gate = PlausibilityGate(
            gate.speed_rad_s * per_rad, gate.acceleration_rad_s2 * per_rad
        )
        self._asked_ns = 0
        self._fresh = False

    def identity(self) -> Identity:
        """Return the identity from the bench file; the encoder has no query for it."""
        return Identity(f"AMT21 at {self.line.address:02X}h", 0, 0, 0, 0)

    def reading(self) -> float:
        """Ask for the position once; return NaN if the answer is bad.

        Raises:
            LinkError: No encoder answers.
        """
        self.line.find_echo()
        value = self._ask()
        if value is None:
            return math.nan
        return self._angle(nearest(value, COUNTS_PER_TURN, self._scales.middle))

    def refusals(self, cycle_s: float) -> Iterator[DeviceError]:
        """Yield an error if the answers of the encoder at rest do not agree.

        Raises:
            LinkError: No encoder answers.
        """
        yield from refusal(self._trusted)

    def prepare(self, cycle_s: float) -> None:
        """Find the encoder, and start from a position at rest on which several answers agree.

        Raises:
            LinkError: No encoder answers.
            ConfigurationError: Its answers do not agree.
        """
        self._gate.start(self._trusted(), cycle_s, near=self._scales.middle)
        self.line.answer_s = ANSWER_SHARE * cycle_s
        self._fresh = True

    def turns(self) -> int | None:
        """Read the turn counter of a multi-turn version, as a signed number; return None if the
        answer is bad.

        Raises:
            LinkError: The line is gone.
        """
        value = self._ask(TURNS)
        return None if value is None else (value ^ 0x2000) - 0x2000

    def set_zero(self) -> None:
        """Make the present position the zero of a single-turn version; the encoder then restarts
        and must be prepared again.

        Raises:
            LinkError: The line is gone.
        """
        self.line.ask(EXTENDED, SET_ZERO)
        self._fresh = False

    def reset(self) -> None:
        """Restart the encoder, which must then be prepared again.

        Raises:
            LinkError: The line is gone.
        """
        self.line.ask(EXTENDED, RESET)
        self._fresh = False

    def ask(self) -> None:
        """Ask for the position of this cycle.

        Raises:
            LinkError: The line is gone.
        """
        self.line.ask()
        self._asked_ns = self.line.asked_ns
        self._fresh = False

    def collect(self) -> None:
        """Receive the answer; use it if plausible.

        Raises:
            LinkError: The line is gone.
        """
        self.line.collect()
        value = decode(self.line.answer)
        self._fresh = value is not None and self._gate.admit(value, self._asked_ns)

    def sample(self) -> EncoderSample:
        """Return the sample of the last exchange, stamped by the host: the encoder has no time of
        its own.
        """
        return EncoderSample(self._asked_ns / NS, self._angle(self._gate.position), self._fresh)

    def _angle(self, counts: int) -> float:
        return counts * self._scales.rad_per_count + self._scales.offset_rad

    def _trusted(self) -> int:
        """Return a position at rest on which several answers agree; the errors are those of
        :meth:`prepare`.
        """
        line = self.line
        line.find_echo()
        values = [self._ask() for _ in range(_PROBES)]
        good = [value for value in values if value is not None]
        apart = max(((v - good[0] + 512) % COUNTS_PER_TURN - 512 for v in good), key=abs, default=0)
        if len(good) < _PROBES or abs(apart) > _STILL_COUNTS:
            raise ConfigurationError(
                f"{line.name}: {_PROBES} answers at rest should agree to {_STILL_COUNTS} counts, "
                f"got {values}; "
                "check shielding and termination, and that the joint stands still"
            )
        return good[-1]

    def _ask(self, offset: int = 0) -> int | None:
        self.line.ask(offset)
        self.line.collect()
        return decode(self.line.answer)
