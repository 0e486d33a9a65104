"""The RS-485 line of an AMT21 encoder."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from drivers.clock import NS, Clock
from drivers.errors import LinkError
from drivers.interfaces import RawFrame
from drivers.port_errors import close_all, opened, words
from drivers.serial_port import BytePort, raw_frames

DEFAULT_ADDRESS: Final = 0x54
_ANSWER_BYTES: Final = 2
_FIRST_ANSWER_S: Final = 0.05
_PROBES: Final = 5
_FRAMES_KEPT: Final = 1 << 14


class Amt21Line:
    """The RS-485 line of one encoder.

    Args:
        clock: Real or simulated clock, as the port.
        connect: Opens the line.
        name: Name of the line in messages.
        address: Address of the encoder; a multiple of 4.

    Attributes:
        answer: The last answer without the echo; empty if no answer arrived.
        asked_ns: Time of the last request, ns.
        answer_s: Time-out of an answer after its request, s.
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
        self.answer = b""
        self.asked_ns = 0
        self.answer_s = _FIRST_ANSWER_S
        self._connect = connect
        self._port: BytePort | None = None
        self._echo = b""
        self._frames: deque[RawFrame] = deque(maxlen=_FRAMES_KEPT)

    def open(self) -> None:
        """Open the line.

        Raises:
            LinkError: It cannot be opened.
        """
        if self._port is None:
            advice = "check the name of the port and your permission to use it"
            self._port = opened(self._connect, self.name, advice)

    def close(self) -> None:
        """Close the line; safe to call twice and after a failure. Raises nothing."""
        port, self._port = self._port, None
        if port is not None:
            close_all(port.close)

    def find_echo(self) -> None:
        """Detect whether the adapter returns the bytes that it sends (echo).

        Raises:
            LinkError: No encoder answers.
        """
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

    def ask(self, offset: int = 0, *command: int) -> None:
        """Send a request; the encoder latches its position when it receives the request.

        Raises:
            LinkError: The line is gone.
        """
        port = self._opened()
        request = bytes([self.address + offset, *command])
        try:
            port.discard()
            port.write(request)
        except Exception as error:
            raise self._gone(error) from error
        self.asked_ns = self.clock.now_ns()
        self.answer = b""
        self._frames.extend(raw_frames(self.asked_ns, self.address, request, True))

    def collect(self, since_ns: int | None = None) -> None:
        """Receive the answer to the last request.

        Args:
            since_ns: Start of the time for the answer; None for the time of the request.

        Raises:
            LinkError: The line is gone.
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
