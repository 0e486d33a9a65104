"""The host's state table, alone and against the transitions of the simulated drive."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen import cia402
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
REFUSED = {
    Command.ENABLE: (
        "'enable' is not allowed in state '{}': disable the drive first; if it is in fault, reset "
        "the fault first"
    ),
    Command.RESET_FAULT: (
        "'reset fault' is not allowed in state '{}': a fault can be reset only in state 'fault', "
        "after the drive's reaction to the fault has ended; disable the drive first"
    ),
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
    with pytest.raises(StateError) as caught:
        decode_state(word)
    assert str(caught.value) == (
        f"statusword {word:04X}h has no combination of bits that is a state of CiA 402: check the "
        "mapping of the process data"
    )


@pytest.mark.parametrize("state", list(ServoState))
@pytest.mark.parametrize("order", list(Command))
def test_every_state_and_command(state: ServoState, order: Command) -> None:
    wanted = WORDS[state][list(Command).index(order)]
    if wanted is not None:
        assert controlword(state, order) == wanted
        return
    with pytest.raises(StateError) as caught:
        controlword(state, order)
    assert str(caught.value) == REFUSED[order].format(state.value)


def test_the_objects_and_the_commands() -> None:
    assert cia402.CONTROLWORD == (0x6040, 0)
    assert cia402.STATUSWORD == (0x6041, 0)
    assert [order.value for order in Command] == ["enable", "disable", "quick stop", "reset fault"]


@pytest.mark.parametrize(
    "word", [w for words in WORDS.values() for w in words[1:] if w is not None]
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


@pytest.mark.parametrize("state", list(State))
@given(other=st.integers(0, 0xFFFF))
def test_every_state_is_decoded_whatever_the_other_bits(state: State, other: int) -> None:
    mask = 0x6F if state.value & 0x20 or state is State.QUICK_STOP_ACTIVE else 0x4F
    word = (other & ~mask) | state.value
    assert decode_state(word).name == state.name


@given(st.integers(0, 0xFFFF))
def test_a_statusword_has_one_state_or_is_refused(word: int) -> None:
    matches = [state for mask, value, state in cia402.STATUS if word & mask == value]
    if matches:
        assert [decode_state(word)] == matches
    else:
        with pytest.raises(StateError, match=f"{word:04X}h"):
            decode_state(word)


@pytest.mark.parametrize("state", list(State))
@pytest.mark.parametrize("order", [c for c in Command if c is not Command.ENABLE])
def test_only_enable_leads_toward_power(state: State, order: Command) -> None:
    word = cia402.CONTROLWORDS.get((ServoState[state.name], order))
    if word is None:
        return
    after = TRANSITIONS.get((state, command(word)), state)
    if state is State.FAULT and word & cia402.FAULT_RESET:
        after = State.SWITCH_ON_DISABLED
    assert not ServoState[after.name].energised or ServoState[state.name].energised
    if state is not State.FAULT:
        assert RANK[ServoState[after.name]] <= RANK[ServoState[state.name]]


@pytest.mark.parametrize(
    "word", [w for (_, order), w in cia402.CONTROLWORDS.items() if order is not Command.ENABLE]
)
@pytest.mark.parametrize("state", list(State))
def test_no_word_but_those_of_enable_energises_from_any_state(word: int, state: State) -> None:
    after = TRANSITIONS.get((state, command(word)), state)
    assert after is not State.OPERATION_ENABLED or state is State.OPERATION_ENABLED


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


@pytest.mark.parametrize("order", [Command.DISABLE, Command.QUICK_STOP])
@pytest.mark.parametrize("state", list(ServoState))
def test_stopping_is_allowed_in_every_state(state: ServoState, order: Command) -> None:
    assert controlword(state, order) & 0x09 == 0


@pytest.mark.parametrize(
    ("state", "order"),
    [
        (ServoState.FAULT, Command.ENABLE),
        (ServoState.FAULT_REACTION, Command.ENABLE),
        (ServoState.QUICK_STOP_ACTIVE, Command.ENABLE),
        (ServoState.NOT_READY, Command.ENABLE),
        (ServoState.OPERATION_ENABLED, Command.RESET_FAULT),
        (ServoState.FAULT_REACTION, Command.RESET_FAULT),
    ],
)
def test_an_illegal_move_names_state_and_command(state: ServoState, order: Command) -> None:
    with pytest.raises(StateError, match=f"'{order.value}'.*'{state.value}'"):
        controlword(state, order)
