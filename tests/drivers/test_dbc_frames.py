"""29-bit identifiers, pages of a message, remote frames, drives that report less."""

import math
import struct
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import can
import pytest

from drivers.can.port import EXTENDED_FLAG, REMOTE_FLAG, PythonCanPort
from drivers.can.slcan import LineDecoder, encode
from drivers.clock import NS, SimulatedClock
from drivers.dbc.codec import BoundQuantity, Signal
from drivers.dbc.limits import DbcDrive
from drivers.dbc.link import DbcLink
from drivers.dbc.map import DbcMap, LimitMap, LimitSignals, Protection, Quantity
from drivers.dbc.servo import DbcServo, Feedback
from drivers.errors import ConfigurationError
from drivers.interfaces import Identity, RawFrame, ServoLimits, ServoState

from .dbc_texts import MOTOR, MOTOR_MAP, wired

CYCLE_S = 0.001
REPLY, ERROR = 2, 4
LONG = MOTOR.replace("BO_ 2 ", "BO_ 2566844674 ").replace("BO_ 1 ", "BO_ 2566844673 ")
"""The same motor with 29-bit identifiers: 18FEF101h for the command and 18FEF102h for the reply."""
PAGED = MOTOR.replace(
    ' SG_ Code : 0|16@1+ (1,0) [0|0] "" A\n',
    ' SG_ Page M : 0|8@1+ (1,0) [0|0] "" A\n SG_ Code m3 : 8|8@1+ (1,0) [0|0] "" A\n'
    ' SG_ Volt m4 : 8|8@1+ (1,0) [0|0] "" A\n',
)
HELD = ServoLimits(-0.5, 0.5, 2.0, 60.0, 20.0, 0.02, 2, 35.0)
DRIVE = DbcDrive(Identity("motor", 1, 2, 3, 4), HELD, 1.0, 0.1, 0.0, 0.1)


class Wire:
    """A bus with a motor on it."""

    def __init__(self, clock: SimulatedClock) -> None:
        self.clock = clock
        self.sent: list[tuple[int, bytes]] = []
        self.answers: dict[int, Callable[[bytes], list[tuple[int, bytes]]]] = {}
        self.lost = 0
        self._waiting: deque[RawFrame] = deque()

    def transmit(self, identifier: int, data: bytes) -> None:
        self.sent.append((identifier, data))
        for found, answer in self.answers.get(identifier, lambda _: [])(data):
            if self.lost:
                self.lost -= 1
            else:
                self._waiting.append(RawFrame(self.clock.now_ns(), found, answer, False))

    def say(self, identifier: int, data: bytes) -> None:
        self._waiting.append(RawFrame(self.clock.now_ns(), identifier, data, False))

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        if not self._waiting:
            self.clock.sleep_until_ns(self.clock.now_ns() + round(timeout_s * NS))
            return []
        frames = list(self._waiting)
        self._waiting.clear()
        return frames

    def shutdown(self) -> None:
        pass


def motor(
    folder: Path, spec: DbcMap = MOTOR_MAP, text: str = MOTOR
) -> tuple[Wire, DbcLink, DbcServo]:
    clock = SimulatedClock(5 * NS)
    wire = Wire(clock)
    link = DbcLink(clock, lambda: wire)
    servo = DbcServo(link, link.add_channel(wired(folder, spec, text), "the motor"), DRIVE)
    link.open()
    return wire, link, servo


def reply(state: int = 0, position: int = 31250) -> bytes:
    return bytes([state]) + position.to_bytes(2, "big") + bytes.fromhex("8ca800")


def answering(wire: Wire, command: int, found: int) -> None:
    """Let the motor obey: FCh at the end enables, FDh disables."""
    state = [0]

    def answer(data: bytes) -> list[tuple[int, bytes]]:
        if data[:7] == b"\xff" * 7:
            state[0] = {0xFC: 1, 0xFD: 0}[data[7]]
        return [(found, reply(state[0])), (ERROR, b"\0\0")]

    wire.answers[command] = answer


@pytest.mark.parametrize("flags", [0, EXTENDED_FLAG, REMOTE_FLAG, EXTENDED_FLAG | REMOTE_FLAG])
def test_the_flags_of_an_identifier_reach_the_bus(flags: int) -> None:
    number, data = (0x18FEF101 if flags & EXTENDED_FLAG else 0x123), b""
    clock = SimulatedClock(0)
    with (
        can.Bus(interface="virtual", channel="flags") as near,
        can.Bus(interface="virtual", channel="flags") as far,
    ):
        PythonCanPort(near, clock).transmit(number | flags, data)
        message = far.recv(1.0)
        assert message.arbitration_id == number
        assert message.is_extended_id is bool(flags & EXTENDED_FLAG)
        assert message.is_remote_frame is bool(flags & REMOTE_FLAG)
        far.send(message)
        (frame,) = PythonCanPort(near, clock).collect(1.0)
    assert frame.identifier == number | flags
    assert LineDecoder().feed(encode(number | flags, data)) == [(number | flags, data)]


