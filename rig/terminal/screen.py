"""Operator's screen: messages and a status line, written so that no terminal can block the control
loop.

A stopped terminal (Ctrl-S), an unread pipe or a hanging ssh accepts no more bytes. For such a
terminal, output is queued and written when there is room; the status line is omitted meanwhile.
Only :meth:`Screen.drain` waits; it is used only while the drive is off.
"""

from __future__ import annotations

import io
import os
import select
import sys
import textwrap
from contextlib import suppress
from typing import Final, TextIO

from drivers.clock import NS, Clock, RealClock

QUEUE_BYTES: Final = 1 << 20
"""Size of the largest queue for a blocked reader, bytes; further output is dropped."""
DRAIN_S: Final = 5.0  # time, s, to wait for a stalled terminal after the drive is off
STATUS_NS: Final = NS // 4
"""Time between two status lines, ns: 80 columns four times a second fit 9600 baud."""
_CHUNK: Final = 512
"""Number of bytes that a ready pipe accepts in one write (POSIX: PIPE_BUF is at least 512)."""
_LOOK_S: Final = 0.05
_COLUMNS: Final = 80


class Outlet:
    """One output stream of this program, written without blocking.

    A terminal is opened again for this purpose, because the non-blocking mode belongs to the open
    file, which other programs share. A stream without descriptor (in tests) is written directly.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self.trouble: OSError | None = None
        self.terminal = False
        self._stream = stream
        self._encoding = getattr(stream, "encoding", None) or "utf-8"
        self._pending = bytearray()
        self._descriptor: int | None = None
        self._own = False
        self._ready = True
        if stream is None:
            return
        try:
            self._descriptor = stream.fileno()
            with suppress(OSError, ValueError):
                stream.flush()
            self.terminal = os.isatty(self._descriptor)
        except (OSError, ValueError, io.UnsupportedOperation):
            self._descriptor = None
            return
        if self.terminal:
            with suppress(OSError, AttributeError):
                name = os.ttyname(self._descriptor)
                self._descriptor = os.open(
                    name, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
                )
                self._own = True

    @property
    def columns(self) -> int:
        """Number of columns of the terminal; 80 if unknown."""
        with suppress(OSError, ValueError):
            if self._descriptor is not None:
                return os.get_terminal_size(self._descriptor).columns or _COLUMNS
        return _COLUMNS

    @property
    def pending(self) -> bool:
        """Whether output is queued."""
        return bool(self._pending)

    def put(self, text: str) -> None:
        """Queue text, and write what can be written now."""
        if self._stream is None or self.trouble is not None:
            return
        if self._descriptor is None:
            with suppress(OSError, ValueError):
                self._stream.write(text)
                self._stream.flush()
            return
        data = text.encode(self._encoding, "backslashreplace")
        if len(self._pending) + len(data) <= QUEUE_BYTES:
            self._pending += data
        self.pump()

    def pump(self) -> None:
        """Write what can be written without waiting."""
        while self._pending and self.trouble is None and self._descriptor is not None:
            try:
                if not self._own and not select.select([], [self._descriptor], [], 0.0)[1]:
                    return
                written = os.write(self._descriptor, self._pending[:_CHUNK])
            except BlockingIOError:
                return
            except (OSError, ValueError) as error:
                self.trouble = error if isinstance(error, OSError) else OSError(str(error))
                self._pending.clear()
                return
            del self._pending[:written]

    def echo(self, shown: bool) -> None:
        """Switch the echo of keys, unless the terminal is gone or of another job."""
        if not self.terminal or self._descriptor is None:
            return
        # Imported here, because systems without POSIX terminals do not have this module.
        import termios

        with suppress(OSError):
            # If the terminal belongs to this session, only the foreground job may change it.
            if os.tcgetpgrp(self._descriptor) != os.getpgrp():
                return
        with suppress(termios.error):
            mode = termios.tcgetattr(self._descriptor)
            mode[3] = mode[3] | termios.ECHO if shown else mode[3] & ~termios.ECHO
            termios.tcsetattr(self._descriptor, termios.TCSANOW, mode)

    def close(self) -> None:
        """Close the descriptors that this object opened."""
        if self._own and self._descriptor is not None:
            with suppress(OSError):
                os.close(self._descriptor)
        self._descriptor, self._own = None, False
        self._stream = None


def _wrapped(words: str, columns: int) -> str:
    """Wrap long lines between words; table rows, recognised by double spaces, are unchanged."""
    return "\n".join(
        textwrap.fill(line, columns, break_long_words=False, break_on_hyphens=False)
        if len(line) > columns and "  " not in line
        else line
        for line in words.split("\n")
    )


class Screen:
    """The operator's view of a run."""

    def __init__(
        self, clock: Clock | None = None, out: TextIO | None = None, err: TextIO | None = None
    ) -> None:
        self._clock = clock or RealClock()
        self._err = Outlet(err if err is not None else sys.stderr)
        self._out = Outlet(out if out is not None else sys.stdout)
        if self._out.terminal and self._err.terminal:
            # Both streams have one queue, so that messages are shown in their order.
            self._out.close()
            self._out = self._err
        self._shown = 0
        self._line_open = False
        self._drawn_ns: int | None = None
        self._silent = False
        self._shared = False

    @property
    def trouble(self) -> OSError | None:
        """Reason why results cannot be shown any more, or None if results can be shown."""
        return self._out.trouble

    @property
    def terminal(self) -> bool:
        """Whether results go to a terminal."""
        return self._out.terminal

    @property
    def has_status(self) -> bool:
        """Whether a status line can be shown."""
        return self._err.terminal and os.environ.get("TERM", "") not in ("", "dumb")

    def say(self, words: str, err: bool = True) -> None:
        """Show a message of one or more lines."""
        self._begin_line()
        outlet = self._err if err else self._out
        outlet.put(f"{_wrapped(words, outlet.columns) if outlet.terminal else words}\n")

    def share(self) -> None:
        """Begin every message on a new line: another program may have left a line unfinished."""
        self._shared = self._err.terminal

    def silence(self) -> None:
        """Switch off the echo of keys, as ``^C``, until :meth:`close`, except in answers."""
        self._silent = True
        self._err.echo(False)

    def ask(self, words: str) -> None:
        """Show a prompt; the cursor stays behind the prompt, and typed characters are shown."""
        self._begin_line()
        if self._silent:
            self._err.echo(True)
        self._err.put(words)
        self._line_open = True

    def listened(self) -> None:
        """Note that a prompt has ended, answered or not."""
        if self._silent:
            self._err.echo(False)

    def answered(self) -> None:
        """Note that the terminal has begun a new line with the answer to a prompt."""
        self._line_open = False

    def status(self, text: str) -> None:
        """Replace the status line, unless the terminal is blocked or this was just done."""
        self.pump()
        now = self._clock.now_ns()
        recent = self._drawn_ns is not None and now - self._drawn_ns < STATUS_NS
        if not self.has_status or recent or self._err.pending:
            return
        erase = self._erase()
        if self._line_open:
            self._begin_line()
        self._drawn_ns = now
        line = text[: max(self._err.columns - 1, 1)]
        self._err.put(f"{erase}{line}")
        self._shown = len(line)

    def _begin_line(self) -> None:
        if self._shown:
            self._err.put(self._erase())
            self._shown = 0
        if self._line_open or self._shared:
            self._err.put("\n")
            self._line_open = False

    def _erase(self) -> str:
        """Return what erases the status line, also if a narrower window has broken it into rows."""
        rows = max(self._shown - 1, 0) // max(self._err.columns, 1)
        up = f"\x1b[{rows}A" if rows else ""
        return f"\r{up}\x1b[J" if self._shown else "\r"

    def pump(self) -> None:
        """Write queued output, as far as possible without waiting."""
        self._err.pump()
        self._out.pump()

    def drain(self, patience_s: float = DRAIN_S) -> bool:
        """Wait, only while the drive is off, until all is shown or the time over; whether it is."""
        deadline = self._clock.now_ns() + round(patience_s * NS)
        self.pump()
        while self._out.pending or self._err.pending:
            now = self._clock.now_ns()
            if now >= deadline:
                return False
            self._clock.sleep_until_ns(min(deadline, now + round(_LOOK_S * NS)))
            self.pump()
        return True

    def close(self) -> None:
        """Erase the status line, switch the echo of keys on, and close the terminal."""
        self._begin_line()
        self.drain(0.0)
        if self._silent:
            self._err.echo(True)
            self._silent = False
        self._out.close()
        self._err.close()
