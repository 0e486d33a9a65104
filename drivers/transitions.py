"""Waits until a drive reaches a commanded state, for all servos with states of CiA 402."""

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
    """Read the state of a drive until the expected state is reached.

    Args:
        read: Function that reads the state from the device.
        reached: Function that returns whether a state is the expected one.
        wanted: Name of the expected state.
        clock: Measures the time.
        timeout_s: Time-out, s.
        again: Function that is called after each read of another state, for example to repeat the
            command.

    Raises:
        StateError: The state was not reached in time.
    """
    deadline = clock.now_ns() + timeout_s * NS
    while not reached(state := read()):
        if clock.now_ns() >= deadline:
            raise StateError(
                f"{timeout_s:g} s after the command the drive reports the state '{state.value}', "
                f"but {wanted} is expected: switch the supply of the drive off by hand"
            )
        again()


def exchanges(link: Link, cycle_ns: int, timeout_s: float) -> Iterator[bool]:
    """Exchange process data once per cycle; yield after each exchange whether time remains."""
    clock = link.clock
    due = clock.now_ns()
    deadline = due + timeout_s * NS
    while True:
        due += cycle_ns
        clock.sleep_until_ns(due)
        link.exchange()
        yield clock.now_ns() < deadline