def test_a_drive_with_long_identifiers_is_enabled_and_disabled(tmp_path: Path) -> None:
    wire, link, servo = motor(tmp_path, text=LONG)
    answering(wire, 0x18FEF101 | EXTENDED_FLAG, 0x18FEF102 | EXTENDED_FLAG)
    servo.prepare(CYCLE_S)
    servo.enable()
    assert link.take_frames()
    servo.disable()
    assert servo.state() is ServoState.SWITCH_ON_DISABLED
    link.close()
    assert {identifier for identifier, _ in wire.sent if identifier != 0x080} <= {
        0x18FEF101 | EXTENDED_FLAG, 0x77F
    }  # fmt: skip


def test_each_page_keeps_its_own_value(tmp_path: Path) -> None:
    spec = replace(
        MOTOR_MAP,
        inputs=replace(
            MOTOR_MAP.inputs,
            fault_code=replace(MOTOR_MAP.target, signal="Error.Code"),
            supply_voltage=replace(MOTOR_MAP.target, signal="Error.Volt"),
        ),
    )
    wire, link, _ = motor(tmp_path, spec, PAGED)
    channel = link.add_channel(wired(tmp_path, spec, PAGED), "another")
    feedback, error = Feedback(link, channel), channel.slots[ERROR]
    for data in (b"\3\7", b"\4\x18", b"\5\xff"):
        channel.receive(error, data, 0)
    assert (channel.fault_code, feedback.value("supply_voltage")) == (7, 24.0)
    channel.receive(error, b"\3\0", 0)
    assert (channel.fault_code, feedback.value("supply_voltage")) == (0, 24.0)
    assert wire.sent == []


def test_a_page_that_stops_coming_makes_samples_stale(tmp_path: Path) -> None:
    spec = replace(
        MOTOR_MAP,
        inputs=replace(
            MOTOR_MAP.inputs,
            fault_code=None,
            supply_voltage=replace(MOTOR_MAP.target, signal="Error.Volt"),
        ),
        status=replace(MOTOR_MAP.status, states={**MOTOR_MAP.status.states, "fault": (9,)}),
    )
    channel = motor(tmp_path, spec, PAGED)[1].add_channel(wired(tmp_path, spec, PAGED), "another")
    channel.set_cycle(CYCLE_S)
    fresh = []
    for cycle in range(12):
        now = cycle * NS // 1000
        channel.begin(now)
        channel.receive(channel.slots[REPLY], reply(), now)
        page = (3, 4)[cycle % 2] if cycle < 5 else 3
        channel.receive(channel.slots[ERROR], bytes([page, 24]), now)
        fresh.append(channel.fresh)
    # Page 4 comes last in cycle 3; it is due every second cycle, and may be late by two more.
    assert fresh == [False] + 8 * [True] + 3 * [False], fresh


def test_a_message_is_asked_for_by_remote_frames(tmp_path: Path) -> None:
    spec = replace(MOTOR_MAP, messages={"Error": Protection(remote=True, period_ms=4)})
    wire, link, servo = motor(tmp_path, spec)
    answering(wire, 1, REPLY)
    wire.answers[1], answer = (lambda data: answer(data)[:1]), wire.answers[1]
    request = ERROR | REMOTE_FLAG
    wire.answers[request] = lambda _: [(ERROR, b"\5\0")]
    wire.lost = 1
    assert servo.state() is ServoState.FAULT
    asked = [data for identifier, data in wire.sent if identifier == request]
    assert asked == [b"", b""]  # The first answer was lost.
    assert servo.fault().code == 5
    wire.answers[request] = lambda _: [(ERROR, b"\0\0")]
    servo.reset_fault()
    servo.prepare(CYCLE_S)
    wire.sent.clear()
    for _ in range(20):
        link.exchange()
    assert [identifier for identifier, _ in wire.sent].count(request) == 5


