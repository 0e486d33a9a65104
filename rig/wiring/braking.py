"""Brakes a drive with its own ramp, and waits until the drive has stopped.

The control cycle continues while the drive brakes: each cycle repeats the order, ends the last
command of speed or torque, and prevents that the drive's watchdog interrupts the ramp. Requests
outside the exchange stop the cycle until they are answered; they are made only where the cycles do
not show what the drive does.

The course of a braking is the table :data:`TRANSITIONS`. A joint that becomes faster while it
should brake runs away: its power is cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Final

from drivers.clock import NS, Clock
from drivers.errors import DeviceError, LinkError
from drivers.interfaces import Servo, ServoState
from rig.wiring.off import Steps
from rig.wiring.runaway import SIGNS, Runaway, RunawayError, Seen

BRAKING_TIMEOUT_S: Final = 1.0
STATE_INTERVAL_S: Final = 0.005
"""Time, s, between two reads of the state of a drive that is not prepared, or that sends a state
other than braking. After standstill the power stays on for at most this time, independent of the
control cycle.
"""
UNHEARD_S: Final = 0.02
"""Time for which only cycles order the quick stop of a silent drive, s; short outages end in it."""
REACTION_S: Final = 0.3
"""Time after which the braking of a drive that still operates ends, s; its watchdog has acted."""
_BRAKING: Final = frozenset({ServoState.QUICK_STOP_ACTIVE, ServoState.FAULT_REACTION})


class State(Enum):
    """What the host knows of a drive that was ordered to brake."""

    ORDERED = "the cycles carry the order"
    REPEATED = "the cycles carry the order, which was given again after a cycle failed"
    REQUESTED = "a request carried the order, and requests read the state"
    BRAKING = "the drive has shown that it brakes"
    REFUSING = "the drive operates against the order, which each request repeats"
    SILENT = "the host sends no cycles, so that the watchdog of the drive acts"
    OFF = "the drive is off"
    GIVEN_UP = "the host waits no longer"
    RUNAWAY = "the joint runs away"


class Event(Enum):
    """What a cycle, a request or the time shows."""

    BRAKES = "the drive brakes"
    OPERATES = "the drive answers that it operates"
    STOPPED = "the drive is off"
    CYCLE_FAILED = "a cycle failed and may not have carried the order"
    UNANSWERED = "the drive sends nothing and answers no request"
    IGNORED = "a drive with a watchdog does not follow the order"
    TIME_OVER = "no further cycle may show more"
    GROWS = "the speed grows"


def _rows(state: State, **others: State) -> Mapping[tuple[State, Event], State]:
    """Return the row of a state: ``others``, the common ends, no change for other events."""
    row = dict.fromkeys(Event, state) | {
        Event.BRAKES: State.BRAKING,
        Event.STOPPED: State.OFF,
        Event.TIME_OVER: State.GIVEN_UP,
        Event.GROWS: State.RUNAWAY,
    }
    row |= {Event[name]: following for name, following in others.items()}
    return {(state, event): following for event, following in row.items()}


TRANSITIONS: Final[Mapping[tuple[State, Event], State]] = {
    **_rows(
        State.ORDERED, CYCLE_FAILED=State.REPEATED, OPERATES=State.REFUSING, IGNORED=State.SILENT
    ),
    **_rows(State.REPEATED, OPERATES=State.REFUSING, IGNORED=State.SILENT),
    **_rows(State.REQUESTED, OPERATES=State.REFUSING),
    **_rows(State.BRAKING, OPERATES=State.REFUSING),
    **_rows(State.REFUSING, IGNORED=State.SILENT),
    **_rows(State.SILENT, OPERATES=State.REFUSING),
}
"""The next state by state and event; the states that end the braking have no row."""
_ENDED: Final = frozenset({State.OFF, State.GIVEN_UP, State.RUNAWAY})
INSISTS: Final = frozenset({State.ORDERED, State.REPEATED, State.REFUSING})
"""States in which a request gives the order again before it reads the state. In the state SILENT
an order may restart the watchdog of a drive with frames of its own.
"""


WATCHDOGS: Final = 2.0
"""How long a drive is not asked, as a multiple of its watchdog time, if asking sends a command and
so restarts the watchdog.
"""


def next_state(state: State, event: Event) -> State:
    """Return the next state by the transition table; a ValueError names an illegal move."""
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        raise ValueError(f"no transition from {state.name} on {event.name}") from None


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

    If ``watch`` raises a RunawayError, or the speeds that requests read from a drive that is not
    prepared grow, the power is switched off at once.

    Args:
        servo: The drive.
        watch: Runs one control cycle; returns the state that the drive sent in it, or None; raises
            RunawayError if the joint has become faster.
        clock: Clock of the link.
        cycle_ns: Control cycle, ns.
        hurry: Whether to stop waiting.
        steps: Stores the errors, of the errors of cycles only the first, and the reason of a cut.
        watched: Whether the drive takes the power off by itself when the cycles end.

    Returns:
        The state in which the drive ended; an energised state other than QUICK STOP ACTIVE if the
        drive does not execute the quick stop; QUICK STOP ACTIVE if the drive has shown that it
        brakes, but not that the ramp ended; None if nothing is known of the drive since the order.
    """
    cycles = Steps()
    braking = _Braking(servo, watch, clock, cycle_ns, steps, cycles, watched)
    state, _ = steps.result(lambda: braking.run(hurry))
    steps.take_first(cycles)
    return state


