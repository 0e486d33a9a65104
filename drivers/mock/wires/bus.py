"""A CAN bus in simulated time, with frame times and arbitration; no threads and no wall clock."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import can

from drivers.can.port import ERROR_FLAG, REMOTE_FLAG, frame_bits, raw_frame
from drivers.clock import NS, Clock, SimulatedClock
from drivers.interfaces import RawFrame

Handler = Callable[[bytes], None]
FrameFilter = Callable[[int, int, bytes, bool], tuple[int, bytes] | None]
"""(time in ns, identifier, data, whether the host sent it) to the frame to deliver, or None."""


_NEVER = 1 << 62


@contextmanager
def _of_python_can() -> Iterator[None]:
    """Convert the errors of the bus into those of python-can."""
    try:
        yield
    except OSError as error:
        raise can.CanOperationError(str(error)) from error


def _rank(identifier: int) -> int:
    """Return the identifier by which a frame takes part in the arbitration."""
    return identifier & ~REMOTE_FLAG


class Port:
    """One controller: sends its frames in order, and receives those with a handler."""

    def __init__(self, bus: SimulatedBus, number: int) -> None:
        self._bus = bus
        self.number = number
        self.queue: deque[tuple[int, bytes]] = deque()
        self.handlers: dict[int, Handler] = {}

    def send(self, identifier: int, data: bytes) -> None:
        """Queue a frame; the frame is sent when it wins the arbitration."""
        self.queue.append((identifier, data))
        if len(self.queue) == 1:
            self._bus.contend(_rank(identifier), self.number)

    def listen(self, identifier: int, handler: Handler) -> None:
        """Pass every frame with this identifier from any other controller to ``handler``."""
        self.handlers[identifier] = handler
        self._bus.reroute()

    def ignore(self, identifier: int) -> None:
        """Remove the handler of an identifier; it is no error if there is no handler."""
        self.handlers.pop(identifier, None)
        self._bus.reroute()


class SimulatedBus(can.BusABC):
    """The simulated bus with the interface of the host's controller: a
    :class:`~drivers.can.port.FramePort`.

    The class is also an interface of python-can, for the tools of that library. Every frame takes
    its worst-case time at ``bitrate``. When the bus becomes idle, the waiting frame with the lowest
    identifier is sent first; each controller sends its frames in order. :meth:`collect` advances
    the clock.
    """

    def __init__(self, clock: SimulatedClock, bitrate: int = 1_000_000) -> None:
        super().__init__(channel=0)
        self.channel_info = f"simulated bus at {bitrate} bit/s"
        self.bitrate = bitrate
        # Hooks for fault injection, applied in order to every frame on the wire.
        self.frame_filters: list[FrameFilter] = []
        # Whether the host's controller is bus-off; sending then fails, and nothing is received.
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
        """Connect another controller to the bus."""
        port = Port(self, len(self._ports))
        self._ports.append(port)
        return port

    def reroute(self) -> None:
        """Compute the routes anew after a controller changed its handlers."""
        routes: dict[int, list[tuple[Port, Handler]]] = {}
        for port in self._ports:
            for identifier, handler in port.handlers.items():
                routes.setdefault(identifier, []).append((port, handler))
        self._routes = routes

    def contend(self, identifier: int, number: int) -> None:
        """Enter the first queued frame of a controller into the next arbitration."""
        heapq.heappush(self._contenders, (identifier, number))
        if self._sender is None:
            self._clock.call_at(self._clock.now_ns() + self._arbitrate(), self._arrived)

    def _arbitrate(self) -> int:
        """Send the waiting frame with the lowest identifier; return its duration, ns."""
        _, number = heapq.heappop(self._contenders)
        self._sender = sender = self._ports[number]
        identifier, data = sender.queue[0]
        return self._times[0 if identifier & REMOTE_FLAG else len(data)]

    def _arrived(self) -> None:
        """Deliver the frame on the wire and the next ones, until another event is due."""
        clock, contenders = self._clock, self._contenders
        now = clock.now_ns()
        while (sender := self._sender) is not None:
            queue = sender.queue
            frame: tuple[int, bytes] | None = queue.popleft()
            if queue:
                heapq.heappush(contenders, (_rank(queue[0][0]), sender.number))
            if self.frame_filters:
                frame = self._filtered(now, frame, sender is self._host)
            if frame is not None:
                identifier, data = frame
                for port, handler in self._routes.get(identifier, ()):
                    if port is not sender:
                        handler(data)
                if sender is not self._host and not self.down:
                    self._received.append(raw_frame((now, identifier, data, False)))
            # At this point the receivers have queued their answers, so that all answers take part
            # in the next arbitration.
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
        """Deliver an error frame to the host's controller."""
        self._received.append(raw_frame((self._clock.now_ns(), ERROR_FLAG, b"", False)))

    def transmit(self, identifier: int, data: bytes) -> None:
        """Queue a frame of the host."""
        if self.down or self._is_shutdown:
            raise OSError("bus-off" if self.down else "the bus is shut")
        self._host.send(identifier, data)

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        """Return the received frames; if there is none, simulated time advances until a frame
        arrives.

        Frames without a gap between them are returned together, as from the buffer of a controller,
        each with its arrival time.
        """
        deadline = self._clock.now_ns() + round(timeout_s * NS)
        if not self._wait(deadline):
            self._clock.sleep_until_ns(deadline)
            return ()
        frames, self._received = self._received, []
        return frames

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a frame of the host."""
        with _of_python_can():
            if msg.is_remote_frame:
                self.transmit(msg.arbitration_id | REMOTE_FLAG, bytes(msg.dlc))
            else:
                self.transmit(msg.arbitration_id, bytes(msg.data))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame that passes python-can's filters.

        ``timeout`` is in seconds of simulated time; with None the method waits as long as any event
        is scheduled.
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
        """Advance time until there is a frame; return False if none comes before the deadline."""
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
        raise NotImplementedError(
            "the simulated bus has no threads for periodic frames: send them from the control loop"
        )


class Timer:
    """Runs ``action`` once, at the time of the last :meth:`start`."""

    def __init__(self, clock: SimulatedClock, action: Callable[[], None]) -> None:
        self._clock = clock
        self._action = action
        self._generation = 0

    def start(self, when_ns: int) -> None:
        """Run the action at ``when_ns``; an earlier call of this method has no effect any more."""
        self._generation += 1
        generation = self._generation

        def fire() -> None:
            if generation == self._generation:
                self._action()

        self._clock.call_at(when_ns, fire)

    def stop(self) -> None:
        """Cancel the timer."""
        self._generation += 1


class SteppedClock:
    """The clock of a host whose time can jump; bus and devices keep the time of ``base``.

    A monotonic clock does not jump by itself, but a suspended virtual machine or a defective driver
    can cause a jump.
    """

    def __init__(self, base: Clock) -> None:
        self._base = base
        self._ahead_ns = 0

    def step(self, by_s: float) -> None:
        """Let the host's time jump forward by ``by_s`` s, or back if ``by_s`` is negative."""
        self._ahead_ns += round(by_s * NS)

    def now_ns(self) -> int:
        """Return the host's time in nanoseconds."""
        return self._base.now_ns() + self._ahead_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Wait for the time that, at the call of this method, remains to the deadline."""
        self._base.sleep_until_ns(deadline_ns - self._ahead_ns)
