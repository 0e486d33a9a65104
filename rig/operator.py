"""The person at the bench: prompts, and the stop and pause buttons that signals are."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from enum import Enum
from types import FrameType
from typing import Protocol, Self

import click

from drivers.clock import NS, Clock, RealClock

WEIGHT_TOLERANCE_KG = 0.001
PAUSE_SIGNAL = getattr(signal, "SIGUSR1", None)
"""Asks for a pause, and ends it; None on a system that has no such signal."""
_LOOK_NS = NS // 20
_PAUSE_ASKED = b"\npause asked for: at the end of this stage, where the drive is off; SIGUSR1 again takes it back\n"
_PAUSE_ENDED = b"\nno pause\n"
_ALARM = getattr(signal, "SIGALRM", None)


class OperatorStopError(Exception):
    """The operator asked to stop."""


def unanswered(patience_s: float) -> OperatorStopError:
    """Return the end of a run whose prompt nobody answered in time."""
    return OperatorStopError(
        f"nobody answered the prompt within {patience_s:g} s; `rig resume` goes on, or raise prompt_timeout_s"
    )


@contextmanager
def answered_within(patience_s: float | None) -> Iterator[None]:
    """Wait for an answer for so long at the most, s; None waits for ever.

    Outside the main thread, where signals cannot be caught, it waits for ever too.

    Raises:
        OperatorStopError: Nobody answered.
    """
    if patience_s is None or _ALARM is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    def ring(number: int, frame: FrameType | None) -> None:
        raise unanswered(patience_s)

    previous = signal.signal(_ALARM, ring)
    signal.setitimer(signal.ITIMER_REAL, patience_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(_ALARM, previous)


class Verb(Enum):
    """What the operator can ask for between stages, where the drive is de-energised."""

    GO_ON = "go on"
    REPEAT = "repeat"
    ABORT = "abort"


class StopButton:
    """Turns Ctrl-C and SIGTERM into a flag that the control loop looks at every cycle, and SIGUSR1 into a pause.

    A context manager; outside the main thread, where signals cannot be caught, only the methods set the flags.
    A software stop is a stop function, not an emergency stop.

    Attributes:
        pressed: Whether a stop was asked for.
        presses: How often.
        pausing: Whether a pause at the next stage boundary was asked for.
    """

    def __init__(self) -> None:
        self.pressed = False
        self.presses = 0
        self.pausing = False
        self._raise_at_once = False
        self._previous: dict[signal.Signals, signal._HANDLER] = {}

    def __enter__(self) -> Self:
        """Take over the signals."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._previous[number] = signal.signal(number, self._on_signal)
            if PAUSE_SIGNAL is not None:
                self._previous[PAUSE_SIGNAL] = signal.signal(PAUSE_SIGNAL, self._on_pause)
        return self

    def __exit__(self, *exception: object) -> None:
        """Give the signals back."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous.clear()

    def press(self) -> None:
        """Ask for a stop."""
        self.pressed = True
        self.presses += 1

    def pause(self) -> None:
        """Ask for a pause at the next stage boundary, or for the end of one."""
        self.pausing = not self.pausing

    def check(self) -> None:
        """Stop if it was asked for.

        Raises:
            OperatorStopError: The button was pressed.
        """
        if self.pressed:
            raise OperatorStopError("stopped by the operator")

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Let the signal raise at once: for waiting on the operator, while the drive is de-energised."""
        self._raise_at_once = True
        try:
            self.check()
            yield
        finally:
            self._raise_at_once = False

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.press()
        if self._raise_at_once:
            raise KeyboardInterrupt

    def _on_pause(self, number: int, frame: FrameType | None) -> None:
        self.pause()
        # Written at once and unbuffered: a handler may have come in the middle of another write.
        with suppress(OSError):
            os.write(2, _PAUSE_ASKED if self.pausing else _PAUSE_ENDED)


