"""Selects the mode of operation of a CiA 402 drive and checks that it is active."""

from __future__ import annotations

from typing import Final

from drivers.canopen import cia402_objects as objects
from drivers.canopen.motion import Motion
from drivers.errors import StateError
from drivers.interfaces import ServoState
from drivers.objects import ProcessChannel, optional

NEEDED_IN: Final = frozenset({ServoState.SWITCHED_ON, ServoState.OPERATION_ENABLED})
"""States in which the mode of operation must be active before the next transition toward power.
Some drives activate a mode only in the state SWITCHED ON.
"""


def not_offered(channel: ProcessChannel, motion: Motion) -> StateError | None:
    """Return an error if the drive, by object 6502h, does not support this mode, or None if it
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
        f"{offered:08X}h, in which bit {bit} is 0): set servo.mode to a mode that the drive "
        "supports"
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
    """Return whether the mode is active, that is, shown in object 6061h."""
    return channel.read(*objects.MODE_DISPLAY) == motion.mode


def not_shown(
    channel: ProcessChannel, motion: Motion, state: ServoState, waited_s: float
) -> StateError:
    """Return the error for a drive that does not activate the mode."""
    return StateError(
        f"in state '{state.value}' the active mode 6061h still reads "
        f"{channel.read(*objects.MODE_DISPLAY)}, {waited_s:g} s after mode {motion.mode} "
        f"({motion.words}) was written to 6060h: check in the drive's manual how this mode is "
        "selected"
    )
