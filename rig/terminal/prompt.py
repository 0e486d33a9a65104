"""Prompts to the operator; input typed before a prompt is never used as its answer.

An answer is one line. At a terminal everything typed before the question is dropped. Lines from a
pipe cannot be distinguished from answers and are used in order; for this reason a real bench
refuses weight prompts without a terminal (:func:`rig.control.attendance.require_attendance`).
"""

from __future__ import annotations

import os
import select
import sys
from typing import Protocol, TextIO

from drivers.clock import NS, Clock, RealClock
from rig.terminal.control_socket import ControlSocket
from rig.terminal.screen import Screen
from rig.terminal.stop_button import OperatorStopError

_LONGEST_WAIT_S = 1.0
_CHUNK = 4096


class InputEndedError(Exception):
    """The input has ended: it was closed, or the terminal has disappeared."""


class Asker(Protocol):
    """Puts questions to the operator."""

    def ask(self, words: str) -> str:
        """Show a question; return the stripped answer; InputEndedError, or a stop."""
        ...


def unanswered(patience_s: float) -> OperatorStopError:
    """Return the error for a prompt without an answer in time."""
    return OperatorStopError(
        f"nobody answered the prompt within {patience_s:g} s; continue with `rig resume`; for a "
        f"longer wait raise prompt_timeout_s"
    )


def at_terminal() -> bool:
    """Whether a person can be asked: standard input is a terminal."""
    try:
        return sys.stdin is not None and sys.stdin.isatty()
    except ValueError:
        return False


class Prompt:
    """Asks on a screen and reads the answer from a stream.

    Args:
        patience_s: Time to wait for an answer, s, or None to wait without limit.
        control: Socket on which an answer may arrive as well, or None for none.
        only_there: Whether nobody is at the input, so that an answer can arrive only on
            ``control``.
    """

    def __init__(
        self,
        screen: Screen,
        stream: TextIO | None = None,
        patience_s: float | None = None,
        clock: Clock | None = None,
        control: ControlSocket | None = None,
        only_there: bool = False,
    ) -> None:
        self._control = control
        self._only_there = only_there
        self._screen = screen
        self._stream = stream if stream is not None else sys.stdin
        self._patience_s = patience_s
        self._clock = clock or RealClock()
        self._rest = b""
        try:
            self._descriptor: int | None = None if self._stream is None else self._stream.fileno()
        except (OSError, ValueError):
            self._descriptor = None

    def ask(self, words: str) -> str:
        """Show a question and return the line that answers it, stripped; see :class:`Asker`."""
        self._flush()
        self._screen.ask(words)
        self._screen.drain()
        if self._control is not None:
            self._control.ask(words)
        try:
            if self._only_there or self._descriptor is not None:
                return self._from_descriptor(None if self._only_there else self._descriptor)
            return self._from_stream()
        finally:
            self._screen.listened()
            if self._control is not None:
                self._control.close_prompt()

    def _flush(self) -> None:
        if self._descriptor is None or not os.isatty(self._descriptor):
            return
        import termios

        self._rest = b""
        try:
            termios.tcflush(self._descriptor, termios.TCIFLUSH)
        except termios.error as error:
            raise InputEndedError("the terminal is gone") from error

    def _from_stream(self) -> str:
        line = "" if self._stream is None else self._stream.readline()
        if not line:
            raise InputEndedError("the input has ended")
        return line.strip()

    def _from_descriptor(self, descriptor: int | None) -> str:
        """Return the first answer, from the input (None: not there) or from the control socket."""
        began_ns = self._clock.now_ns()
        while b"\n" not in self._rest or descriptor is None:
            answer = self._wait(descriptor, began_ns)
            if answer is not None:
                return answer
            assert descriptor is not None
            try:
                data = os.read(descriptor, _CHUNK)
            except OSError as error:
                raise InputEndedError(f"the input cannot be read: {error.strerror}") from error
            if not data:
                if self._rest.strip():
                    break
                raise InputEndedError("the input has ended")
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        if os.isatty(descriptor):
            self._screen.answered()
        return line.decode(errors="replace").strip()

    def _wait(self, descriptor: int | None, began_ns: int) -> str | None:
        """Wait, and write queued output: None for input, else the answer on the control socket."""
        sources = [source for source in (descriptor, self._control) if source is not None]
        while True:
            wait_s = _LONGEST_WAIT_S
            if self._patience_s is not None:
                left_s = self._patience_s - (self._clock.now_ns() - began_ns) / NS
                if left_s <= 0.0:
                    raise unanswered(self._patience_s)
                wait_s = min(wait_s, left_s)
            try:
                ready = select.select(sources, [], [], wait_s)[0]
            except (OSError, ValueError) as error:
                raise InputEndedError(f"the input cannot be read: {error}") from error
            answer = None if self._control is None else self._control.answered()
            if answer is not None or descriptor in ready:
                return answer
            self._screen.pump()
