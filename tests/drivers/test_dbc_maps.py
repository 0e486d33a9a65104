"""Checksums and values of signals, and orders in any sequence, against cantools."""

import tempfile
from functools import cache
from pathlib import Path

import cantools.database
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from drivers.dbc.bind import bind
from drivers.dbc.channel import DbcChannel
from drivers.dbc.codec import (
    CHECKSUMS,
    Signal,
    Wiring,
    checksum_of,
    crc8_autosar,
    crc8_j1850,
    sum8,
    xor8,
)
from drivers.dbc.file import Layout, read_dbc
from drivers.dbc.limits import _tighter_real
from drivers.errors import DriveFault
from drivers.interfaces import ServoState

from .dbc_texts import HEAD, MOTOR, MOTOR_MAP

COMMAND, REPLY, CLEAR, ERROR = 1, 2, 3, 4
DISABLE, ENABLE = bytes.fromhex("fffffffffffffffd"), bytes.fromhex("fffffffffffffffc")


def read(text: str) -> dict[str, Layout]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "x.dbc")
        path.write_text(text)
        return read_dbc(path)


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


def test_checksums_have_their_published_check_values() -> None:
    text = b"123456789"
    assert (crc8_j1850(text), crc8_autosar(text)) == (0x4B, 0xDF)
    assert (sum8(text), xor8(text)) == (0xDD, 0x31)


@pytest.mark.parametrize("kind", sorted(CHECKSUMS))
@settings(max_examples=40)
@given(data=st.binary(min_size=1, max_size=8), bit=st.integers(0, 63))
def test_a_checksum_sees_every_single_bit(kind: str, data: bytes, bit: int) -> None:
    flipped = (int.from_bytes(data, "big") ^ 1 << bit % (8 * len(data))).to_bytes(len(data), "big")
    assert CHECKSUMS[kind](data) != CHECKSUMS[kind](flipped)


@pytest.mark.parametrize("motorola", [False, True])
@pytest.mark.parametrize("byte", [0, 3])
@settings(max_examples=20, deadline=None)
@given(data=st.binary(min_size=4, max_size=4), prefix=st.binary(max_size=3))
def test_a_checksum_covers_its_prefix_and_all_other_bytes(motorola, byte, data, prefix):
    shift = 8 * (3 - byte if motorola else byte)
    signal = Signal("C", 4, shift, 8, motorola)
    rest = data[:byte] + data[byte + 1 :]
    zeroed = data[:byte] + b"\0" + data[byte + 1 :]
    for kind, algorithm in CHECKSUMS.items():
        assert checksum_of(kind, signal, prefix)(data) == algorithm(prefix + zeroed)
        assert checksum_of(kind, signal, prefix, left_out=True)(data) == algorithm(prefix + rest)


def test_crc8_j1850_beside_its_byte() -> None:
    """The check value of the catalogue of CRCs, over the digits 1 to 9."""
    signal = Signal("C", 8, 56, 8)
    crc = checksum_of("crc8_j1850", signal, b"12", left_out=True)
    assert crc(b"3456789\xee") == crc8_j1850(b"123456789") == 0x4B


@cache
def motor() -> Wiring:
    return bind(MOTOR_MAP, read(HEAD + MOTOR))


class Motor(RuleBasedStateMachine):
    """A motor is ordered about; an independent decoder looks at every frame."""

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


Motor.TestCase.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)
TestMotor = Motor.TestCase