SOFT: Final = (
    "look for gains of the drive that are too low, and for a load that it cannot hold; if there "
    "are none, "
)
"""Remedy for a joint that became faster on its way to its target."""


def grown(runaway: Runaway) -> str:
    """Return a sentence on a joint that became faster after the order to brake."""
    now, most = math.degrees(runaway.speed_rad_s), math.degrees(runaway.limit_rad_s)
    return (
        f"after the order to brake the joint speed grew to {now:.3g} deg/s, limit {most:.3g} "
        f"deg/s, so the power was cut instead of a ramp: {'' if runaway.leaving else SOFT}{SIGNS}"
    )


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
        self._prepared = servo.prepared
        self._state = State.ORDERED if self._prepared else State.REQUESTED
        self._refusing_ns: int | None = None
        self._shown: ServoState | None = None
        self._runaway: Runaway | None = None

    def run(self, hurry: Callable[[], bool]) -> ServoState | None:
        """Brake, and return what :func:`brake` returns."""
        clock, interval_ns = self._clock, round(STATE_INTERVAL_S * NS) - self._cycle_ns // 2
        began_ns, _ = self._steps.result(clock.now_ns)
        error = self._order(at_once=not self._prepared)
        if began_ns is None:
            return None
        self._note_order(error, began_ns)
        deadline_ns = began_ns + round(BRAKING_TIMEOUT_S * NS)
        # A drive that is not prepared has its state read in the first cycle.
        known_ns = clock.now_ns() - (0 if self._prepared else interval_ns)
        for _ in range(max(1, round(BRAKING_TIMEOUT_S * NS / self._cycle_ns))):
            if self._cycles.result(hurry)[0] or clock.now_ns() >= deadline_ns:
                break
            sent = self._cycle()
            if self._state in _ENDED or self._steps.interrupted or self._cycles.interrupted:
                break
            if sent in _BRAKING:
                known_ns = clock.now_ns()
                self._note_state(sent)
            else:
                off = sent is not None and not sent.energised
                cyclic = sent is None and self._prepared
                patience_ns = round(UNHEARD_S * NS) if cyclic else interval_ns
                if self._state is State.SILENT and self._servo.asked:
                    patience_ns = round(WATCHDOGS * (self._servo.watch_s or UNHEARD_S) * NS)
                if off or clock.now_ns() - known_ns >= patience_ns:
                    self._ask(sent, off)
                    known_ns = clock.now_ns()
            if self._state in _ENDED:
                break
        if self._state not in _ENDED:
            self._move(Event.TIME_OVER)
        return self._end()

    def _move(self, event: Event) -> None:
        self._state = next_state(self._state, event)

    def _end(self) -> ServoState | None:
        """Cut the power of a joint that runs away; return the last state that is known."""
        if self._state is State.RUNAWAY:
            self._steps.attempt(self._servo.disable)
            return self._steps.state(self._servo)
        gone = self._state is State.GIVEN_UP and self._shown in _BRAKING
        return ServoState.QUICK_STOP_ACTIVE if gone else self._shown

    def _order(self, at_once: bool = True) -> BaseException | None:
        """Order the quick stop, again if it was interrupted; cycles repeat it after a LinkError."""
        order = self._servo.quick_stop
        error = self._steps.attempt(lambda: order(at_once=at_once))
        if error is not None and not isinstance(error, LinkError):
            error = self._steps.attempt(order)
        return error

    def _note_order(self, error: BaseException | None, since_ns: int) -> None:
        """End the cycles to a watched drive without an answer to an order at ``since_ns``."""
        waited_s = (self._clock.now_ns() - since_ns) / NS
        unheard = isinstance(error, LinkError) and waited_s >= UNHEARD_S
        if self._prepared and self._watched and unheard:
            self._move(Event.IGNORED)

    def _cycle(self) -> ServoState | None:
        """Run one cycle, or let its time pass; return the state that the drive sent."""
        end_ns = self._clock.now_ns() + self._cycle_ns
        if self._state is State.SILENT:
            self._clock.sleep_until_ns(end_ns)
            return None
        sent, error = self._cycles.result(self._watch)
        if isinstance(error, RunawayError):
            self._steps.cut = str(error)
            self._move(Event.GROWS)
            return None
        if isinstance(error, DeviceError):
            # The other devices may have exchanged their values all the same.
            sent, _ = self._cycles.result(self._servo.sent_state)
        if error is None:
            return sent
        if isinstance(error, LinkError) and sent not in _BRAKING:
            # The exchange may not have brought the order to the drive.
            before = self._state
            self._move(Event.CYCLE_FAILED)
            if self._state is not before:
                since_ns = self._clock.now_ns()
                self._note_order(self._order(at_once=False), since_ns)
        self._clock.sleep_until_ns(end_ns)
        return sent

    def _ask(self, sent: ServoState | None, off: bool) -> None:
        """Read the state, after the order was given once more where the state of the braking needs
        it; ``off`` is whether the last frame ``sent`` a de-energised state.
        """
        again = self._state in INSISTS and not off
        answer = None
        if not (again and isinstance(self._steps.attempt(self._servo.quick_stop), LinkError)):
            answer = self._steps.state(self._servo)
        if answer is None:
            if off or not self._prepared:
                self._shown = sent
                self._move(Event.STOPPED if off else Event.TIME_OVER)
                return
            if sent is None or self._state is State.BRAKING:
                self._move(Event.IGNORED if self._watched else Event.UNANSWERED)
                return
            answer = sent  # it may be an old one, but none later is known
        self._note_state(answer)
        if not self._prepared and answer.energised and self._grows():
            self._move(Event.GROWS)

    def _note_state(self, state: ServoState) -> None:
        """Move by a state that the drive has shown; end the cycles to a drive with a watchdog that
        operates for :data:`UNHEARD_S`, and the braking after :data:`REACTION_S`.
        """
        self._shown = state
        if not state.energised:
            self._move(Event.STOPPED)
            return
        if state in _BRAKING:
            self._refusing_ns = None
            self._move(Event.BRAKES)
            return
        now_ns = self._clock.now_ns()
        if self._refusing_ns is None:
            self._refusing_ns = now_ns
        refused_s = (now_ns - self._refusing_ns) / NS
        self._move(Event.OPERATES)
        if refused_s >= REACTION_S:
            self._move(Event.TIME_OVER)
        elif self._watched and refused_s >= UNHEARD_S:
            self._move(Event.IGNORED)

    def _grows(self) -> bool:
        """Read the motion of a drive that is not prepared; return whether its speed grows."""
        motion, error = self._cycles.result(self._servo.motion)
        if motion is None or isinstance(error, DeviceError):
            return False
        if self._runaway is None:
            promised, _ = self._cycles.result(self._servo.promised_deceleration)
            self._runaway = Runaway(math.nan if promised is None else promised)
        seen = Seen(self._clock.now_ns() / NS, motion.velocity_rad_s, motion.angle_rad)
        self._runaway.see(seen)
        if not self._runaway.grows():
            return False
        self._steps.cut = grown(self._runaway)
        return True
