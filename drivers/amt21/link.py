"""Link that exchanges with a servo and with an encoder on a separate line in one cycle."""

from __future__ import annotations

from collections.abc import Callable

from drivers.amt21.encoder import Amt21Encoder
from drivers.errors import LinkError
from drivers.interfaces import Link, RawFrame
from drivers.port_errors import close_all


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
        """Open the servo's link and the encoder's line; if one of the two cannot be opened, both
        are closed.

        Raises:
            LinkError: The link or the line cannot be opened.
        """
        self._servo_link.open()
        try:
            self._line.open()
        except BaseException:
            close_all(self._servo_link.close)
            raise

    def close(self) -> None:
        """Close link and line. This method raises no error, and may be called twice and after a
        failure.
        """
        close_all(self._line.close, self._servo_link.close)

    def exchange(self) -> None:
        """Exchange process data with the servo while the encoder prepares its answer.

        Raises:
            LinkError: The bus failed, or the line of the encoder failed, which is reported once
                until it works again; the values of the encoder are then not fresh.
            DriveFault: A device sent an emergency message.
        """
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
        """Return the frames of link and line since the last call, oldest first."""
        frames = self._servo_link.take_frames() + self._line.take_frames()
        return sorted(frames, key=lambda frame: frame.time_ns)
