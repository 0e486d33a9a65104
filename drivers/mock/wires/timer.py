"""A one-shot timer on the simulated clock that can be restarted and stopped."""

from __future__ import annotations

from collections.abc import Callable

from drivers.clock import SimulatedClock


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
