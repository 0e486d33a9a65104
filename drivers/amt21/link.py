"""Link that exchanges with a servo and with an encoder on a separate line in one cycle."""

from __future__ import annotations

from drivers.amt21.encoder import Amt21Encoder
from drivers.interfaces import Link, RawFrame
from drivers.port_errors import close_all


class EncoderLink(Link):
    """A servo's link combined with an encoder's own line; each cycle requests the encoder first and
    reads it last.

    Args:
        servo_link: The link of the servo, on the same clock.
        encoder: The encoder on its line.
    """

    def __init__(self, servo_link: Link, encoder: Amt21Encoder) -> None:
        self.clock = servo_link.clock
        self.has_watchdog = servo_link.has_watchdog
        self._servo_link = servo_link
        self._encoder = encoder
        self._line = encoder.line

    def open(self) -> None:
        """Open the servo's link and the encoder's line; if one cannot be opened, both are closed.

        Raises:
            LinkError: One cannot be opened.
        """
        self._servo_link.open()
        try:
            self._line.open()
        except BaseException:
            close_all(self._servo_link.close)
            raise

    def close(self) -> None:
        """Close link and line; safe to call twice and after a failure. Raises nothing."""
        close_all(self._line.close, self._servo_link.close)

    def exchange(self) -> None:
        """Exchange with the servo while the encoder answers.

        Raises:
            LinkError: A bus or line failed.
            DriveFault: A device sent an emergency message.
        """
        self._encoder.ask()
        self._servo_link.exchange()
        self._encoder.collect()

    def take_frames(self) -> list[RawFrame]:
        """Return the frames of link and line since the last call, in the order of time."""
        frames = self._servo_link.take_frames() + self._line.take_frames()
        return sorted(frames, key=lambda frame: frame.time_ns)
