"""Clock interface. No other module of this package reads a clock or sleeps.

Two implementations: :class:`RealClock` for hardware, and :class:`SimulatedClock` for the simulated
bus, whose time advances only while the program waits.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from typing import Protocol

NS = 1_000_000_000
SHORTEST_SLEEP_NS = NS // 10
"""Shortest time that counts as a sleep of the computer, ns; a real sleep lasts seconds."""


class Clock(Protocol):
    """Monotonic time in integer nanoseconds from an arbitrary origin."""

    def now_ns(self) -> int:
        """Return the time in nanoseconds."""
        ...

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Wait until ``now_ns() >= deadline_ns``; return immediately if the deadline has passed."""
        ...


class RealClock:
    """The machine's monotonic clock."""

    def now_ns(self) -> int:
        """Return the monotonic time in nanoseconds."""
        return time.monotonic_ns()

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep to an absolute deadline."""
        left = deadline_ns - time.monotonic_ns()
        if left > 0:
            time.sleep(left / NS)


def _boot_ns() -> int:
    """Return the time since boot with sleep, ns; monotonic time on a system without this clock."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic_ns() if clock is None else time.clock_gettime_ns(clock)


class Suspension:
    """Detects that the computer slept, which no lateness shows: the monotonic clock stood still."""

    def __init__(
        self, boot_ns: Callable[[], int] = _boot_ns, awake_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self._boot_ns, self._awake_ns = boot_ns, awake_ns
        self._most_ns = self._asleep_ns()

    def passed_ns(self) -> int:
        """Return the sleep since the last call, ns; 0 below :data:`SHORTEST_SLEEP_NS`."""
        slept_ns = self._asleep_ns() - self._most_ns
        if slept_ns <= 0:
            return 0
        self._most_ns += slept_ns
        return slept_ns if slept_ns >= SHORTEST_SLEEP_NS else 0

    def _asleep_ns(self) -> int:
        # This order, because a pause between the two reads then makes the difference smaller; the
        # greatest difference so far is the time slept.
        boot_ns = self._boot_ns()
        return boot_ns - self._awake_ns()


class SimulatedClock:
    """Simulated time, which advances only while the program sleeps or waits; each event is executed
    at its time.

    The order is deterministic: events at one instant are executed in the order in which they were
    scheduled.
    """

    def __init__(self, start_ns: int = 0) -> None:
        self._now = start_ns
        self._horizon = start_ns
        self._order = 0
        self._events: list[tuple[int, int, Callable[[], None]]] = []

    def now_ns(self) -> int:
        """Return the simulated time in nanoseconds."""
        return self._now

    def call_at(self, when_ns: int, action: Callable[[], None]) -> None:
        """Run ``action`` when the simulated time reaches ``when_ns``, at the earliest now."""
        self._order += 1
        heapq.heappush(
            self._events, (when_ns if when_ns > self._now else self._now, self._order, action)
        )

    def next_event_ns(self) -> int | None:
        """Return the time of the next scheduled event, or None without an event."""
        return self._events[0][0] if self._events else None

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Advance simulated time to ``deadline_ns``, and execute every event up to this time."""
        events = self._events
        while events and events[0][0] <= deadline_ns:
            self.fire_next(deadline_ns)
        if deadline_ns > self._now:
            self._now = deadline_ns

    def fire_next(self, horizon_ns: int) -> None:
        """Execute the next event, which may advance the time up to ``horizon_ns``."""
        self._now, _, action = heapq.heappop(self._events)
        self._horizon = horizon_ns
        action()

    def skip_to(self, when_ns: int) -> bool:
        """Advance the time from within an event, in place of scheduling another event.

        Returns:
            False, without advancing, if another event is scheduled up to ``when_ns``, or if no
            caller waits until ``when_ns``.
        """
        if when_ns > self._horizon or (self._events and self._events[0][0] <= when_ns):
            return False
        self._now = when_ns
        return True