@pytest.mark.parametrize("verb", ["disable", "quick_stop"])
def test_a_silent_drive_is_asked_with_its_disable_order(tmp_path: Path, verb: str) -> None:
    wire, _, servo = motor(tmp_path)
    answering(wire, 1, REPLY)
    assert servo.state() is ServoState.SWITCH_ON_DISABLED
    assert {data.hex() for _, data in wire.sent} == {"fffffffffffffffd"}
    servo.prepare(CYCLE_S)
    servo.enable()
    assert servo.state() is ServoState.OPERATION_ENABLED
    getattr(servo, verb)()
    assert servo.state() is ServoState.SWITCH_ON_DISABLED


def test_a_torque_offset_needs_its_signal(tmp_path: Path) -> None:
    _, _, servo = motor(tmp_path)
    with pytest.raises(ConfigurationError, match="has no torque offset"):
        servo.set_torque_offset(1.0)
    enable = {
        "disabled": MOTOR_MAP.orders.enable["disabled"],
        "running": {"Command.Kp": 800, "Command.Kd": 800},
    }
    spec = replace(
        MOTOR_MAP,
        orders=replace(MOTOR_MAP.orders, enable=enable),
        torque_offset=replace(MOTOR_MAP.target, signal="Command.Torque"),
    )
    wire, link, servo = motor(tmp_path, spec)
    answering(wire, 1, REPLY)
    servo.prepare(CYCLE_S)
    servo.enable()
    servo.set_torque_offset(2.0)
    link.exchange()
    assert wire.sent[-2][1][6:].hex()[1:] == f"{2048 + 200:03x}"
    with pytest.raises(ConfigurationError, match=r"Torque = 50 is outside -20\.48 to 20\.47"):
        servo.set_torque_offset(50.0)
    servo.disable()
    link.close()
    assert wire.sent[-1] == (1, bytes.fromhex("fffffffffffffffd"))


@pytest.mark.parametrize(("signed", "low"), [(False, 0), (True, -2048)])
def test_a_target_that_wraps_stays_in_the_range_of_its_signal(signed: bool, low: int) -> None:
    gain = math.tau / 4096
    target = BoundQuantity("M", Signal("T", 2, 0, 12, signed=signed), gain, 0.0, math.tau)
    for counts in range(-9000, 9000, 7):
        bits = target.bits((counts + 0.4) * gain)
        raw = bits - 4096 if signed and bits > 2047 else bits
        assert low <= raw < low + 4096
        assert (raw - counts) % 4096 == 0
    assert target.bits(4095.7 * gain) == 0


def test_a_position_that_wraps_is_followed_over_the_jump(tmp_path: Path) -> None:
    turn = 65536 * 0.0004
    spec = replace(
        MOTOR_MAP,
        inputs=replace(MOTOR_MAP.inputs, position=Quantity("Reply.Pos", wraps_after=turn, sign=-1)),
    )
    wire, link, servo = motor(tmp_path, spec)
    answering(wire, 1, REPLY)
    seen = []
    for counts in (60000, 65000, 5000, 20000, 40000, 60000, 3000, 63000):
        wire.answers[1] = lambda _, at=counts: [(REPLY, reply(0, at)), (ERROR, b"\0\0")]
        seen.append(servo.readings().motor_angle_rad)
    steps = [round((b - a) / 0.0004) for a, b in pairwise(seen)]
    assert seen[0] == pytest.approx(-(60000 * 0.0004 - 12.5))
    assert steps == [-5000, -5536, -15000, -20000, -20000, -8536, 5536]
    link.close()


def test_a_limit_that_is_not_reported_is_written_and_held_by_the_program_alone(tmp_path):
    text = MOTOR + (
        '\nBO_ 5 Limits: 8 A\n SG_ Speed : 0|32@1- (1,0) [0|0] "rad/s" B\n'
        ' SG_ Current : 32|32@1+ (0.5,0) [0|0] "A" B\n\nSIG_VALTYPE_ 5 Speed : 1;\n'
    )
    limits = LimitMap(
        speed=LimitSignals(Quantity("Limits.Speed")),
        current=LimitSignals(Quantity("Limits.Current")),
    )
    wire, _, servo = motor(tmp_path, replace(MOTOR_MAP, limits=limits), text)
    servo.write_limits(replace(HELD, speed_rad_s=1.7, torque_N_m=1.03, current_A=50.0))
    ((identifier, data),) = wire.sent
    speed, current = struct.unpack("<fI", data)
    assert identifier == 5
    assert 1.69999 < speed <= 1.7
    assert current == 20  # 10.3 A for the torque, never more.
    assert servo.read_limits() == HELD
    assert servo.limits_taken == frozenset()
    assert servo.limit_places["speed_rad_s"] == "Limits.Speed, written but not reported"
