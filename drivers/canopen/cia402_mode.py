"""Selects the mode of operation of a CiA 402 drive and checks that it is active."""

from __future__ import annotations

from typing import Final

from drivers.canopen import cia402_objects as objects
from drivers.canopen.motion import Motion
from drivers.errors import StateError
from drivers.interfaces import ServoState
from drivers.objects import ProcessChannel, optional

NEEDED_IN: Final = frozenset({ServoState.SWITCHED_ON, ServoState.OPERATION_ENABLED})
"""States in which the mode must be active before the next step toward power. Some drives activate a
mode only when they are switched on.
"""


def not_offered(channel: ProcessChannel, motion: Motion) -> StateError | None:
    """Return the reason why the drive cannot be used in this mode (6502h), or None if the drive
    supports the mode or has no 6502h.
    """
    offered = None
    if channel.describes(*objects.MODES):
        offered = optional(channel.read, *objects.MODES)
    bit = motion.mode - 1
    if offered is None or offered & 1 << bit:
        return None
    return StateError(
        f"the drive does not support mode {motion.mode}, {motion.words} (6502h reads "
        f"{offered:08X}h, bit {bit} is 0): set servo.mode to a mode that the drive supports"
    )


def select(channel: ProcessChannel, motion: Motion) -> None:
    """Write the mode of operation (6060h).

    Raises:
        StateError: The drive does not support the mode (6502h).
    """
    if (error := not_offered(channel, motion)) is not None:
        raise error
    channel.write(*objects.MODE, motion.mode)


def in_force(channel: ProcessChannel, motion: Motion) -> bool:
    """Return whether the drive shows the mode in 6061h."""
    return channel.read(*objects.MODE_DISPLAY) == motion.mode


def not_shown(
    channel: ProcessChannel, motion: Motion, state: ServoState, waited_s: float
) -> StateError:
    """Return the error for a drive that does not activate the mode."""
    return StateError(
        f"mode of operation 6061h still reads {channel.read(*objects.MODE_DISPLAY)} in state "
        f"'{state.value}', {waited_s:g} s after {motion.mode} ({motion.words}) was written to "
        f"6060h: check in the drive's manual how this mode is selected"
    )
