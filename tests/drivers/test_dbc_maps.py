"""Any DBC and any map: encoding agrees with cantools, no order goes out that was not given, and a
map binds or is refused with its places.
"""

from __future__ import annotations

import dataclasses
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cantools.database
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from drivers.dbc.bind import bind
from drivers.dbc.channel import DbcChannel
from drivers.dbc.codec import Signal, Wiring
from drivers.dbc.file import DbcMapError, Layout, read_dbc
from drivers.dbc.limits import _tighter_real
from drivers.dbc.map import DbcMap, Protection, Quantity, StopFrame
from drivers.errors import DriveFault
from drivers.interfaces import ServoState

from .dbc_texts import HEAD, MOTOR, MOTOR_MAP, ordered, special

COMMAND, REPLY, CLEAR, ERROR = 1, 2, 3, 4
DISABLE, ENABLE = bytes.fromhex("fffffffffffffffd"), bytes.fromhex("fffffffffffffffc")


@dataclass(frozen=True)
class Part:
    """One signal of a generated message."""

    width: int
    gap: int
    signed: bool
    real: bool


parts = st.lists(
    st.builds(Part, st.integers(1, 32), st.integers(0, 7), st.booleans(), st.booleans()),
    min_size=1,
    max_size=8,
)


def text_of(found: list[Part], motorola: bool, identifier: int) -> tuple[str, list[Part]]:
    """Return a DBC with as many of these signals as fit into eight bytes, one after the other."""
    lines, real, kept, at = [], [], [], 0
    for part in found:
        width = 32 if part.real else part.width
        at += part.gap
        if at + width > 64:
            break
        start = at // 8 * 8 + 7 - at % 8 if motorola else at
        sign = "-" if part.signed or part.real else "+"
        lines.append(
            f' SG_ S{len(kept)} : {start}|{width}@{0 if motorola else 1}{sign} (1,0) [0|0] "" B'
        )
        if part.real:
            real.append(f"SIG_VALTYPE_ {identifier} S{len(kept)} : 1;")
        kept.append(part)
        at += width
    message = "\n".join([f"BO_ {identifier} M: 8 A", *lines])
    return HEAD + message + "\n\n" + "\n".join(real) + "\n", kept


def read(text: str) -> dict[str, Layout]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "x.dbc")
        path.write_text(text)
        return read_dbc(path)


@settings(max_examples=150, deadline=None)
@given(
    found=parts,
    motorola=st.booleans(),
    identifier=st.sampled_from([0x123, 0x98FEF101]),
    data=st.binary(min_size=8, max_size=8),
)
def test_signals_are_packed_and_read_as_cantools_does(
    found: list[Part], motorola: bool, identifier: int, data: bytes
) -> None:
    text, kept = text_of(found, motorola, identifier)
    layout = read(text)["M"]
    message = cantools.database.load_string(text, database_format="dbc").get_message_by_name("M")
    assert (layout.identifier & 0x1FFFFFFF, layout.size) == (message.frame_id, 8)
    if not kept:
        return
    decoded = message.decode(data, decode_choices=False, scaling=False)
    rebuilt = bytes(8)
    for name, signal in layout.signals.items():
        raw = signal.raw(data)
        assert raw == decoded[name] or (raw != raw and decoded[name] != decoded[name])
        assert signal.reader(1.0, 0.0)(data) == raw or raw != raw
        rebuilt = signal.insert(rebuilt, signal.bits(data))
        if raw == raw and abs(raw) != float("inf"):
            assert signal.insert(bytes(8), signal.pack(raw)) == signal.insert(
                bytes(8), signal.bits(data)
            )
    # What is written is these signals' bits and no others.
    covered = sum(signal.covers for signal in layout.signals.values())
    assert int.from_bytes(rebuilt, "big") == int.from_bytes(data, "big") & covered
    finite = {name: value for name, value in decoded.items() if value == value}
    if len(finite) == len(decoded):
        assert message.encode(decoded, scaling=False) == rebuilt


@given(raw=st.floats(-1e30, 1e30), upward=st.booleans())
def test_a_floating_point_limit_is_rounded_to_the_tighter_side(raw: float, upward: bool) -> None:
    signal = Signal("S", 4, 0, 32, real=True)
    found = _tighter_real(raw, 32, upward)
    assert found >= raw if upward else found <= raw
    assert signal.raw(signal.insert(bytes(4), signal.pack(found))) == found
    assert abs(found - raw) <= 2e-7 * abs(raw) + 1e-38


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("width", [32, 64])
def test_no_target_is_not_a_number(width: int, value: float) -> None:
    with pytest.raises(ValueError, match="is not a finite number"):
        Signal("S", 8, 0, width, real=True).pack(value)


@cache
def motor() -> Wiring:
    return bind(MOTOR_MAP, read(HEAD + MOTOR))


