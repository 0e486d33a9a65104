"""State machine of CiA 402 drives on the host's side: states, commands, table of permitted
commands.

States, transitions and bits are those of CiA 402-2. Only :attr:`Command.ENABLE` has controlwords
that lead to a state nearer to power.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Final

from drivers.errors import StateError
from drivers.interfaces import ServoState as S

CONTROLWORD: Final = (0x6040, 0)
STATUSWORD: Final = (0x6041, 0)

STATUS: Final[tuple[tuple[int, int, S], ...]] = (
    (0x4F, 0x00, S.NOT_READY),
    (0x4F, 0x40, S.SWITCH_ON_DISABLED),
    (0x6F, 0x21, S.READY),
    (0x6F, 0x23, S.SWITCHED_ON),
    (0x6F, 0x27, S.OPERATION_ENABLED),
    (0x6F, 0x07, S.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, S.FAULT_REACTION),
    (0x4F, 0x08, S.FAULT),
)
"""Statusword mask and value of each state."""

_BY_BITS: Final[Mapping[int, S]] = {
    word: state for word in range(0x70) for mask, value, state in STATUS if word & mask == value
}


class Command(Enum):
    """Commands of the host to a drive."""

    ENABLE = "enable"
    DISABLE = "disable"
    QUICK_STOP = "quick stop"
    RESET_FAULT = "reset fault"


SHUTDOWN: Final = 0x06
SWITCH_ON: Final = 0x07
ENABLE_OPERATION: Final = 0x0F
DISABLE_VOLTAGE: Final = 0x00
QUICK_STOP: Final = 0x02
FAULT_RESET: Final = 0x80

CONTROLWORDS: Final[Mapping[tuple[S, Command], int]] = {
    # A command that leads toward power makes one transition only.
    (S.SWITCH_ON_DISABLED, Command.ENABLE): SHUTDOWN,
    (S.READY, Command.ENABLE): SWITCH_ON,
    (S.SWITCHED_ON, Command.ENABLE): ENABLE_OPERATION,
    (S.OPERATION_ENABLED, Command.ENABLE): ENABLE_OPERATION,
    # Commands away from power are permitted in every state.
    **{(state, Command.DISABLE): DISABLE_VOLTAGE for state in S},
    **{(state, Command.QUICK_STOP): QUICK_STOP for state in S},
    # A fault reset leads to the state SWITCH ON DISABLED only; bit 7 acts on its rising edge.
    (S.FAULT, Command.RESET_FAULT): FAULT_RESET,
    (S.SWITCH_ON_DISABLED, Command.RESET_FAULT): DISABLE_VOLTAGE,
}
"""Controlword that executes a command in a state; a pair that is absent is not permitted."""

_REMEDY: Final[Mapping[Command, str]] = {
    Command.ENABLE: "disable the drive first; if it is in fault, reset the fault first",
    Command.RESET_FAULT: (
        "a fault can be reset only in state 'fault', after the drive's reaction to the fault has "
        "ended; disable the drive first"
    ),
}


def decode_state(statusword: int) -> S:
    """Return the state that a statusword shows.

    Raises:
        StateError: No state of CiA 402 has these bits.
    """
    state = _BY_BITS.get(statusword & 0x6F)
    if state is None:
        raise StateError(
            f"statusword {statusword:04X}h has no combination of bits that is a state of CiA 402: "
            "check the mapping of the process data"
        )
    return state


def controlword(state: S, command: Command) -> int:
    """Return the controlword that executes ``command`` in ``state``.

    Raises:
        StateError: The command is not allowed in this state.
    """
    word = CONTROLWORDS.get((state, command))
    if word is None:
        raise StateError(
            f"'{command.value}' is not allowed in state '{state.value}': {_REMEDY[command]}"
        )
    return word
