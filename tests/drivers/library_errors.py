"""What the libraries under a port have been seen to raise, or may raise."""

import termios
from collections.abc import Callable

import can
import serial


def of_a_socket(number: int) -> can.CanOperationError:
    """Return what python-can raises for an error of the operating system."""
    error = can.CanOperationError(f"Failed to transmit: error {number}", number)
    error.__cause__ = OSError(number, "")
    return error


ERRORS: tuple[Callable[[], Exception], ...] = (
    lambda: OSError(5, "Input/output error"),
    lambda: termios.error(5, "Input/output error"),
    lambda: serial.SerialException("device reports readiness to read but returned no data"),
    lambda: can.CanOperationError("bus-off", 3),
    lambda: of_a_socket(19),
    lambda: UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
    lambda: AttributeError("'NoneType' object has no attribute 'read'"),
    lambda: KeyError(12),
    lambda: NotImplementedError(),
)


def name(make: Callable[[], Exception]) -> str:
    return type(make()).__name__