class Motor(RuleBasedStateMachine):
    """A motor is ordered about; an independent decoder looks at every frame.

    Attributes:
        order: The order in force.
        due: Whether the message that only `reset` names is still to be sent.
    """

    @initialize()
    def begin(self) -> None:
        self.channel = DbcChannel(motor(), "the motor")
        self.channel.set_cycle(0.001)
        self.database = cantools.database.load_string(HEAD + MOTOR, database_format="dbc")
        self.order, self.due, self.target, self.now = "disable", False, 0, 0

    @rule(name=st.sampled_from(["disable", "stop", "reset"]))
    def give(self, name: str) -> None:
        self.channel.order(getattr(motor(), name))
        self.order, self.due = name, name == "reset"

    @rule(state=st.sampled_from(list(motor().enable)), hold=st.booleans())
    def enable(self, state: ServoState, hold: bool) -> None:
        self.channel.order(motor().enable[state], hold=hold)
        self.order, self.due = state.value, False

    @rule(bits=st.integers(0, 0xFFFF))
    def aim(self, bits: int) -> None:
        self.channel.aim(bits)
        self.target = bits

    @rule(
        identifier=st.sampled_from([REPLY, ERROR]),
        data=st.one_of(st.binary(max_size=8), st.just(b"\1" + bytes(5)), st.just(b"\0\0")),
    )
    def hear(self, identifier: int, data: bytes) -> None:
        self.channel.receive(self.channel.slots[identifier], data, self.now)

    @rule(all_now=st.booleans())
    def send(self, all_now: bool) -> None:
        self.now += 1_000_000
        self.channel.begin(self.now)
        sent = list(self.channel.frames(all_now=all_now))
        assert [identifier for identifier, _ in sent] == [COMMAND] + self.due * [CLEAR]
        self.due = False
        data = sent[0][1]
        if self.order == ServoState.OPERATION_ENABLED.value:
            values = self.database.decode_message(COMMAND, data, scaling=False)
            assert values == {
                "Pos": self.target, "Vel": 2250, "Kp": 800, "Kd": 800, "Torque": 2048
            }  # fmt: skip
        else:
            assert data == (ENABLE if self.order == "switch on disabled" else DISABLE)
        for identifier, found in sent[1:]:
            assert self.database.decode_message(identifier, found) == {"What": 7}

    @rule()
    def settle(self) -> None:
        channel = self.channel
        held = channel._holding
        stopped = held and channel.state is not ServoState.OPERATION_ENABLED
        try:
            channel.settle()
        except DriveFault:
            assert stopped
        if stopped:
            self.order, self.due = "disable", False

    @invariant()
    def stop_frame_takes_the_power_off(self) -> None:
        if hasattr(self, "channel"):
            assert self.channel.stop_frame() == (COMMAND, DISABLE)


Motor.TestCase.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
TestMotor = Motor.TestCase

words = st.sampled_from(
    [
        *("Command.Pos", "Command.Torque", "Command.Nothing", "Reply.Pos", "Reply.State"),
        *("Clear.What", "Error.Code", "Nowhere.At", "Nodot", "", ".", "Command."),
    ]
)
values = st.one_of(st.integers(-(1 << 70), 1 << 70), st.floats(), st.sampled_from(["OFF", ""]))
assigned = st.dictionaries(words, values, max_size=4)
quantity = st.builds(
    Quantity,
    words,
    scale=st.floats(),
    sign=st.sampled_from([1, -1]),
    offset=st.floats(allow_nan=False, allow_infinity=False),
)
guard = st.builds(
    Protection,
    counter=st.sampled_from([None, "Pos", "What", "Nothing"]),
    checksum=st.sampled_from([None, "State", "Torque", ""]),
    period_ms=st.one_of(st.none(), st.floats(allow_nan=False, allow_infinity=False)),
    remote=st.booleans(),
)
whole = st.builds(Quantity, words)


@settings(max_examples=300, deadline=None)
@given(
    target=st.one_of(st.just(MOTOR_MAP.target), whole, quantity),
    offset=st.one_of(st.none(), whole, quantity),
    inputs=st.dictionaries(
        st.sampled_from([field.name for field in dataclasses.fields(MOTOR_MAP.inputs)]),
        st.one_of(whole, quantity),
        max_size=3,
    ),
    reset=st.one_of(st.just(MOTOR_MAP.orders.reset), assigned),
    running=st.one_of(st.just(MOTOR_MAP.orders.enable["running"]), assigned),
    stop=st.one_of(
        st.just(MOTOR_MAP.stop_frame),
        st.builds(StopFrame, st.sampled_from(["Command", "Clear", "Reply", "X"]), assigned),
    ),
    messages=st.dictionaries(st.sampled_from(["Command", "Clear", "Error", "X"]), guard),
    states=st.dictionaries(
        st.sampled_from(["disabled", "running", "fault"]), st.tuples(values), max_size=3
    ),
)
def test_a_map_binds_or_is_refused_with_its_places(
    target: Quantity,
    offset: Quantity | None,
    inputs: dict[str, Quantity],
    reset: dict[str, str | int | float],
    running: dict[str, str | int | float],
    stop: StopFrame,
    messages: dict[str, Protection],
    states: dict[str, tuple[str | int]],
) -> None:
    spec: DbcMap = replace(
        ordered(reset=reset, enable={"disabled": special(0xFC), "running": running}),
        target=target,
        torque_offset=offset,
        inputs=replace(MOTOR_MAP.inputs, **inputs),
        stop_frame=stop,
        messages=messages,
        status=replace(MOTOR_MAP.status, states={**MOTOR_MAP.status.states, **states}),
    )
    try:
        wiring = bind(spec, LAYOUTS)
    except DbcMapError as error:
        refused = error.problems
    else:
        refused = ()
    if refused:
        assert all(place and text for place, text in refused)
        return
    channel = DbcChannel(wiring, "the motor")
    sizes = {layout.identifier: layout.size for layout in LAYOUTS.values()}
    for order in (wiring.disable, wiring.reset, *wiring.enable.values(), wiring.stop):
        channel.order(order)
        assert all(len(data) == sizes[found] for found, data in channel.frames(all_now=True))
    assert len(channel.stop_frame()[1]) == wiring.stop_message.size


LAYOUTS = read(HEAD + MOTOR)
