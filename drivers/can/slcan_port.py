"""Port of a link for a CAN adapter on a serial line ("slcan")."""

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
"""Time during which an adapter may restart and ignore input after its port was opened, s."""


class SlcanPort:
    """A CAN adapter that speaks the LAWICEL protocol; a :class:`~drivers.can.port.FramePort`.

    This port replaces the interface ``slcan`` of python-can, which has three defects: a write to a
    blocked line never returns, a read without data takes a millisecond, and after a byte outside
    ASCII nothing more can be read.

    A garbled line is dropped and counted, and later frames are read. To drop a garbled line is
    safer than to raise an error: the link treats the frame like any other lost frame (stale sample,
    no answer, no heartbeat), whereas an error could abort the exchange that takes the power off. If
    all lines are garbled, no frames arrive and the time-outs of the link act.

    Args:
        line: The adapter's serial line, opened; closed by :meth:`shutdown`.
        clock: Clock for the time stamps of frames.
        bitrate: Bit rate of the CAN bus, bit/s.

    Attributes:
        decoder: The decoder, which counts bad lines.

    Raises:
        OSError: The line is gone, or slcan adapters do not support this bit rate.
    """

    @os_errors
    def __init__(self, line: BytePort, clock: Clock, bitrate: int) -> None:
        self.decoder = slcan.LineDecoder()
        self._line = line
        self._clock = clock
        speed = slcan.SPEEDS.get(bitrate)
        if speed is None:
            known = ", ".join(f"{rate}" for rate in slcan.SPEEDS)
            raise OSError(
                f"an slcan adapter does not support {bitrate} bit/s; choose one of {known}"
            )
        # The first carriage return ends a command that an earlier program may have left incomplete.
        # Frames that were received for the earlier program are discarded.
        line.write(2 * slcan.CLOSE)
        line.discard()
        line.write(speed)
        line.write(slcan.OPEN)

    @os_errors
    def transmit(self, identifier: int, data: bytes) -> None:
        """Send a frame.

        Raises:
            OSError: The line is gone, or does not accept the frame in time.
        """
        self._line.write(slcan.encode(identifier, data))

    @os_errors
    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return the received frames.

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
    exclusive: bool = True,
) -> SlcanPort:
    """Open an adapter. The options are those of the interface ``slcan`` of python-can.

    Args:
        channel: Serial port of this computer; a suffix of ``@`` and a bit rate replaces
            ``tty_baudrate``.
        clock: Clock for the time stamps of frames.
        bitrate: Bit rate of the CAN bus, bit/s.
        tty_baudrate: Bit rate of the serial line, bit/s; without effect on a USB port.
        sleep_after_open: Time that the adapter takes to start, s.
        rtscts: Hardware flow control of the serial line.
        timeout: Accepted but not used, because each read has a time-out of its own.
        exclusive: Whether the port must not be used by another program.

    Raises:
        OSError: The port cannot be opened, or another program uses it.
    """
    path, _, baud = channel.partition("@")
    line = PySerialPort(path, int(baud) if baud else tty_baudrate, rtscts, exclusive)
    try:
        clock.sleep_until_ns(clock.now_ns() + round(sleep_after_open * NS))
        return SlcanPort(line, clock, bitrate)
    except BaseException:
        line.close()
        raise
