"""The person at the bench: prompts, and the stop button that Ctrl-C is."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Protocol, Self

import click

WEIGHT_TOLERANCE_KG = 0.001


class OperatorStopError(Exception):
    """The operator asked to stop."""


class Operator(Protocol):
    """Whoever hangs the weights."""

    def confirm_weight(self, stage: str, weight_kg: float) -> float:
        """Have a weight hung and its mass confirmed; return the mass that was confirmed, kg.

        Raises:
            OperatorStopError: The operator gave up.
        """
        ...


class AutomaticOperator:
    """Answers every prompt with what the plan says (``--yes``)."""

    def confirm_weight(self, stage: str, weight_kg: float) -> float:
        """Confirm the planned weight."""
        return weight_kg


class ConsoleOperator:
    """Asks at the terminal."""

    def confirm_weight(self, stage: str, weight_kg: float) -> float:
        """Ask until the typed mass is the planned one.

        Raises:
            OperatorStopError: Ctrl-C, or the input ended.
        """
        action = f"Hang {weight_kg:g} kg on the lever" if weight_kg else "Take every weight off the lever"
        click.echo(f"Stage {stage}: the drive is off. {action}, and let it come to rest.", err=True)
        while True:
            try:
                typed: float = click.prompt("Mass on the lever now, kg", type=float, err=True)
            except click.Abort as error:
                raise OperatorStopError("stopped at the weight prompt") from error
            if abs(typed - weight_kg) <= WEIGHT_TOLERANCE_KG:
                return typed
            click.echo(
                f"{typed:g} kg is not the planned {weight_kg:g} kg; change the weight and type its mass, "
                "or press Ctrl-C to stop",
                err=True,
            )


class StopButton:
    """Turns Ctrl-C and SIGTERM into a flag that the control loop looks at every cycle.

    A context manager; outside the main thread, where signals cannot be caught, only :meth:`press` sets the flag.
    A software stop is a stop function, not an emergency stop.
    """

    def __init__(self) -> None:
        self.pressed = False
        self._raise_at_once = False
        self._previous: dict[signal.Signals, signal._HANDLER] = {}

    def __enter__(self) -> Self:
        """Take over the signals."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._previous[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *exception: object) -> None:
        """Give the signals back."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous.clear()

    def press(self) -> None:
        """Ask for a stop."""
        self.pressed = True

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
        self.pressed = True
        if self._raise_at_once:
            raise KeyboardInterrupt
