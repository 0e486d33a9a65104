"""The stop and pause buttons of a run: the signals that a terminal, a shell or another program
sends.

| signal | sent by | what it does |
|---|---|---|
| SIGINT | Ctrl-C | ends the run: brake, power off, read back |
| SIGTERM | `kill`, shutdown of the computer | the same |
| SIGHUP | a terminal that is closed, an ssh that drops | the same; ignored under `nohup` |
| SIGTSTP | Ctrl-Z | the same: a program that is suspended can't watch a drive |
| SIGQUIT | Ctrl-backslash | the same, without waiting for the end of the ramp |
| SIGTTOU | writing from the background | ignored, as it would suspend the program |
| SIGUSR1 | `kill -USR1` | pauses at the end of the stage, and takes that back |

A second signal while the drive brakes takes the power off at once. Further ones change nothing.
This is a stop function in software, not an emergency stop.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Self

STOP_SIGNALS = {
    "SIGINT": "Ctrl-C",
    "SIGTERM": "SIGTERM",
    "SIGHUP": "SIGHUP: the terminal was closed",
    "SIGTSTP": "Ctrl-Z: a run can't be suspended under power",
    "SIGQUIT": "SIGQUIT",
}
"""What ends a run, and what the record says of it; a system lacks some of these."""
HURRY_SIGNALS = frozenset({"SIGQUIT"})
IGNORED_SIGNALS = ("SIGTTOU",)
KEPT_IF_IGNORED = frozenset({"SIGHUP"})
PAUSE_SIGNAL = getattr(signal, "SIGUSR1", None)
"""Asks for a pause, and ends it; None on a system that has no such signal."""
PAUSE_ASKED = (
    "pause asked for: at the end of this stage, where the drive is off; SIGUSR1 again takes it back"
)
PAUSE_ENDED = "no pause"


class OperatorStopError(Exception):
    """The operator asked to stop."""


class StopButton:
    """Turns signals into flags that the control loop looks at every cycle.

    A context manager; outside the main thread, where signals cannot be caught, only the methods set
    the flags.

    Args:
        tell: Shows words to the operator without blocking; called from a signal handler.

    Attributes:
        pressed: Whether a stop was asked for.
        presses: How often.
        cause: What asked first, in words.
        pausing: Whether a pause at the next stage boundary was asked for.
    """

    def __init__(self, tell: Callable[[str], None] = lambda words: None) -> None:
        self.pressed = False
        self.presses = 0
        self.cause = ""
        self.pausing = False
        self._tell = tell
        self._raise_at_once = False
        self._previous: dict[signal.Signals, signal._HANDLER] = {}

    def __enter__(self) -> Self:
        """Take over the signals."""
        if threading.current_thread() is not threading.main_thread():
            return self
        for name in STOP_SIGNALS:
            number = getattr(signal, name, None)
            if number is None:
                continue
            if name in KEPT_IF_IGNORED and signal.getsignal(number) is signal.SIG_IGN:
                continue
            self._previous[number] = signal.signal(number, self._on_stop)
        for name in IGNORED_SIGNALS:
            if (number := getattr(signal, name, None)) is not None:
                self._previous[number] = signal.signal(number, signal.SIG_IGN)
        if PAUSE_SIGNAL is not None:
            self._previous[PAUSE_SIGNAL] = signal.signal(PAUSE_SIGNAL, self._on_pause)
        return self

    def __exit__(self, *exception: object) -> None:
        """Give the signals back."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous.clear()

    def press(self, cause: str = "") -> None:
        """Ask for a stop."""
        self.cause = self.cause or cause
        self.pressed = True
        self.presses += 1

    def pause(self) -> None:
        """Ask for a pause at the next stage boundary, or for the end of one."""
        self.pausing = not self.pausing

    @property
    def words(self) -> str:
        """Who stopped the run, and how."""
        return (
            f"stopped by the operator ({self.cause})" if self.cause else "stopped by the operator"
        )

    def check(self) -> None:
        """Stop if it was asked for.

        Raises:
            OperatorStopError: The button was pressed.
        """
        if self.pressed:
            raise OperatorStopError(self.words)

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Let a stop raise KeyboardInterrupt at once: for what may wait for long while the drive
        has no power.
        """
        self._raise_at_once = True
        try:
            self.check()
            yield
        finally:
            self._raise_at_once = False

    def _on_stop(self, number: int, frame: FrameType | None) -> None:
        name = signal.Signals(number).name
        self.press(STOP_SIGNALS[name])
        if name in HURRY_SIGNALS:
            self.presses += 1
        if self._raise_at_once:
            # Once only: what cleans up after it must not be interrupted.
            self._raise_at_once = False
            raise KeyboardInterrupt

    def _on_pause(self, number: int, frame: FrameType | None) -> None:
        self.pause()
        self._tell(PAUSE_ASKED if self.pausing else PAUSE_ENDED)


def ignore_stops() -> None:
    """Ignore every stop signal from now on.

    For a program that was stopped, has said so, and ends: a signal that comes then, as Ctrl-C is
    pressed more often than needed, would replace its exit status.
    """
    for name in STOP_SIGNALS:
        number = getattr(signal, name, None)
        if number is not None:
            signal.signal(number, signal.SIG_IGN)
