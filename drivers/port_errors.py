"""The error boundary of the ports: what a library raises becomes OSError; closing never raises.

pyserial, termios, python-can and its backends have no exception class in common: on an unplugged
adapter, a closed port or a garbled line they raise OSError, termios.error, CanError, ValueError,
TypeError and others.
"""

from __future__ import annotations

import termios
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import wraps
from typing import ParamSpec, TypeVar

from drivers.errors import ConfigurationError, DeviceError, LinkError

_P = ParamSpec("_P")
_R = TypeVar("_R")
_TRACEBACK = "Traceback (most recent call last)"


def words(error: Exception) -> str:
    """Return the first line of what an exception says, with its type where that is a built-in one.

    python-can's socketcand puts a traceback behind its words, beginning on the same line.
    """
    if isinstance(error, termios.error):
        # As an OSError says it; its own text is a tuple.
        return str(OSError(*error.args))
    said = str(error).partition(_TRACEBACK)[0]
    text = next((line.strip() for line in said.splitlines() if line.strip()), "")
    name = type(error).__name__
    if isinstance(error, OSError) or type(error).__module__ != "builtins":
        return text or name
    return f"{name}: {text}" if text else name


def os_errors(action: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the action with every exception translated into OSError.

    KeyboardInterrupt and SystemExit are no exceptions of a library and pass.
    """

    @wraps(action)
    def translated(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        try:
            return action(*args, **kwargs)
        except OSError:
            raise
        except Exception as error:
            raise OSError(words(error)) from error

    return translated


def opened(connect: Callable[[], _R], name: str, advice: str) -> _R:
    """Return a port that was opened.

    Args:
        connect: Opens it.
        name: Of the port, for the message.
        advice: What to check where it cannot be opened.

    Raises:
        LinkError: It cannot be opened.
    """
    try:
        return connect()
    except DeviceError:
        raise
    except Exception as error:
        raise LinkError(f"{name} cannot be opened: {words(error)}; {advice}") from error


def require_one_cycle(running_s: float | None, cycle_s: float, who: str) -> None:
    """Check that a device asks for the cycle time that a link runs at.

    Args:
        running_s: Cycle time of the link, s; None where it is not set yet.
        cycle_s: What the device asks for, s.
        who: The device.

    Raises:
        ConfigurationError: Another device has another one.
    """
    if running_s is not None and running_s != cycle_s:
        raise ConfigurationError(
            f"{who} asks for a cycle of {cycle_s:g} s, the link runs at {running_s:g} s"
        )


def close_all(*closers: Callable[[], object]) -> None:
    """Call every closer, in this order, whatever the ones before it raise.

    Exceptions are dropped: what could not be closed has failed before, and was reported then.
    KeyboardInterrupt and SystemExit are raised after the last closer.
    """
    with ExitStack() as stack:
        for closer in reversed(closers):
            stack.callback(_quietly, closer)


def _quietly(closer: Callable[[], object]) -> None:
    with suppress(Exception):
        closer()
