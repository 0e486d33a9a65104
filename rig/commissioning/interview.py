"""Questions to the operator during a commissioning, and their automatic answers."""

from __future__ import annotations

from typing import Protocol

from rig.terminal.prompt import Asker, InputEndedError
from rig.terminal.screen import Screen
from rig.terminal.stop_button import OperatorStopError, StopButton


class Interview(Protocol):
    """Interface to the person at the bench."""

    how: str

    def tell(self, words: str) -> None:
        """Show a message that needs no answer."""
        ...

    def agrees(self, words: str) -> bool:
        """Ask for consent to an action; only an explicit yes counts as consent.

        Raises:
            OperatorStopError: The operator aborted the commissioning.
        """
        ...

    def angle_deg(self, words: str) -> float | None:
        """Ask for the true joint angle, deg; return None if it is not known."""
        ...


class AutomaticInterview:
    """Agrees to every step (``--yes``, simulated benches only).

    Args:
        screen: Screen for messages.
        angle_deg: The true joint angle, or None if it is not given.
    """

    how = "--yes"

    def __init__(self, screen: Screen, angle_deg: float | None = None) -> None:
        self._screen = screen
        self._angle_deg = angle_deg

    def tell(self, words: str) -> None:
        """Show the message."""
        self._screen.say(words, err=False)

    def agrees(self, words: str) -> bool:
        """Show the question and agree."""
        self.tell(f"{words} yes (--yes)")
        return True

    def angle_deg(self, words: str) -> float | None:
        """Return the angle given on the command line."""
        return self._angle_deg


class TypedInterview:
    """Asks the operator at the terminal.

    Args:
        screen: Screen for messages.
        asker: Asks and reads answers.
        stop: Stop button; a stop signal interrupts a question.
        angle_deg: The true joint angle, if given on the command line.
    """

    how = "typed"

    def __init__(
        self, screen: Screen, asker: Asker, stop: StopButton, angle_deg: float | None = None
    ) -> None:
        self._screen = screen
        self._asker = asker
        self._stop = stop
        self._angle_deg = angle_deg

    def tell(self, words: str) -> None:
        """Show the message."""
        self._screen.say(words, err=False)

    def agrees(self, words: str) -> bool:
        """Ask until yes, no or abort is typed; an empty answer means no.

        Raises:
            OperatorStopError: The operator pressed Ctrl-C or typed ``abort``, or the input ended.
        """
        while True:
            typed = self._ask(f"{words} yes, no or abort [no]: ").lower()
            if typed in ("y", "yes"):
                return True
            if typed in ("", "n", "no"):
                return False
            self.tell(f"{typed!r} is not one of `yes`, `no`, `abort`")

    def angle_deg(self, words: str) -> float | None:
        """Ask for an angle in degrees; an empty answer means None.

        Raises:
            OperatorStopError: See :meth:`agrees`.
        """
        if self._angle_deg is not None:
            return self._angle_deg
        while True:
            typed = self._ask(f"{words} (empty: not known): ")
            if not typed:
                return None
            try:
                return float(typed.replace(",", "."))
            except ValueError:
                self.tell(f"{typed!r} is not an angle in degrees")

    def _ask(self, words: str) -> str:
        try:
            with self._stop.interruptible():
                typed = self._asker.ask(words)
        except InputEndedError as error:
            raise OperatorStopError(f"stopped at a question: {error}") from error
        except KeyboardInterrupt as error:
            raise OperatorStopError("stopped by the operator at a question") from error
        if typed.lower() == "abort":
            raise OperatorStopError("aborted by the operator at a question")
        return typed
