"""A CAN bus in simulated time: one wire, exact frame times, arbitration, no threads and no wall clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import can

from drivers.clock import NS, SimulatedClock

Handler = Callable[[bytes], None]
FrameFilter = Callable[[int, int, bytes, bool], tuple[int, bytes] | None]
"""Called with (time in ns, identifier, data, sent by the host); returns the frame to deliver, or None to lose it."""

_IDLE_ID: Final = 1 << 30


def frame_bits(length: int) -> int:
    """Return the longest a base-format data frame of ``length`` bytes can be, in bit times.

    34 + 8 n bits are subject to stuffing, one stuff bit after every four at worst; 13 bits (delimiters, acknowledge,
    end of frame, intermission) are not.
    """
    stuffed = 34 + 8 * length
    return stuffed + (stuffed - 1) // 4 + 13


class Port:
    """One controller on the bus: sends in order, and hears the identifiers it listens to."""

    def __init__(self, bus: SimulatedBus) -> None:
        self._bus = bus
        self.queue: deque[tuple[int, bytes]] = deque()
        self.handlers: dict[int, Handler] = {}

    def send(self, identifier: int, data: bytes) -> None:
        """Queue a frame; it goes out when it wins arbitration."""
        self.queue.append((identifier, data))
        if self._bus.idle:
            self._bus.start()

    def listen(self, identifier: int, handler: Handler) -> None:
        """Hand every frame with this identifier, from any other controller, to ``handler``."""
        self.handlers[identifier] = handler
        self._bus.reroute()

    def ignore(self, identifier: int) -> None:
        """Stop listening to an identifier; harmless if nobody did."""
        self.handlers.pop(identifier, None)
        self._bus.reroute()


class SimulatedBus(can.BusABC):
    """The host's python-can interface to the simulated bus.

    Every frame takes its worst-case time at ``bitrate``. Among the controllers that wait when the wire falls idle, the
    lowest identifier goes first; a controller sends its own frames in order. :meth:`recv` advances the clock.

    Attributes:
        frame_filters: Hooks for fault injection, applied in order to every frame on the wire.
        down: True when the controller is bus-off; sending then fails.
        idle: True while no frame is on the wire.
    """

    def __init__(self, clock: SimulatedClock, bitrate: int = 1_000_000) -> None:
        super().__init__(channel=0)
        self.channel_info = f"simulated bus at {bitrate} bit/s"
        self.bitrate = bitrate
        self.frame_filters: list[FrameFilter] = []
        self.down = False
        self._clock = clock
        self._times = [frame_bits(n) * NS // bitrate for n in range(9)]
        self._ports: list[Port] = []
        self._host = self.attach()
        self.idle = True
        self._sender: Port | None = None
        self._received: deque[can.Message] = deque()
        self._routes: dict[int, list[tuple[Port, Handler]]] = {}

    def attach(self) -> Port:
        """Put another controller on the bus."""
        port = Port(self)
        self._ports.append(port)
        return port

    def reroute(self) -> None:
        """Rebuild the routes after a controller changed what it listens to."""
        routes: dict[int, list[tuple[Port, Handler]]] = {}
        for port in self._ports:
            for identifier, handler in port.handlers.items():
                routes.setdefault(identifier, []).append((port, handler))
        self._routes = routes

    def start(self) -> None:
        """Begin the next frame, if somebody waits; the wire must be idle."""
        lowest = _IDLE_ID
        for port in self._ports:
            if port.queue and port.queue[0][0] < lowest:
                lowest = port.queue[0][0]
                self._sender = port
        if lowest != _IDLE_ID and self._sender is not None:
            self.idle = False
            length = len(self._sender.queue[0][1])
            self._clock.call_at(self._clock.now_ns() + self._times[length], self._arrived)

    def _arrived(self) -> None:
        sender = self._sender
        if sender is None or not sender.queue:
            return
        identifier, data = sender.queue.popleft()
        if self.frame_filters:
            kept = self._filtered(identifier, data, sender is self._host)
            if kept is not None:
                self._deliver(sender, *kept)
        else:
            self._deliver(sender, identifier, data)
        # Receivers queue their answers first, so that all of them take part in the next arbitration.
        self.idle = True
        self.start()

    def _filtered(self, identifier: int, data: bytes, from_host: bool) -> tuple[int, bytes] | None:
        frame: tuple[int, bytes] | None = (identifier, data)
        for keep in self.frame_filters:
            if frame is None:
                return None
            frame = keep(self._clock.now_ns(), *frame, from_host)
        return frame

    def _deliver(self, sender: Port, identifier: int, data: bytes) -> None:
        for port, handler in self._routes.get(identifier, ()):
            if port is not sender:
                handler(data)
        if sender is not self._host:
            message = can.Message(self._clock.now_ns() / NS, identifier, False, data=data)
            if self._filters is None or self._matches_filters(message):
                self._received.append(message)

    def disturb(self) -> None:
        """Let the host's controller see an error frame."""
        self._received.append(can.Message(self._clock.now_ns() / NS, is_error_frame=True, is_extended_id=False))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a frame of the host.

        Raises:
            can.CanOperationError: The bus is down or shut.
        """
        if self.down or self._is_shutdown:
            raise can.CanOperationError("bus-off" if self.down else "the bus is shut")
        self._host.send(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame for the host, advancing simulated time while there is none.

        ``timeout`` is in seconds of simulated time; None waits as long as anything at all is scheduled.

        Raises:
            can.CanOperationError: The bus is shut.
        """
        if self._is_shutdown:
            raise can.CanOperationError("the bus is shut")
        received = self._received
        if received:
            return received.popleft()
        clock = self._clock
        deadline = None if timeout is None else clock.now_ns() + round(timeout * NS)
        while True:
            due = clock.next_event_ns()
            if due is None or (deadline is not None and due > deadline):
                if deadline is not None:
                    clock.sleep_until_ns(deadline)
                return None
            clock.sleep_until_ns(due)
            if received:
                return received.popleft()

    def _send_periodic_internal(self, *args: object, **kwargs: object) -> can.CyclicSendTaskABC:
        raise NotImplementedError("the simulated bus has no threads: send from the control loop")
