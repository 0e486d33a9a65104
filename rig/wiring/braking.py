"""Brakes a drive with its own ramp, and waits until the drive has stopped.

The control cycle continues while the drive brakes: each cycle repeats the order, ends the last
command of speed or torque, and prevents that the drive's watchdog interrupts the ramp. Requests
outside the exchange stop the cycle until they are answered; they are made only where the cycles do
not show what the drive does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from drivers.clock import NS, Clock
from drivers.errors import DeviceError, LinkError
from drivers.interfaces import Servo, ServoState
from rig.wiring.steps import Steps

BRAKING_TIMEOUT_S: Final = 1.0
STATE_INTERVAL_S: Final = 0.005
"""Time, s, between two reads of the state of a drive that is not prepared, or that sends a state
other than braking. After standstill the power stays on for at most this time, independent of the
control cycle.
"""
UNHEARD_S: Final = 0.02
"""Time, s, for which only cycles order the quick stop while the drive sends no state. A shorter
outage of the bus ends within this time.
"""
REACTION_S: Final = 0.3
"""Time, s, after which the braking ends if the drive still operates; its watchdog has then had time
to act.
"""
_BRAKING: Final = frozenset({ServoState.QUICK_STOP_ACTIVE, ServoState.FAULT_REACTION})


def brake(
    servo: Servo,
    watch: Callable[[], ServoState | None],
    clock: Clock,
    cycle_ns: int,
    hurry: Callable[[], bool],
    steps: Steps,
    watched: bool,
) -> ServoState | None:
    """Order the quick stop, and run control cycles until the drive has stopped, the time is over,
    or the operator presses Ctrl-C again. The function raises no error: a defect of ``hurry`` does
    not end the ramp, a defect of the clock ends the wait.

    A cycle that fails, for example because another device is lost, does not end the ramp; after the
    first failed cycle the order is given again, because it may not have reached the drive. If the
    drive sends no state, a request orders the quick stop too. The cycles pause if this request gets
    no answer and the drive has not shown that it brakes, or if the drive goes on operating: the
    drive does not follow orders, and its watchdog brakes it. The cycles of a drive without a
    watchdog continue.

    If the drive sends a state other than braking, a request confirms the state, because a late
    frame contains an old one. If the answer to the request is lost, only a de-energised state is
    taken from the frame, because no frame from before the stop contains such a state.

    Args:
        servo: The drive.
        watch: Runs one control cycle; returns the state that the drive sent in it, or None.
        clock: Clock of the link.
        cycle_ns: Control cycle, ns.
        hurry: Whether to stop waiting.
        steps: Stores the errors; of the errors of cycles, only the first.
        watched: Whether the drive takes the power off by itself when the cycles end.

    Returns:
        The state in which the drive ended; an energised state other than QUICK STOP ACTIVE if the
        drive does not execute the quick stop; QUICK STOP ACTIVE if the drive has shown that it
        brakes, but not that the ramp ended; None if nothing is known of the drive since the order.
    """
    cycles, found = Steps(), list[ServoState | None]()
    braking = _Braking(servo, watch, clock, cycle_ns, steps, cycles, watched)
    steps.attempt(lambda: found.append(braking.run(hurry)))
    steps.take_first(cycles)
    return next(iter(found), None)


class _Braking:
    """Course of one quick stop, with the arguments of :func:`brake`."""

    def __init__(
        self,
        servo: Servo,
        watch: Callable[[], ServoState | None],
        clock: Clock,
        cycle_ns: int,
        steps: Steps,
        cycles: Steps,
        watched: bool,
    ) -> None:
        self._servo, self._watch, self._clock = servo, watch, clock
        self._cycle_ns = cycle_ns
        self._steps, self._cycles = steps, cycles
        self._watched = watched
        self._cyclic = self._obeyed = self._silent = self._repeated = False
        self._refusing_ns: int | None = None
        self._shown: ServoState | None = None

    def run(self, hurry: Callable[[], bool]) -> ServoState | None:
        """Brake, and return what :func:`brake` returns."""
        clock, interval_ns = self._clock, round(STATE_INTERVAL_S * NS) - self._cycle_ns // 2
        began_ns: list[int] = []
        self._steps.attempt(lambda: began_ns.append(clock.now_ns()))
        self._cyclic = cyclic = self._servo.prepared
        error = self._order(at_once=not cyclic)
        if not began_ns:
            return None
        self._note_order(error, began_ns[0])
        deadline_ns = began_ns[0] + round(BRAKING_TIMEOUT_S * NS)
        # A drive that is not prepared has its state read in the first cycle.
        known_ns = clock.now_ns() - (0 if cyclic else interval_ns)
        self._obeyed = not cyclic
        for _ in range(max(1, round(BRAKING_TIMEOUT_S * NS / self._cycle_ns))):
            if self._hurried(hurry) or clock.now_ns() >= deadline_ns:
                break
            sent = self._cycle()
            if self._steps.interrupted or self._cycles.interrupted:
                break
            if sent in _BRAKING:
                known_ns, self._refusing_ns = clock.now_ns(), None
                self._obeyed, self._shown = True, sent
                continue
            off = sent is not None and not sent.energised
            patience_ns = round(UNHEARD_S * NS) if sent is None and cyclic else interval_ns
            if not off and clock.now_ns() - known_ns < patience_ns:
                continue
            # An order may restart the watchdog of a drive with frames of its own.
            state = self._ask(again=not (self._obeyed or off or self._silent))
            known_ns = clock.now_ns()
            if state is None:
                if off or not cyclic:
                    return sent
                if self._obeyed:
                    continue
                if sent is None:
                    self._silent = self._watched
                    continue
                state = sent  # it may be an old one, but none later is known
            if not state.energised or self._refuses(state):
                return state
            self._obeyed, self._shown = state in _BRAKING, state
        return ServoState.QUICK_STOP_ACTIVE if self._shown in _BRAKING else self._shown

    def _order(self, at_once: bool) -> BaseException | None:
        """Order the quick stop, once more if the order was interrupted; return the error, if any.

        After a LinkError the cycles, or the next request, repeat the order.
        """
        order = self._servo.quick_stop
        error = self._steps.attempt(lambda: order(at_once=at_once))
        if error is not None and not isinstance(error, LinkError):
            error = self._steps.attempt(order)
        return error

    def _note_order(self, error: BaseException | None, since_ns: int) -> None:
        """End the cycles to a drive with a watchdog if it did not answer an order that was given by
        a request at ``since_ns``.
        """
        waited_s = (self._clock.now_ns() - since_ns) / NS
        if self._cyclic and isinstance(error, LinkError) and waited_s >= UNHEARD_S:
            self._silent = self._watched

    def _hurried(self, hurry: Callable[[], bool]) -> bool:
        """Return whether to stop waiting; a defect of ``hurry`` does not end the ramp."""
        found: list[bool] = []
        self._cycles.attempt(lambda: found.append(hurry()))
        return any(found)

    def _cycle(self) -> ServoState | None:
        """Run one cycle, or let the time of one pass while the cycles pause; return the state that
        the drive sent.
        """
        end_ns = self._clock.now_ns() + self._cycle_ns
        if self._silent:
            self._clock.sleep_until_ns(end_ns)
            return None
        found: list[ServoState | None] = []
        error = self._cycles.attempt(lambda: found.append(self._watch()))
        if isinstance(error, DeviceError):
            # The other devices may have exchanged their values all the same.
            self._cycles.attempt(lambda: found.append(self._servo.sent_state()))
        sent = next(iter(found), None)
        if error is None:
            return sent
        unsure = isinstance(error, LinkError) and sent not in _BRAKING
        if unsure and not (self._obeyed or self._repeated):
            # The exchange may not have brought the order to the drive.
            self._repeated, since_ns = True, self._clock.now_ns()
            self._note_order(self._order(at_once=False), since_ns)
        self._clock.sleep_until_ns(end_ns)
        return sent

    def _ask(self, again: bool) -> ServoState | None:
        """Read the state, after the order was given once more if ``again``; return None if the
        drive does not answer.
        """
        if again and isinstance(self._steps.attempt(self._servo.quick_stop), LinkError):
            return None
        return self._steps.state(self._servo)

    def _refuses(self, state: ServoState) -> bool:
        """Decide, from a state that was read, whether the cycles continue; return whether the drive
        has not begun to brake within :data:`REACTION_S`.
        """
        if state in _BRAKING:
            self._silent, self._refusing_ns = False, None
            return False
        now_ns = self._clock.now_ns()
        if self._refusing_ns is None:
            self._refusing_ns = now_ns
        refused_s = (now_ns - self._refusing_ns) / NS
        self._silent = self._watched and refused_s >= UNHEARD_S
        return refused_s >= REACTION_S
