"""Making the drive safe, whatever happened before, and saying honestly whether that was verified."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from drivers.errors import DeviceError
from drivers.interfaces import Servo, ServoLimits, ServoState

BRAKING_TIMEOUT_S = 1.0
STATE_CYCLES = 20


@dataclass(frozen=True)
class SafeState:
    """How the drive was left.

    Attributes:
        verified: Whether 6041h was read and shows a de-energised state.
        state: That state in words, or ``unknown``.
        problems: What went wrong on the way.
        watched: Whether the drive takes its power off by itself once nobody commands it.
    """

    verified: bool
    state: str
    problems: tuple[str, ...] = ()
    watched: bool = True

    @property
    def message(self) -> str:
        """One sentence for the operator."""
        if self.verified:
            return f"the drive is de-energised (read back: {self.state})"
        by_itself = (
            "its own heartbeat watch takes the power off; switch the main supply off before approaching the bench"
            if self.watched
            else "it has no watch of its own and may go on HOLDING UNDER POWER: switch the main supply off now"
        )
        return (
            "it could NOT be verified that the drive is de-energised "
            f"(state {self.state}; {'; '.join(self.problems)}); {by_itself}"
        )


def make_safe(
    servo: Servo,
    watch: Callable[[], None],
    cycle_ns: int,
    *,
    brake: bool,
    hurry: Callable[[], bool],
    watched: bool = True,
) -> SafeState:
    """Brake if asked to, take the power off and read the state back. Never raises a device error.

    Every step has a time-out of its own; none is skipped because one before it failed.

    Args:
        servo: The drive.
        watch: Runs one control cycle; called while the drive brakes, so that its heartbeat watch does not cut the ramp
            short, and so that the recording shows the shaft stopping.
        cycle_ns: Control cycle, ns.
        brake: Start with a quick stop: after anything but an orderly end.
        hurry: Whether the operator asks again: then the power goes off without waiting for the end of the ramp.
        watched: Whether the drive takes its power off by itself once nobody commands it.
    """
    problems: list[str] = []
    if brake:
        _attempt(servo.quick_stop, problems)
        _attempt(lambda: _wait_for_standstill(servo, watch, cycle_ns, hurry), problems)
    if brake or _state(servo, []) is not ServoState.SWITCH_ON_DISABLED:
        _attempt(servo.disable, problems)
    state = _state(servo, problems)
    if state is None:
        return SafeState(False, "unknown", tuple(problems), watched)
    return SafeState(not state.energised, state.value, tuple(problems), watched)


def _wait_for_standstill(servo: Servo, watch: Callable[[], None], cycle_ns: int, hurry: Callable[[], bool]) -> None:
    """Keep the bus alive until the drive has braked, or for the time-out, or until the operator cannot wait."""
    for cycle in range(round(BRAKING_TIMEOUT_S * 1e9 / cycle_ns)):
        if hurry():
            return
        if cycle % STATE_CYCLES == 0 and servo.state() is not ServoState.QUICK_STOP_ACTIVE:
            return
        watch()


def give_back(servo: Servo, own: ServoLimits, safe: SafeState) -> None:
    """Write the drive's own limits back, so that the tighter ones of a run do not stand in the way of the next.

    Only into a drive that is verified off. A drive that does not take them keeps the tighter ones, which is safe.
    """
    if safe.verified:
        with suppress(DeviceError, KeyboardInterrupt):
            servo.write_limits(own)


def _attempt(action: Callable[[], None], problems: list[str]) -> None:
    """Do one step of the teardown; whatever it meets, the next step must still be tried."""
    try:
        action()
    except DeviceError as error:
        problems.append(str(error))
    except KeyboardInterrupt:
        problems.append("interrupted again while stopping")


def _state(servo: Servo, problems: list[str]) -> ServoState | None:
    try:
        return servo.state()
    except DeviceError as error:
        problems.append(str(error))
    except KeyboardInterrupt:
        problems.append("interrupted while reading the state")
    return None
