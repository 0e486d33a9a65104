"""A CAN bus in simulated time: exact frame times, arbitration, no threads and no wall clock."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import can

from drivers.can.port import ERROR_FLAG, raw_frame
from drivers.can.timing import frame_bits
from drivers.clock import NS, SimulatedClock
from drivers.interfaces import RawFrame

Handler = Callable[[bytes], None]
FrameFilter = Callable[[int, int, bytes, bool], tuple[int, bytes] | None]
"""Called with (time in ns, identifier, data, sent by the host); returns the frame to deliver, or
None to lose it.
"""


_NEVER = 1 << 62


@contextmanager
def _of_python_can() -> Iterator[None]:
    """Translate the bus's errors into those of python-can."""
    try:
        yield
    except OSError as error:
        raise can.CanOperationError(str(error)) from error


class Port:
    """One controller on the bus: sends in order, and hears the identifiers it listens to."""

    def __init__(self, bus: SimulatedBus, number: int) -> None:
        self._bus = bus
        self.number = number
        self.queue: deque[tuple[int, bytes]] = deque()
        self.handlers: dict[int, Handler] = {}

    def send(self, identifier: int, data: bytes) -> None:
        """Queue a frame; it goes out when it wins arbitration."""
        self.queue.append((identifier, data))
        if len(self.queue) == 1:
            self._bus.contend(identifier, self.number)

    def listen(self, identifier: int, handler: Handler) -> None:
        """Hand every frame with this identifier, from any other controller, to ``handler``."""
        self.handlers[identifier] = handler
        self._bus.reroute()

    def ignore(self, identifier: int) -> None:
        """Stop listening to an identifier; harmless if nobody did."""
        self.handlers.pop(identifier, None)
        self._bus.reroute()


class SimulatedBus(can.BusABC):
    """The simulated bus, as the host's controller sees it: a :class:`~drivers.can.port.FramePort`.

    It is an interface of python-can as well, for its tools. Every frame takes its worst-case time
    at ``bitrate``. Among the controllers that wait when the wire falls idle, the lowest identifier
    goes first; a controller sends its own frames in order. :meth:`collect` advances the clock.

    Attributes:
        frame_filters: Hooks for fault injection, applied in order to every frame on the wire.
        down: True while the host's controller is bus-off; sending then fails, and it hears nothing.
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
        self._contenders: list[tuple[int, int]] = []
        self._sender: Port | None = None
        self._received: list[RawFrame] = []
        self._routes: dict[int, list[tuple[Port, Handler]]] = {}

    def attach(self) -> Port:
        """Put another controller on the bus."""
        port = Port(self, len(self._ports))
        self._ports.append(port)
        return port

    def reroute(self) -> None:
        """Rebuild the routes after a controller changed what it listens to."""
        routes: dict[int, list[tuple[Port, Handler]]] = {}
        for port in self._ports:
            for identifier, handler in port.handlers.items():
                routes.setdefault(identifier, []).append((port, handler))
        self._routes = routes

    def contend(self, identifier: int, number: int) -> None:
        """Enter a controller's first queued frame for the next arbitration."""
        heapq.heappush(self._contenders, (identifier, number))
        if self._sender is None:
            self._clock.call_at(self._clock.now_ns() + self._arbitrate(), self._arrived)

    def _arbitrate(self) -> int:
        """Send the contender with the lowest identifier; return the duration of its frame, ns."""
        _, number = heapq.heappop(self._contenders)
        self._sender = sender = self._ports[number]
        return self._times[len(sender.queue[0][1])]

    def _arrived(self) -> None:
        """Deliver the frame on the bus and the following ones, up to the next event of another
        kind.
        """
        clock, contenders = self._clock, self._contenders
        now = clock.now_ns()
        while (sender := self._sender) is not None:
            queue = sender.queue
            frame: tuple[int, bytes] | None = queue.popleft()
            if queue:
                heapq.heappush(contenders, (queue[0][0], sender.number))
            if self.frame_filters:
                frame = self._filtered(now, frame, sender is self._host)
            if frame is not None:
                identifier, data = frame
                for port, handler in self._routes.get(identifier, ()):
                    if port is not sender:
                        handler(data)
                if sender is not self._host and not self.down:
                    self._received.append(raw_frame((now, identifier, data, False)))
            # Receivers have queued their answers by now, so all take part in the next arbitration.
            if not contenders:
                self._sender = None
                return
            now += self._arbitrate()
            if not clock.skip_to(now):
                clock.call_at(now, self._arrived)
                return

    def _filtered(
        self, now: int, frame: tuple[int, bytes] | None, from_host: bool
    ) -> tuple[int, bytes] | None:
        for keep in self.frame_filters:
            if frame is None:
                return None
            frame = keep(now, *frame, from_host)
        return frame

    def disturb(self) -> None:
        """Let the host's controller see an error frame."""
        self._received.append(raw_frame((self._clock.now_ns(), ERROR_FLAG, b"", False)))

    def transmit(self, identifier: int, data: bytes) -> None:
        """Queue a frame of the host.

        Raises:
            OSError: The bus is down or shut.
        """
        if self.down or self._is_shutdown:
            raise OSError("bus-off" if self.down else "the bus is shut")
        self._host.send(identifier, data)

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return the received frames, advancing simulated time while there are none.

        Frames without a gap between them are returned together, as from a controller's buffer, each
        with its arrival time.

        Raises:
            OSError: The bus is shut.
        """
        deadline = self._clock.now_ns() + round(timeout_s * NS)
        if not self._wait(deadline):
            self._clock.sleep_until_ns(deadline)
            return ()
        frames, self._received = self._received, []
        return frames

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a frame of the host.

        Raises:
            can.CanOperationError: The bus is down or shut.
        """
        with _of_python_can():
            self.transmit(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame that passes python-can's filters.

        ``timeout`` is in seconds of simulated time; None waits as long as any event is scheduled.

        Raises:
            can.CanOperationError: The bus is shut.
        """
        with _of_python_can():
            return self._next(timeout)

    def _next(self, timeout: float | None) -> can.Message | None:
        deadline = _NEVER if timeout is None else self._clock.now_ns() + round(timeout * NS)
        while self._wait(deadline):
            time_ns, identifier, data, _ = self._received.pop(0)
            error = bool(identifier & ERROR_FLAG)
            message = can.Message(
                time_ns / NS, identifier & 0x7FF, False, is_error_frame=error, data=data
            )
            if self._filters is None or self._matches_filters(message):
                return message
        if timeout is not None:
            self._clock.sleep_until_ns(deadline)
        return None

    def _wait(self, deadline_ns: int) -> bool:
        """Advance simulated time until there is a frame for the host; False if none comes by the
        deadline.
        """
        if self._is_shutdown:
            raise OSError("the bus is shut")
        clock = self._clock
        while not self._received:
            due = clock.next_event_ns()
            if due is None or due > deadline_ns:
                return False
            clock.fire_next(deadline_ns)
        return True

    def _send_periodic_internal(self, *args: object, **kwargs: object) -> can.CyclicSendTaskABC:
        raise NotImplementedError("the simulated bus has no threads: send from the control loop")
