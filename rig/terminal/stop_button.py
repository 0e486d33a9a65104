"""The stop and pause buttons of a run: the signals that a terminal, a shell or another program
sends.

- SIGINT (Ctrl-C), SIGTERM (``kill``, shutdown of the computer), SIGHUP (a closed terminal, a lost
  ssh connection; ignored under ``nohup``) and SIGTSTP (Ctrl-Z; a suspended program cannot watch a
  drive) end the run: brake, power off, read back.
- SIGQUIT (Ctrl-backslash) ends the run without waiting for the end of the braking ramp.
- SIGTTOU (output from the background) is ignored, because it would suspend the program.
- SIGUSR1 (``kill -USR1``) requests a pause at the end of the stage; a second SIGUSR1 cancels the
  pause.

A second stop signal, before or while the drive brakes, takes the power off at once. Further stop
signals change nothing. The stop button is a stop function in software, not an emergency stop.
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
"""Signals that end a run, with their text for the record; some systems lack some of these."""
HURRY_SIGNALS = frozenset({"SIGQUIT"})
IGNORED_SIGNALS = ("SIGTTOU",)
KEPT_IF_IGNORED = frozenset({"SIGHUP"})
PAUSE_SIGNAL = getattr(signal, "SIGUSR1", None)
"""Signal that requests or ends a pause; None on systems without it."""
PAUSE_ASKED = (
    "pause requested: at the end of this stage, with the drive off; SIGUSR1 again cancels the pause"
)
PAUSE_ENDED = "pause cancelled"


class OperatorStopError(Exception):
    """The operator asked to stop."""


class StopButton:
    """Converts signals to flags that the control loop reads every cycle.

    A context manager; outside the main thread, where signals cannot be caught, only the methods set
    the flags.
    """

    def __init__(self, tell: Callable[[str], None] = lambda words: None) -> None:
        self.pressed = False
        self.presses = 0
        self.cause = ""  # source of the first request, as text
        self.pausing = False  # whether a pause at the next stage boundary was requested
        # Function that takes commands from another source, such as the control socket, and acts on
        # this button, without waiting; called whenever the button is read. None without another
        # source.
        self.listen: Callable[[], None] | None = None
        self._tell = tell
        self._raise_at_once = False
        self._previous: dict[signal.Signals, signal._HANDLER] = {}

    def __enter__(self) -> Self:
        """Install the handlers of the signals."""
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
        """Restore the previous handlers of the signals."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous.clear()

    def press(self, cause: str = "") -> None:
        """Request a stop."""
        self.cause = self.cause or cause
        self.pressed = True
        self.presses += 1

    def pause(self) -> None:
        """Request a pause at the next stage boundary, or the end of a pause."""
        self.pausing = not self.pausing

    @property
    def words(self) -> str:
        """Message that states who stopped the run, and how."""
        return (
            f"stopped by the operator ({self.cause})" if self.cause else "stopped by the operator"
        )

    def check(self) -> None:
        """Read requests from other sources; raise an OperatorStopError if a stop was requested."""
        if self.listen is not None:
            self.listen()
        if self.pressed:
            raise OperatorStopError(self.words)

    def raise_if_pressed(self) -> None:
        """Raise an OperatorStopError if a stop was requested."""
        if self.pressed:
            raise OperatorStopError(self.words)

    def presses_now(self) -> int:
        """Read requests from other sources, and return the number of stop requests."""
        if self.listen is not None:
            self.listen()
        return self.presses

    def hurry(self) -> Callable[[], bool]:
        """Return a function that states, while the drive brakes, whether to take the power off
        without waiting for the end of the ramp.

        The function returns true after a stop request since this call, or if there were two
        requests before. SIGQUIT counts as two requests.
        """
        before = min(self.presses, 1)
        return lambda: self.presses_now() > before

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """A stop raises KeyboardInterrupt at once in it: for long waits while the drive is off."""
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
            # The exception is raised only once, so that the clean-up after it is not interrupted.
            self._raise_at_once = False
            raise KeyboardInterrupt

    def _on_pause(self, number: int, frame: FrameType | None) -> None:
        self.pause()
        self._tell(PAUSE_ASKED if self.pausing else PAUSE_ENDED)


def ignore_stops() -> None:
    """Ignore every stop signal, which would replace the exit status of a stopped program."""
    for name in STOP_SIGNALS:
        number = getattr(signal, name, None)
        if number is not None:
            signal.signal(number, signal.SIG_IGN)
