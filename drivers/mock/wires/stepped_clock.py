"""A simulated host clock that can jump, while bus and devices keep their time."""

from __future__ import annotations

from drivers.clock import NS, Clock


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