class Operator(Protocol):
    """Whoever hangs the weights."""

    def confirm_weight(self, stage: str, weight_kg: float) -> float | Verb:
        """Have a weight hung and its mass confirmed.

        Returns:
            The mass that was confirmed, kg, or :attr:`Verb.REPEAT` to do the stage before this one again.

        Raises:
            OperatorStopError: The operator gave up.
        """
        ...

    def hangs(self, stage: str, weight_kg: float) -> float:
        """Return the mass that ends up on a simulated lever, kg."""
        ...

    def paused(self, stage: str, stop: StopButton) -> Verb:
        """Wait at the boundary after ``stage`` until the operator says how to go on."""
        ...

    def tell(self, words: str) -> None:
        """Show the operator something that needs no answer."""
        ...


class AutomaticOperator:
    """Answers every prompt with what the plan says (``--yes``); a pause ends with the signal that asked for it.

    Args:
        hung: Stage to the mass that is hung there in truth, kg, where it is not the planned one: a mistake to be
            found, on a simulated lever.
        clock: To wait by while paused.
    """

    def __init__(self, hung: Mapping[str, float] | None = None, clock: Clock | None = None) -> None:
        self._hung = hung or {}
        self._clock = clock or RealClock()

    def confirm_weight(self, stage: str, weight_kg: float) -> float | Verb:
        """Confirm the planned weight."""
        return weight_kg

    def hangs(self, stage: str, weight_kg: float) -> float:
        """Return the planned mass, or the mistake."""
        return self._hung.get(stage, weight_kg)

    def paused(self, stage: str, stop: StopButton) -> Verb:
        """Wait for the next pause signal."""
        self.tell(f"paused after stage {stage}, the drive is off; send SIGUSR1 to go on, or press Ctrl-C to stop")
        while stop.pausing:
            self._clock.sleep_until_ns(self._clock.now_ns() + _LOOK_NS)
        return Verb.GO_ON

    def tell(self, words: str) -> None:
        """Print to stderr."""
        click.echo(words, err=True)


class ConsoleOperator(AutomaticOperator):
    """Asks at the terminal.

    Args:
        patience_s: How long an answer is waited for; None for ever.
    """

    def __init__(self, patience_s: float | None = None) -> None:
        super().__init__()
        self._patience_s = patience_s

    def confirm_weight(self, stage: str, weight_kg: float) -> float | Verb:
        """Ask until the typed mass is the planned one, or another verb is typed.

        Raises:
            OperatorStopError: Ctrl-C, ``abort``, the input ended, or nobody answered in time.
        """
        action = f"Hang {weight_kg:g} kg on the lever" if weight_kg else "Take every weight off the lever"
        self.tell(f"Stage {stage}: the drive is off. {action}, and let it come to rest. No hurry: this is a pause.")
        self.tell("Then type its mass; or `repeat` for the stage before, or `abort`.")
        while True:
            try:
                with answered_within(self._patience_s):
                    typed = click.prompt("Mass on the lever now, kg", err=True).strip().lower()
            except click.Abort as error:
                raise OperatorStopError("stopped at the weight prompt") from error
            if typed == Verb.ABORT.value:
                raise OperatorStopError("aborted at the weight prompt")
            if typed == Verb.REPEAT.value:
                return Verb.REPEAT
            mass = _number(typed)
            if mass is None:
                self.tell(f"{typed!r} is neither a mass in kg nor `repeat` nor `abort`")
            elif abs(mass - weight_kg) <= WEIGHT_TOLERANCE_KG:
                return mass
            else:
                self.tell(
                    f"{mass:g} kg is not the planned {weight_kg:g} kg; change the weight and type its mass, "
                    "or press Ctrl-C to stop"
                )

    def paused(self, stage: str, stop: StopButton) -> Verb:
        """Ask how to go on.

        Raises:
            OperatorStopError: Nobody answered in time.
        """
        self.tell(f"Paused after stage {stage}; the drive is off.")
        words = click.Choice([verb.value for verb in Verb], case_sensitive=False)
        try:
            with answered_within(self._patience_s):
                answer = Verb(click.prompt("What now", type=words, default=Verb.GO_ON.value, err=True))
        except click.Abort:
            answer = Verb.ABORT
        stop.pausing = False
        return answer


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
