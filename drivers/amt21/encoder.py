"""The AMT21 encoder over RS-485."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from drivers.can.port import ANSWER_SHARE
from drivers.clock import NS, Clock
from drivers.errors import ConfigurationError, DeviceError, LinkError
from drivers.interfaces import Encoder, EncoderSample, Identity, Link, RawFrame
from drivers.objects import problem_of
from drivers.port_errors import close_all, opened, words
from drivers.serial_port import BytePort, raw_frames
from drivers.units import EncoderScales, nearest

DEFAULT_ADDRESS: Final = 0x54
_ANSWER_BYTES: Final = 2
_FIRST_ANSWER_S: Final = 0.05
_PROBES: Final = 5
_FRAMES_KEPT: Final = 1 << 14


class Amt21Line:
    """The RS-485 line of one encoder; LinkError if the line or the encoder is gone.

    Args:
        clock: Real or simulated clock, as the port.
        address: Address of the encoder; a multiple of 4.
    """

    def __init__(
        self,
        clock: Clock,
        connect: Callable[[], BytePort],
        name: str,
        address: int = DEFAULT_ADDRESS,
    ) -> None:
        self.clock = clock
        self.address = address
        self.name = name
        self.answer = b""  # the last answer without the echo; empty if no answer arrived
        self.asked_ns = 0  # time of the last request, ns
        self.answer_s = _FIRST_ANSWER_S  # time-out of an answer after its request, s
        self._connect = connect
        self._port: BytePort | None = None
        self._echo = b""
        self._frames: deque[RawFrame] = deque(maxlen=_FRAMES_KEPT)

    def open(self) -> None:
        """Open the line."""
        if self._port is None:
            advice = "check the name of the port and your permission to use it"
            self._port = opened(self._connect, self.name, advice)

    def close(self) -> None:
        """Close the line; safe to call twice and after a failure. Raises nothing."""
        port, self._port = self._port, None
        if port is not None:
            close_all(port.close)

    def find_echo(self) -> None:
        """Detect whether the adapter returns the bytes that it sends (echo)."""
        self._echo = b""
        self.answer_s = _FIRST_ANSWER_S
        sent = bytes([self.address])
        for _ in range(_PROBES):
            self.ask()
            heard = self._read(_ANSWER_BYTES + 1)
            if len(heard) == _ANSWER_BYTES:
                return
            if len(heard) == _ANSWER_BYTES + 1 and heard[:1] == sent:
                self._echo = sent
                return
        raise LinkError(
            f"{self.name}: no encoder answers at address {self.address:02X}h; check the power and "
            "wiring of the encoder, the bit rate, and the address"
        )

    def ask(self) -> None:
        """Send a request; the encoder latches its position when it receives the request."""
        port = self._opened()
        request = bytes([self.address])
        try:
            port.discard()
            port.write(request)
        except DeviceError:
            raise
        except Exception as error:
            raise self._gone(error) from error
        self.asked_ns = self.clock.now_ns()
        self.answer = b""
        self._frames.extend(raw_frames(self.asked_ns, self.address, request, True))

    def collect(self, since_ns: int | None = None) -> None:
        """Receive the answer to the last request.

        Args:
            since_ns: Start of the time for the answer; None for the time of the request.
        """
        heard = self._read(len(self._echo) + _ANSWER_BYTES, since_ns)
        self.answer = heard[len(self._echo) :] if heard.startswith(self._echo) else b""

    def take_frames(self) -> list[RawFrame]:
        """Return the bytes that were sent and received since the last call, oldest first."""
        frames = list(self._frames)
        self._frames.clear()
        return frames

    def _read(self, count: int, since_ns: int | None = None) -> bytes:
        port = self._opened()
        since_ns = self.asked_ns if since_ns is None else since_ns
        deadline = since_ns + round(self.answer_s * NS)
        heard = b""
        try:
            # Bytes are read once even after the deadline, because the answer may have arrived
            # before.
            while len(heard) < count:
                left = deadline - self.clock.now_ns()
                got = port.read(max(left, 0) / NS)
                heard += got
                if not got and left <= 0:
                    break
        except DeviceError:
            raise
        except Exception as error:
            raise self._gone(error) from error
        self._frames.extend(raw_frames(self.clock.now_ns(), self.address, heard, False))
        return heard

    def _opened(self) -> BytePort:
        if self._port is None:
            raise LinkError(f"{self.name} is not open: call open() first")
        return self._port

    def _gone(self, error: Exception) -> LinkError:
        return LinkError(f"{self.name} is gone: {words(error)}; check the adapter and its cable")


COUNTS_PER_TURN: Final = 1 << 14
_ODD: Final = 0x2AAA
_EVEN: Final = 0x1555
_VALUE: Final = 0x3FFF

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
    """Tracks positions modulo a turn; rejects positions that the joint cannot have reached."""

    SLACK_COUNTS: Final = 2.0
    """Greatest error of the difference of two positions due to rounding to counts."""

    def __init__(self, speed_counts_s: float, acceleration_counts_s2: float) -> None:
        self._fastest = speed_counts_s
        self._strongest = acceleration_counts_s2
        # After this time at the greatest speed the number of turns is ambiguous.
        self._unambiguous_s = (COUNTS_PER_TURN / 2 - self.SLACK_COUNTS) / speed_counts_s
        self._seen_ns: int | None = None
        self._interval_s = 0.0
        self._speed = 0.0
        self.position = 0

    def start(self, value: int, period_s: float, near: int = 0) -> None:
        """Start from a verified position: of the counts that equal ``value`` modulo a turn, the
        count nearest to ``near`` is used.

        The joint is assumed to rest at this position; the next position may differ by the motion
        in one period.
        """
        self.position = nearest(value, COUNTS_PER_TURN, near)
        self._seen_ns = None
        self._interval_s = period_s
        self._speed = 0.0

    def admit(
        self, value: int, time_ns: int, elsewhere: Callable[[], int | None] | None = None
    ) -> bool:
        """Accept a new value into :attr:`position`, or reject it and change nothing.

        Args:
            value: Position modulo a turn, counts.
            time_ns: Time of the value.
            elsewhere: Returns the position by another sensor, counts, to less than half a turn, or
                None if it is unknown. This position decides the number of turns if the last
                accepted value is older than half a turn at the greatest speed takes.
        """
        elapsed_s = self._interval_s if self._seen_ns is None else (time_ns - self._seen_ns) / NS
        if elapsed_s <= 0.0:
            return False
        half = COUNTS_PER_TURN // 2
        if elapsed_s > self._unambiguous_s:
            near = None if elsewhere is None else elsewhere()
            if near is None:
                return False
            self.position = nearest(value, COUNTS_PER_TURN, near)
            self._seen_ns, self._speed = time_ns, 0.0
            return True
        moved = (value - self.position + half) % COUNTS_PER_TURN - half
        if abs(moved) > self._fastest * elapsed_s + self.SLACK_COUNTS:
            return False
        # The speed is computed from two rounded positions; therefore the error of an extrapolated
        # position grows with time.
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
    """An AMT21 encoder on an RS-485 line.

    After a bad or implausible answer the angle is unchanged and the sample is not fresh.

    Args:
        line: Line of the encoder, which an :class:`EncoderLink` exchanges once a cycle.
        scales: Direction and zero of the encoder, from the bench file; 16384 counts per turn.
        gate: Limits of plausible motion.
        elsewhere_rad: Returns the joint angle by the motor's encoder, rad, or None while it is
            unknown; needed after a pause in which the joint could have made half a turn.
    """

    def __init__(
        self,
        line: Amt21Line,
        scales: EncoderScales,
        gate: Gate,
        elsewhere_rad: Callable[[], float | None] | None = None,
    ) -> None:
        if scales.counts_per_turn != COUNTS_PER_TURN:
            raise ConfigurationError(
                f"an AMT21 encoder has {COUNTS_PER_TURN} counts per turn, but the bench file "
                f"states {scales.counts_per_turn}"
            )
        self.line = line
        self._scales = scales
        per_rad = 1.0 / abs(scales.rad_per_count)
        self._gate = PlausibilityGate(
            gate.speed_rad_s * per_rad, gate.acceleration_rad_s2 * per_rad
        )
        self._elsewhere_rad = elsewhere_rad
        self._asked_ns = 0
        self._fresh = False

    def identity(self) -> Identity:
        """Return the identity from the bench file: the encoder has none."""
        return Identity(f"AMT21 at {self.line.address:02X}h", 0, 0, 0, 0)

    def reading(self) -> float:
        self.line.find_echo()
        value = self._ask()
        if value is None:
            return math.nan
        return self._angle(nearest(value, COUNTS_PER_TURN, self._scales.middle))

    def step_rad(self) -> float:
        return abs(self._scales.rad_per_count)

    def problems(self, cycle_s: float) -> Iterator[DeviceError]:
        yield from problem_of(self._trusted)

    def prepare(self, cycle_s: float) -> None:
        """Find the encoder; start from a position at rest on which several answers agree."""
        self._gate.start(self._trusted(), cycle_s, near=self._scales.middle)
        self.line.answer_s = ANSWER_SHARE * cycle_s
        self._fresh = True

    def ask(self) -> None:
        """Request the position for this cycle."""
        self._fresh = False
        self.line.ask()
        self._asked_ns = self.line.asked_ns

    def collect(self, since_ns: int | None = None) -> None:
        """Receive the answer to the request; use its position if it is plausible.

        Args:
            since_ns: Start of the time for the answer; None for the time of the request.
        """
        self.line.collect(since_ns)
        value = decode(self.line.answer)
        self._fresh = value is not None and self._gate.admit(value, self._asked_ns, self._elsewhere)

    def sample(self) -> EncoderSample:
        return EncoderSample(self._asked_ns / NS, self._angle(self._gate.position), self._fresh)

    def _elsewhere(self) -> int | None:
        angle = None if self._elsewhere_rad is None else self._elsewhere_rad()
        if angle is None:
            return None
        return round((angle - self._scales.offset_rad) / self._scales.rad_per_count)

    def _angle(self, counts: int) -> float:
        return counts * self._scales.rad_per_count + self._scales.offset_rad

    def _trusted(self) -> int:
        """Return a position at rest on which several answers agree."""
        line = self.line
        line.find_echo()
        values = [self._ask() for _ in range(_PROBES)]
        good = [value for value in values if value is not None]
        apart = max(((v - good[0] + 512) % COUNTS_PER_TURN - 512 for v in good), key=abs, default=0)
        if len(good) < _PROBES or abs(apart) > _STILL_COUNTS:
            raise ConfigurationError(
                f"{line.name}: {_PROBES} answers of the encoder at rest must agree to "
                f"{_STILL_COUNTS} counts, but are {values}; check that the joint is at rest, and "
                "the shielding and termination of the line"
            )
        return good[-1]

    def _ask(self) -> int | None:
        self.line.ask()
        self.line.collect()
        return decode(self.line.answer)


class EncoderLink(Link):
    """A servo's link combined with the line of an encoder.

    Each cycle sends the request to the encoder first, or at the instant at which the values of the
    servo hold, and receives its answer last. The servo's exchange is made even if the line of the
    encoder has failed.

    Args:
        servo_link: The link of the servo, on the same clock.
        encoder: The encoder on its line.
        at_instant: Takes the function that the servo's link is to call at this instant; None if its
            values hold at the start of the cycle.
    """

    def __init__(
        self,
        servo_link: Link,
        encoder: Amt21Encoder,
        at_instant: Callable[[Callable[[], None]], None] | None = None,
    ) -> None:
        self.clock = servo_link.clock
        self.has_watchdog = servo_link.has_watchdog
        self._servo_link = servo_link
        self._encoder = encoder
        self._line = encoder.line
        self._asked = True
        self._failures: list[LinkError] = []
        self._failed = False
        self._first = at_instant is None
        if at_instant is not None:
            at_instant(self._ask)

    def open(self) -> None:
        self._servo_link.open()
        try:
            self._line.open()
        except BaseException:
            close_all(self._servo_link.close)
            raise

    def close(self) -> None:
        close_all(self._line.close, self._servo_link.close)

    def exchange(self) -> None:
        """Exchange process data with the servo while the encoder prepares its answer."""
        began_ns = self.clock.now_ns()
        self._asked = False
        self._failures.clear()
        if self._first:
            self._ask()
        self._servo_link.exchange()
        # After a lost answer of the servo no time of this cycle may be left.
        since_ns = began_ns if self._asked else None
        self._ask()
        if not self._failures:
            self._attempt(lambda: self._encoder.collect(since_ns))
        reported, self._failed = self._failed, bool(self._failures)
        if self._failures and not reported:
            raise self._failures[0]

    def _ask(self) -> None:
        """Ask the encoder, once in a cycle."""
        if not self._asked:
            self._asked = True
            self._attempt(self._encoder.ask)

    def _attempt(self, step: Callable[[], None]) -> None:
        """Use the line; store its error."""
        try:
            step()
        except LinkError as error:
            self._failures.append(error)

    def take_frames(self) -> list[RawFrame]:
        frames = self._servo_link.take_frames() + self._line.take_frames()
        return sorted(frames, key=lambda frame: frame.time_ns)
