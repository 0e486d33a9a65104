"""Errors of devices and buses, one class for each cause: bus, object access, state, drive fault,
configuration.

A message states what was found and what was expected, with units, and the remedy.
"""

from __future__ import annotations

from typing import Final


class DeviceError(Exception):
    """Base class of all device and bus errors."""


class LinkError(DeviceError):
    """The bus or port failed: not open, bus-off, or no answer; check cabling, power, bit rate."""


class ObjectAccessError(DeviceError):
    """A device refused an object (SDO abort, serial error code)."""

    def __init__(self, index: int, subindex: int, code: int, message: str) -> None:
        super().__init__(f"object {index:04X}h:{subindex:02X}h: {message} (abort code {code:08X}h)")
        self.index = index
        self.subindex = subindex
        self.code = code
        self.message = message


class StateError(DeviceError):
    """The drive is not in the required state, or did not reach the commanded state."""


class DriveFault(DeviceError):
    """The drive reported a fault (statusword, EMCY).

    Args:
        code: Error code of object 603Fh, or of the EMCY frame.
        message: Meaning of the code and remedy.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(f"drive fault {code:04X}h: {message}")
        self.code = code


class ConfigurationError(DeviceError):
    """The device differs from the bench file: wrong identity, scale, unit or limit."""


class RangeError(ConfigurationError):
    """A value does not fit into an object of the device."""

    def __init__(self, low: int, high: int, message: str) -> None:
        super().__init__(message)
        self.low = low
        self.high = high


class LimitError(ConfigurationError):
    """A drive cannot hold a limit of the bench file.

    Args:
        keys: Keys of the bench file from which the value was computed: first the limit, then its
            units.
        message: Limit, range of the drive, and remedy.
    """

    def __init__(self, keys: tuple[str, ...], message: str) -> None:
        super().__init__(message)
        self.keys = keys


class NotDescribedError(ConfigurationError):
    """The EDS file of the device does not contain the object."""


CORRECT_MACHINE: Final = "the error is in this file of the machine, not in the drive or the bus"
"""Words in every :class:`MachineError`."""


class MachineError(DeviceError):
    """The machine behind a simulated drive, a user's file, failed or gave invalid values."""
