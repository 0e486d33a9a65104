"""The host's state table, alone and against the transitions of the simulated drive."""

import pytest

from drivers.canopen.cia402 import Command, controlword, decode_state
from drivers.errors import StateError
from drivers.interfaces import ServoState
from drivers.mock.power_state import TRANSITIONS, State, command

DECODED = {
    # CiA 402-2, statusword: x is a bit that does not matter, in the order of bits 6, 5, 3, 2, 1, 0.
    "0x0000": ServoState.NOT_READY,
    "1x0000": ServoState.SWITCH_ON_DISABLED,
    "010001": ServoState.READY,
    "010011": ServoState.SWITCHED_ON,
    "010111": ServoState.OPERATION_ENABLED,
    "000111": ServoState.QUICK_STOP_ACTIVE,
    "0x1111": ServoState.FAULT_REACTION,
    "0x1000": ServoState.FAULT,
}
WORDS = {
    # What this program sends: all of it, state by state (enable, disable, quick stop, reset fault).
    ServoState.NOT_READY: (None, 0x00, 0x02, None),
    ServoState.SWITCH_ON_DISABLED: (0x06, 0x00, 0x02, 0x00),
    ServoState.READY: (0x07, 0x00, 0x02, None),
    ServoState.SWITCHED_ON: (0x0F, 0x00, 0x02, None),
    ServoState.OPERATION_ENABLED: (0x0F, 0x00, 0x02, None),
    ServoState.QUICK_STOP_ACTIVE: (None, 0x00, 0x02, None),
    ServoState.FAULT_REACTION: (None, 0x00, 0x02, None),
    ServoState.FAULT: (None, 0x00, 0x02, 0x80),
}
TOWARD_POWER = [
    ServoState.NOT_READY,
    ServoState.SWITCH_ON_DISABLED,
    ServoState.READY,
    ServoState.SWITCHED_ON,
    ServoState.OPERATION_ENABLED,
]
RANK = {state: rank for rank, state in enumerate(TOWARD_POWER)} | {
    ServoState.FAULT: 0,
    ServoState.FAULT_REACTION: 4,
    ServoState.QUICK_STOP_ACTIVE: 4,
}


def pattern(word: int) -> str:
    return "".join(str(word >> bit & 1) for bit in (6, 5, 3, 2, 1, 0))


@pytest.mark.parametrize("word", range(0x80))
def test_the_statusword_is_read_as_the_standard_says(word: int) -> None:
    wanted = [
        state
        for known, state in DECODED.items()
        if all(k in ("x", bit) for k, bit in zip(known, pattern(word), strict=True))
    ]
    if wanted:
        assert [decode_state(word)] == wanted
        return
    with pytest.raises(StateError, match=f"{word:04X}h"):
        decode_state(word)


@pytest.mark.parametrize("state", list(ServoState))
@pytest.mark.parametrize("order", list(Command))
def test_every_state_and_command(state: ServoState, order: Command) -> None:
    wanted = WORDS[state][list(Command).index(order)]
    if wanted is not None:
        assert controlword(state, order) == wanted
        return
    with pytest.raises(StateError, match=f"'{order.value}'.*'{state.value}'"):
        controlword(state, order)


@pytest.mark.parametrize(
    "word", sorted({w for words in WORDS.values() for w in words[1:] if w is not None})
)
@pytest.mark.parametrize("state", list(State))
def test_no_sequence_of_words_without_enable_leads_toward_power(state: State, word: int) -> None:
    """From any state, sent again and again, whatever the drive does meanwhile."""
    energised = ServoState[state.name].energised
    for _ in range(4):
        after = TRANSITIONS.get((state, command(word)), state)
        if state is State.FAULT and word & 0x80:
            after = State.SWITCH_ON_DISABLED
        assert RANK[ServoState[after.name]] <= RANK[ServoState[state.name]] or state is State.FAULT
        energised = energised and ServoState[after.name].energised
        assert ServoState[after.name].energised is energised
        state = after


def test_enable_takes_one_transition_at_a_time() -> None:
    state = State.SWITCH_ON_DISABLED
    path = [state]
    while state is not State.OPERATION_ENABLED:
        state = TRANSITIONS[state, command(controlword(ServoState[state.name], Command.ENABLE))]
        path.append(state)
    assert path == [
        State.SWITCH_ON_DISABLED,
        State.READY,
        State.SWITCHED_ON,
        State.OPERATION_ENABLED,
    ]
