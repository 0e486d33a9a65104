"""Error boundary of the ports: library exceptions become OSError; closing never raises.

pyserial, termios, python-can and its backends have no exception class in common: on an unplugged
adapter, a closed port or a garbled line they raise OSError, termios.error, CanError, ValueError,
TypeError and others.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import wraps
from typing import ParamSpec, TypeVar

from drivers.errors import ConfigurationError, DeviceError, LinkError

_P = ParamSpec("_P")
_R = TypeVar("_R")
_TRACEBACK = "Traceback (most recent call last)"


def words(error: Exception) -> str:
    """Return the first line of an exception's message, with the type of a built-in exception.
    python-can's socketcand appends a traceback to its message, on the same line.
    """
    # Without the module, as on Windows, nothing can have raised its error.
    termios = sys.modules.get("termios")
    if termios is not None and isinstance(error, termios.error):
        # Text as in an OSError; this exception's own text is a tuple.
        return str(OSError(*error.args))
    said = str(error).partition(_TRACEBACK)[0]
    text = next((line.strip() for line in said.splitlines() if line.strip()), "")
    name = type(error).__name__
    if isinstance(error, OSError) or type(error).__module__ != "builtins":
        return text or name
    return f"{name}: {text}" if text else name


def os_errors(action: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the action with every exception translated into OSError.

    KeyboardInterrupt and SystemExit are not translated.
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
        name: Name of the port in the message.
        advice: What to check if it cannot be opened.

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
    """Check that the cycle time of a device is the cycle time of its link.

    Args:
        running_s: Cycle time of the link, s, or None if not set yet.
        cycle_s: Cycle time of the device, s.
        who: The device.

    Raises:
        ConfigurationError: Another device has a different cycle time.
    """
    if running_s is not None and running_s != cycle_s:
        raise ConfigurationError(
            f"{who} needs a cycle of {cycle_s:g} s, but its link runs at {running_s:g} s: "
            "devices of one link need the same cycle"
        )


def close_all(*closers: Callable[[], object]) -> None:
    """Call every closer in order, even if an earlier closer raises an exception.

    Exceptions are dropped, because a port that cannot be closed has failed before, and that failure
    has been reported. KeyboardInterrupt and SystemExit are raised after the last closer.
    """
    with ExitStack() as stack:
        for closer in reversed(closers):
            stack.callback(_quietly, closer)


def _quietly(closer: Callable[[], object]) -> None:
    with suppress(Exception):
        closer()
