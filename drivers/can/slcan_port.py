"""A CAN adapter on a serial line ("slcan") as the port of a link."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

from drivers.can import slcan
from drivers.can.port import raw_frame
from drivers.clock import NS, Clock
from drivers.interfaces import RawFrame
from drivers.port_errors import close_all, os_errors
from drivers.serial_port import BytePort, PySerialPort

_TTY_BAUD: Final = 115_200
_START_S: Final = 2.0
"""After its port was opened an adapter may restart, and is deaf for as long."""


class SlcanPort:
    """A CAN adapter that speaks the LAWICEL protocol; a :class:`~drivers.can.port.FramePort`.

    It takes the place of python-can's ``slcan``, whose write waits without limit for a line that
    takes nothing, whose read takes a millisecond where there is nothing, and which a byte outside
    ASCII leaves unable to read for good.

    A garbled line is dropped and counted, and the frames after it are read. That is the safer
    choice against an error: what is lost is one frame, on which the link decides as on any other
    lost frame (stale sample, no answer, no heartbeat), while an error could cut short the very
    exchange that takes the power off. A line that is garbled all the time brings no frames, and
    ends in the link's own time limits.

    Args:
        line: The adapter's serial line, opened; closed by :meth:`shutdown`.
        clock: What stamps the frames.
        bitrate: Of the CAN bus, bit/s.

    Attributes:
        decoder: Has the number of bad lines.

    Raises:
        OSError: The line is gone, or adapters do not know this rate.
    """

    @os_errors
    def __init__(self, line: BytePort, clock: Clock, bitrate: int) -> None:
        self.decoder = slcan.LineDecoder()
        self._line = line
        self._clock = clock
        speed = slcan.SPEEDS.get(bitrate)
        if speed is None:
            known = ", ".join(f"{rate}" for rate in slcan.SPEEDS)
            raise OSError(f"an slcan adapter has no {bitrate} bit/s, choose one of {known}")
        # The first of two ends what a program before this one may have left half said. Its frames
        # are not for us.
        line.write(2 * slcan.CLOSE)
        line.discard()
        line.write(speed)
        line.write(slcan.OPEN)

    @os_errors
    def transmit(self, identifier: int, data: bytes) -> None:
        """Send a frame.

        Raises:
            OSError: The line is gone, or does not take it in time.
        """
        self._line.write(slcan.encode(identifier, data))

    @os_errors
    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return what has come in.

        Raises:
            OSError: The line is gone.
        """
        deadline = self._clock.now_ns() + round(timeout_s * NS)
        while True:
            left = deadline - self._clock.now_ns()
            found = self.decoder.feed(self._line.read(max(left, 0) / NS))
            if found or left <= 0:
                now = self._clock.now_ns()
                return [raw_frame((now, identifier, data, False)) for identifier, data in found]

    def shutdown(self) -> None:
        """Close the adapter's channel and the line; safe to call twice, raises nothing."""
        close_all(partial(self._line.write, slcan.CLOSE), self._line.close)


@os_errors
def open_slcan(
    channel: str,
    clock: Clock,
    bitrate: int,
    tty_baudrate: int = _TTY_BAUD,
    sleep_after_open: float = _START_S,
    rtscts: bool = False,
    timeout: float | None = None,
) -> SlcanPort:
    """Open an adapter. The options are those of python-can's ``slcan``.

    Args:
        channel: Device of this computer; ``@`` and a rate after it replace ``tty_baudrate``.
        clock: What stamps the frames.
        bitrate: Of the CAN bus, bit/s.
        tty_baudrate: Of the serial line, bit/s; of no account on a USB port.
        sleep_after_open: How long the adapter takes to start, s.
        rtscts: Hardware flow control of the serial line.
        timeout: Taken and not used: a read waits for as long as its caller asks.

    Raises:
        OSError: It cannot be opened, or another program holds it.
    """
    path, _, baud = channel.partition("@")
    line = PySerialPort(path, int(baud) if baud else tty_baudrate, rtscts)
    try:
        clock.sleep_until_ns(clock.now_ns() + round(sleep_after_open * NS))
        return SlcanPort(line, clock, bitrate)
    except BaseException:
        line.close()
        raise
