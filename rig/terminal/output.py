"""Safe standard streams of the command line: writing never raises and never ends the work.

If a reader closes the stream (``| head -1``, a closed terminal), the command continues and its exit
status is unchanged. If the output cannot be stored (a full disk), this is reported as a storage
error with its own exit status.
"""

from __future__ import annotations

import codecs
import errno
import io
import os
import select
import sys
import time
from typing import Any, Final, Self

from tqdm import tqdm

SHOWN: Final = "rig.shown"
"""Error handler of the encoder: undecoded bytes unchanged, other characters as escapes."""
_GONE: Final = frozenset({errno.EPIPE, errno.ECONNRESET, errno.ENXIO})


class Outlet(io.FileIO):
    """The raw end of an output stream; after a ``failure`` further output is discarded."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.failure: OSError | None = None
        self._ended = False
        self._terminal = self.isatty()

    def write(self, data: Any, /) -> int:
        """Write and return the number of bytes; waits also if the descriptor is non-blocking."""
        size = memoryview(data).nbytes
        while not self._ended:
            try:
                written: int | None = super().write(data)
            except OSError as error:
                self._end(error)
                break
            if written is not None:
                return written
            select.select([], [self.fileno()], [])
        return size

    def _end(self, error: OSError) -> None:
        self._ended = True
        if not reader_gone(error, terminal=self._terminal):
            self.failure = error


def reader_gone(error: OSError, *, terminal: bool) -> bool:
    """Return whether the reader has closed; a closed terminal gives EIO, like a broken disk."""
    return error.errno in _GONE or (terminal and error.errno == errno.EIO)


class Inlet(io.FileIO):
    """The raw end of the input; an unreadable input (closed terminal) counts as end of file."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "r", closefd=False)

    def readinto(self, buffer: Any, /) -> int:
        """Read into a buffer; 0 is the end."""
        while True:
            try:
                # The result is None, which the type stubs omit, if a non-blocking descriptor has no
                # data yet.
                count: int | None = super().readinto(buffer)
            except OSError:
                return 0
            if count is not None:
                return count
            select.select([self.fileno()], [], [])


class Streams:
    """The standard streams, made safe; :meth:`finish` returns the final error, if any."""

    def __init__(self) -> None:
        _occupy_standard_descriptors()
        codecs.register_error(SHOWN, _shown)
        self._output = Outlet(1)
        if _is_standard(sys.stdin, 0):
            sys.stdin = io.TextIOWrapper(
                io.BufferedReader(Inlet(0)), encoding=_encoding(sys.stdin), errors="replace"
            )
        if _is_standard(sys.stdout, 1):
            sys.stdout = _writer(self._output, sys.stdout, line_buffering=self._output.isatty())
        if _is_standard(sys.stderr, 2):
            sys.stderr = _writer(Outlet(2), sys.stderr, line_buffering=True)

    def finish(self) -> str | None:
        """Flush the buffers; return why output could not be written, or None."""
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        failure = self._output.failure
        return None if failure is None else f"the output cannot be written: {failure.strerror}"


def complain(words: str) -> None:
    """Print to stderr; errors are ignored, so that later messages are not lost."""
    if sys.stderr is None:
        return
    try:
        sys.stderr.write(f"{words}\n")
        sys.stderr.flush()
    except UnicodeEncodeError:
        sys.stderr.write(words.encode("ascii", "backslashreplace").decode("ascii") + "\n")
    except (OSError, ValueError):
        # The terminal or stream is closed: nobody can read the message.
        return


def _occupy_standard_descriptors() -> None:
    """Open the null device for every closed standard descriptor, whose number a file would get."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # open() uses the lowest free number, which is this one, because lower numbers are open.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)


def _is_standard(stream: object, descriptor: int) -> bool:
    """Return whether a stream is missing or opened by Python; replacements by a caller are kept."""
    if stream is None:
        return True
    try:
        return isinstance(stream, io.TextIOWrapper) and stream.fileno() == descriptor
    except (OSError, ValueError):
        return False


def _writer(raw: Outlet, replaced: object, *, line_buffering: bool) -> io.TextIOWrapper:
    through = isinstance(replaced, io.TextIOWrapper) and replaced.write_through
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=_encoding(replaced),
        errors=SHOWN,
        line_buffering=line_buffering,
        write_through=through,
    )


def _encoding(stream: object) -> str:
    """Return the encoding of a stream; like click, treats ASCII as an unset locale."""
    if not isinstance(stream, io.TextIOWrapper) or codecs.lookup(stream.encoding).name == "ascii":
        return "utf-8"
    return stream.encoding


def _shown(error: UnicodeError) -> tuple[bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = bytearray()
    for character in error.object[error.start : error.end]:
        if "\udc80" <= character <= "\udcff":
            found.append(ord(character) - 0xDC00)
        else:
            found += character.encode("ascii", "backslashreplace")
    return bytes(found), error.end


_PERIOD_S: Final = 0.1  # shortest time between two showings of one kind of work


class ShareBar:
    """Progress bar of the present work and its share; nothing if the output is not a terminal."""

    def __init__(self) -> None:
        tqdm.monitor_interval = 0  # no helper thread
        self._what = ""
        self._shown_at = -_PERIOD_S
        self._bar = tqdm(
            total=100.0, disable=None, leave=False, bar_format="{desc} |{bar}| {n:.0f} %, {elapsed}"
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._bar.close()

    def __call__(self, what: str, share: float) -> None:
        """Show the work ``what`` and the share of it that is done, 0 to 1."""
        if self._bar.disable:
            return
        now = time.monotonic()
        if what == self._what and now - self._shown_at < _PERIOD_S and share < 1.0:
            return
        self._what, self._shown_at = what, now
        self._bar.set_description_str(what, refresh=False)
        self._bar.n = 100.0 * share
        self._bar.refresh()
