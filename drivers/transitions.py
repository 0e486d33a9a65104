"""The part of a servo that is the same for every drive with the states of CiA 402."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Final

from drivers.clock import NS
from drivers.errors import DeviceError, StateError
from drivers.interfaces import Link, Servo, ServoState

FAULTS: Final = (ServoState.FAULT, ServoState.FAULT_REACTION)


class SteppedServo(Servo):
    """A servo whose drive is energised state by state. Only :meth:`enable` leads toward power."""

    def __init__(self, link: Link, state_timeout_s: float) -> None:
        self._link = link
        self._clock = link.clock
        self._timeout_s = state_timeout_s
        self._cycle_ns = 0

    def enable(self) -> None:
        """Energise the drive; if this fails, it is left without power."""
        if not self._cycle_ns:
            raise StateError("the drive is not prepared: call prepare() first")
        state = self.state()
        if state in FAULTS:
            raise self.fault()
        self._require_way(state)
        try:
            self._energise()
        except DeviceError:
            with suppress(DeviceError):
                self.disable()
            raise

    @abstractmethod
    def _require_way(self, state: ServoState) -> None:
        """Raise StateError if no order leads from a state toward power, before anything is sent."""

    @abstractmethod
    def _energise(self) -> None:
        """Order the drive from state to state until it operates, at its present position."""

    def _require_off(self) -> None:
        """Raise StateError if the drive is energised."""
        state = self.state()
        if state.energised:
            raise StateError(
                f"the drive is in state '{state.value}': disable it before it is prepared"
            )

    def _exchanges(self) -> Iterator[bool]:
        """Exchange process data once per cycle; yield after each exchange whether time remains."""
        due = self._clock.now_ns()
        deadline = due + self._timeout_s * NS
        while True:
            due += self._cycle_ns
            self._clock.sleep_until_ns(due)
            self._link.exchange()
            yield self._clock.now_ns() < deadline

    def _not_up(self, state: ServoState | None) -> StateError:
        shown = "unknown" if state is None else state.value
        return StateError(
            f"the drive is still in state '{shown}', {self._timeout_s:g} s after the command to "
            "enable: check its supply and its enable input"
        )

    def _await(
        self,
        read: Callable[[], ServoState],
        reached: Callable[[ServoState], bool],
        wanted: str,
        again: Callable[[], object] = lambda: None,
    ) -> None:
        """Read the state until it is the expected one; call ``again`` after each other state."""
        deadline = self._clock.now_ns() + self._timeout_s * NS
        while not reached(state := read()):
            if self._clock.now_ns() >= deadline:
                raise StateError(
                    f"{self._timeout_s:g} s after the command the drive reports the state "
                    f"'{state.value}', but {wanted} is expected: switch the supply of the drive "
                    "off by hand"
                )
            again()
