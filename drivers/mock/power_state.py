"""State machine of the simulated CiA 402 drive: states, commands and transitions of CiA 402-2."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, IntEnum, auto, unique
from typing import Final


@unique
class State(IntEnum):
    """States by their statusword under mask 6Fh (4Fh if bit 5 does not matter)."""

    NOT_READY = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION = 0x0F
    FAULT = 0x08


class Command(Enum):
    """Device control commands with their controlword bits."""

    DISABLE_VOLTAGE = auto()
    QUICK_STOP = auto()
    SHUTDOWN = auto()
    SWITCH_ON = auto()
    ENABLE_OPERATION = auto()


POWERED: Final = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION})
"""States in which the power stage is on."""

FAULT_RESET: Final = 0x80  # bit 7 of the controlword; its rising edge resets a fault

_S, _C = State, Command

TRANSITIONS: Final[Mapping[tuple[State, Command], State]] = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): _S.READY,  # 2
    (_S.READY, _C.SWITCH_ON): _S.SWITCHED_ON,  # 3
    (_S.READY, _C.ENABLE_OPERATION): _S.SWITCHED_ON,  # 3, then 4 when the command is received again
    (_S.SWITCHED_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 4
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): _S.SWITCHED_ON,  # 5
    (_S.SWITCHED_ON, _C.SHUTDOWN): _S.READY,  # 6
    (_S.READY, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
    (_S.READY, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): _S.READY,  # 8
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
    (_S.SWITCHED_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): _S.QUICK_STOP_ACTIVE,  # 11
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12
    (
        _S.QUICK_STOP_ACTIVE,
        _C.ENABLE_OPERATION,
    ): _S.OPERATION_ENABLED,  # 16, only with 605Ah = 5 or 6
}


def command(controlword: int) -> Command:
    """Decode the command in controlword bits 0 to 3."""
    if not controlword & 0x02:
        return Command.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return Command.QUICK_STOP
    if not controlword & 0x01:
        return Command.SHUTDOWN
    return Command.ENABLE_OPERATION if controlword & 0x08 else Command.SWITCH_ON
