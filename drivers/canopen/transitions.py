"""Waits for a drive to change its state, for all servos with CiA 402 states."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from drivers.clock import NS, Clock
from drivers.errors import StateError
from drivers.interfaces import Link, ServoState


def await_state(
    read: Callable[[], ServoState],
    reached: Callable[[ServoState], bool],
    wanted: str,
    clock: Clock,
    timeout_s: float,
    again: Callable[[], object] = lambda: None,
) -> None:
    """Read the state until it is reached.

    Args:
        read: Reads the state from the device.
        reached: Returns whether a state is the expected one.
        wanted: Name of the expected state.
        clock: Measures the time.
        timeout_s: Time-out, s.
        again: Called each time the state is not reached yet; may repeat the command.

    Raises:
        StateError: It was not reached in time.
    """
    deadline = clock.now_ns() + timeout_s * NS
    while not reached(state := read()):
        if clock.now_ns() >= deadline:
            raise StateError(
                f"the drive reports '{state.value}' {timeout_s:g} s after the command, "
                f"wanted {wanted}: "
                "take its power away by hand"
            )
        again()


def exchanges(link: Link, cycle_ns: int, timeout_s: float) -> Iterator[bool]:
    """Exchange process data at the cycle rate; yield after each exchange whether time is left."""
    clock = link.clock
    due = clock.now_ns()
    deadline = due + timeout_s * NS
    while True:
        due += cycle_ns
        clock.sleep_until_ns(due)
        link.exchange()
        yield clock.now_ns() < deadline
