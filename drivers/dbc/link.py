"""One CAN bus with CANopen devices and with drives that have their own frames (DBC files)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from types import MappingProxyType
from typing import Final

from drivers.can.port import EXTENDED_FLAG, REMOTE_FLAG, hexadecimal
from drivers.canopen.link import CanopenLink
from drivers.clock import NS
from drivers.dbc.channel import DbcChannel, Slot
from drivers.dbc.codec import Wiring
from drivers.errors import ConfigurationError
from drivers.interfaces import RawFrame
from drivers.port_errors import close_all

_RESERVED: Final = {0x000: "the NMT command", 0x080: "SYNC"}
_BACKLOG_READS: Final = 64
_ASK_S: Final = 0.02  # time after which a drive is asked again if no answer has arrived, s


class DbcLink(CanopenLink):
    """A :class:`CanopenLink` for buses that also have drives with their own frames.

    Every exchange sends the commands first and then SYNC, so that drive and encoder sample within
    one frame time. Closing the link sends the stop frame to every drive that received a command.
    """

    _channels: tuple[DbcChannel, ...] = ()
    _routes: Mapping[int, tuple[DbcChannel, Slot]] = MappingProxyType({})

    def add_channel(self, wiring: Wiring, label: str) -> DbcChannel:
        """Declare a drive on the bus."""
        channel = DbcChannel(wiring, label)
        self._channels = (*self._channels, channel)
        return channel

    def open(self) -> None:
        for conflict in self.problems():
            raise ConfigurationError(conflict)
        routes = {
            identifier: (channel, slot)
            for channel in self._channels
            for identifier, slot in channel.slots.items()
        }
        self._routes = routes
        super().open()

    def problems(self) -> Iterator[str]:
        """Yield a text for each CAN identifier of a drive that is used twice on this bus."""
        taken: set[int] = set()
        for channel in self._channels:
            wiring = channel.wiring
            sent = (
                *(wiring.stop_message, *wiring.sent.values()),
                *(*wiring.once.values(), *wiring.settings.values()),
            )
            for identifier in dict.fromkeys((*(m.identifier for m in sent), *channel.slots)):
                if identifier in taken or (owner := self._canopen_owner(identifier)):
                    who = "another drive" if identifier in taken else owner
                    yield (
                        f"{channel.label} and {who} both use the CAN identifier "
                        f"{hexadecimal(identifier)}: change one of the two"
                    )
            taken.update(channel.slots)

    def _canopen_owner(self, identifier: int) -> str:
        node = identifier & 0x7F
        if 0x080 < identifier < EXTENDED_FLAG and (node in self._nodes or node == self.master_id):
            return f"CANopen node {node}"
        return _RESERVED.get(identifier, "")

    def close(self) -> None:
        """Send the stop frame to each drive that received a command, then close the bus.

        The method raises no error, may be called twice, and may be called after a failure.
        """
        commanded = (
            [channel for channel in self._channels if channel.commanded]
            if self._port is not None
            else []
        )
        stops = [partial(self.stop, channel) for channel in commanded]
        close_all(*stops, super().close)

    def exchange(self) -> None:
        """Send every command, then SYNC, and collect the answers, for at most 80 % of the cycle."""
        self.exchanged = False
        self._receive(0.0)
        now = self.clock.now_ns()
        deadline = now + self._answer_ns
        for channel in self._channels:
            channel.begin(now)
            for identifier, data in channel.frames():
                self.send(identifier, data)
            for identifier in channel.requests():
                self.send(identifier, b"")
        super().exchange()
        if not self._answered():
            self.pump(self._answered, (deadline - self.clock.now_ns()) / NS)
        for channel in self._channels:
            channel.settle()

    def _answered(self) -> bool:
        return all([channel.answered for channel in self._channels])

    def command(self, channel: DbcChannel) -> None:
        """Send a drive its order immediately, outside the control cycle."""
        for identifier, data in channel.frames(all_now=True):
            self.send(identifier, data)

    def drain(self, channel: DbcChannel) -> None:
        """Process the frames of a drive that have arrived so far."""
        for _ in range(_BACKLOG_READS):
            heard = channel.heard
            self._receive(0.0)
            if channel.heard == heard:
                break

    def stop(self, channel: DbcChannel) -> None:
        """Send a drive its stop frame immediately."""
        self.send(*channel.stop_frame())

    def request(self, slot: Slot) -> None:
        """Request a message that a drive sends only in answer to a remote frame."""
        if slot.message.remote:
            self.send(slot.message.identifier | REMOTE_FLAG, b"")

    def await_frame(
        self,
        channel: DbcChannel,
        slot: Slot,
        timeout_s: float,
        ask: Callable[[], object] | None = None,
    ) -> bool:
        """Wait for a valid frame that arrives after this call; return False after the time-out.

        ``ask``: function that asks for the message, called until the message arrives; None for a
        message that the drive sends by itself.
        """
        self.drain(channel)
        count = slot.count
        if ask is None:
            return self.pump(lambda: slot.count != count, timeout_s)
        deadline = self.clock.now_ns() + round(timeout_s * NS)
        while (left := deadline - self.clock.now_ns()) > 0:
            ask()
            if self.pump(lambda: slot.count != count, min(_ASK_S, left / NS)):
                return True
        return False

    def _handle(self, frame: RawFrame) -> None:
        route = self._routes.get(frame.identifier)
        if route is None:
            super()._handle(frame)
            return
        self._frames.append(frame)
        channel, slot = route
        channel.receive(slot, frame.data, frame.time_ns)
