"""Converts the exceptions of libraries for ports to OSError, and closes ports without exceptions.

pyserial, termios, python-can and its backends have no exception class in common: on an unplugged
adapter, a closed port or a garbled line they raise OSError, termios.error, CanError, ValueError,
TypeError and others.
"""

from __future__ import annotations

import errno
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import wraps
from typing import ParamSpec, TypeVar

from drivers.errors import ConfigurationError, DeviceError, LinkError

_P = ParamSpec("_P")
_R = TypeVar("_R")
_GONE = frozenset(
    {errno.EIO, errno.ENODEV, errno.ENXIO, errno.EBADF, errno.EPIPE}
    | {errno.ECONNRESET, errno.ENOTCONN, errno.ESHUTDOWN}
)
"""Errors of an adapter that was unplugged, or of a connection that has ended: the port stays dead.
"""
_TRACEBACK = "Traceback (most recent call last)"


def words(error: Exception) -> str:
    """Return the first line of an exception's message, with the type of a built-in exception. A
    traceback is removed, which python-can's interface socketcand appends on the same line.
    """
    # If the module termios is missing, as on Windows, no exception can be a termios.error.
    termios = sys.modules.get("termios")
    if termios is not None and isinstance(error, termios.error):
        # The text is that of an OSError, because the text of a termios.error is a tuple.
        return str(OSError(*error.args))
    said = str(error).partition(_TRACEBACK)[0]
    text = next((line.strip() for line in said.splitlines() if line.strip()), "")
    name = type(error).__name__
    if isinstance(error, OSError) or type(error).__module__ != "builtins":
        return text or name
    return f"{name}: {text}" if text else name


class UnpluggedError(OSError):
    """A port is dead, although the operating system reports no error."""


def is_gone(error: BaseException) -> bool:
    """Whether a port is dead, so that only opening it again can help."""
    return isinstance(error, UnpluggedError) or (
        isinstance(error, OSError) and error.errno in _GONE
    )


def os_errors(action: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the action with every exception converted to OSError.

    KeyboardInterrupt and SystemExit are not converted.
    """

    @wraps(action)
    def translated(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        try:
            return action(*args, **kwargs)
        except OSError:
            raise
        except Exception as error:
            # python-can keeps the number of the operating system's error in the cause alone.
            cause = error.__cause__
            found = cause.errno if isinstance(cause, OSError) else next(iter(error.args), None)
            if isinstance(found, int) and found in _GONE:
                raise UnpluggedError(words(error)) from error
            raise OSError(words(error)) from error

    return translated


def opened(connect: Callable[[], _R], name: str, advice: str) -> _R:
    """Open a port and return it.

    Raises:
        LinkError: The port cannot be opened.
    """
    try:
        return connect()
    except DeviceError:
        raise
    except Exception as error:
        raise LinkError(f"{name} cannot be opened: {words(error)}; {advice}") from error


def require_one_cycle(running_s: float | None, cycle_s: float, who: str) -> None:
    """Check that the cycle time of a device equals that of its link.

    Raises:
        ConfigurationError: Another device has a different cycle time.
    """
    if running_s is not None and running_s != cycle_s:
        raise ConfigurationError(
            f"{who} needs a cycle time of {cycle_s:g} s, but its link has a cycle time of "
            f"{running_s:g} s: all devices of one link need the same cycle time"
        )


def close_all(*closers: Callable[[], object]) -> None:
    """Call every closer in order, even if an earlier closer raises an exception.

    Exceptions are dropped, because a port that cannot be closed has failed before, and this failure
    has been reported. KeyboardInterrupt and SystemExit are raised after the last closer was called.
    """
    with ExitStack() as stack:
        for closer in reversed(closers):
            stack.callback(_quietly, closer)


def _quietly(closer: Callable[[], object]) -> None:
    with suppress(Exception):
        closer()
