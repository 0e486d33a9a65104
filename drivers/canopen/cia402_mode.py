"""Selects the drive mode "cyclic synchronous position" of CiA 402 and checks that it is active."""

from __future__ import annotations

from typing import Final

from drivers.canopen import cia402_objects as objects
from drivers.canopen.cia402 import CYCLIC_SYNCHRONOUS_POSITION
from drivers.errors import StateError
from drivers.interfaces import ServoState
from drivers.objects import ProcessChannel, optional

_OFFERS_CSP: Final = 1 << 7
"""Bit of the mode in object 6502h."""
NEEDED_IN: Final = frozenset({ServoState.SWITCHED_ON, ServoState.OPERATION_ENABLED})
"""States in which the mode must be active before the next step toward power. Some drives activate a
mode only when they are switched on.
"""


def select(channel: ProcessChannel) -> None:
    """Write the mode of operation (6060h).

    Raises:
        StateError: The drive does not support the mode (6502h).
    """
    offered = None
    if channel.describes(*objects.MODES):
        offered = optional(channel.read, *objects.MODES)
    if offered is not None and not offered & _OFFERS_CSP:
        raise StateError(
            f"the drive does not support mode 8, cyclic synchronous position (6502h reads "
            f"{offered:08X}h, bit 7 is 0): it cannot be used here"
        )
    channel.write(*objects.MODE, CYCLIC_SYNCHRONOUS_POSITION)


def in_force(channel: ProcessChannel) -> bool:
    """Return whether the drive reports the mode as active (6061h)."""
    return channel.read(*objects.MODE_DISPLAY) == CYCLIC_SYNCHRONOUS_POSITION


def not_shown(channel: ProcessChannel, state: ServoState, waited_s: float) -> StateError:
    """Return the error for a drive that does not activate the mode."""
    return StateError(
        f"mode of operation 6061h still reads {channel.read(*objects.MODE_DISPLAY)} in state "
        f"'{state.value}', {waited_s:g} s after 8 (cyclic synchronous position) was written to "
        f"6060h: check in the drive's manual how this mode is selected"
    )
