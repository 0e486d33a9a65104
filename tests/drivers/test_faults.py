"""Every fault of wire, sensor and drive does what its name says."""

import math

import pytest

from drivers.clock import SimulatedClock
from drivers.epos.frames import ERROR, FrameDecoder, Opcode, encode
from drivers.errors import DriveFault, LinkError, ObjectAccessError, StateError
from drivers.interfaces import ServoState
from drivers.mock import faults as sensor_faults
from drivers.mock.faults import FOR_GOOD, GENERAL_ERROR, LineFaults, WireFaults
from drivers.mock.power_state import POWERED, State
from drivers.mock.wires.bus import SimulatedBus, SteppedClock
from drivers.mock.wires.serial_line import SimulatedLine

from .host import Host, enabled, prepared


class Wire:
    """A bus with the host, one device, and faults between them."""

    def __init__(self) -> None:
        self.clock = SimulatedClock()
        self.bus = SimulatedBus(self.clock)
        self.device = self.bus.attach()
        self.faults = WireFaults(self.bus, self.clock)
        self.heard: list[tuple[float, bytes]] = []
        self.device.listen(
            0x123, lambda data: self.heard.append((self.clock.now_ns() * 1e-9, data))
        )

    def from_host(self, *contents: bytes) -> list[bytes]:
        for data in contents:
            self.bus.transmit(0x123, data)
        self.clock.sleep_until_ns(self.clock.now_ns() + 1_000_000_000)
        return [data for _, data in self.heard]

    def from_device(self, *contents: bytes) -> list[bytes]:
        for data in contents:
            self.device.send(0x181, data)
        self.clock.sleep_until_ns(self.clock.now_ns() + 1_000_000_000)
        return [frame.data for frame in self.bus.collect(0.0)]


@pytest.fixture
def wire():
    made = Wire()
    yield made
    made.bus.shutdown()


def anything(_identifier: int, _host: bool) -> bool:
    return True


@pytest.mark.parametrize("direction", ["from_host", "from_device"])
@pytest.mark.parametrize(
    ("fault", "sent", "arrive"),
    [
        (lambda faults: faults.lose(anything, 2), (b"1", b"2", b"3"), [b"3"]),
        (lambda faults: faults.lose(lambda i, _: i == 0x99, FOR_GOOD), (b"1",), [b"1"]),
        (lambda faults: faults.lose(lambda i, host: host is (i == 0x181), 1), (b"1",), [b"1"]),
        (lambda faults: faults.repeat(anything, 1), (b"1",), [b"1", b"1"]),
        (lambda faults: faults.delay(anything, 1, 0.25), (b"1", b"2"), [b"2", b"1"]),
        (lambda faults: faults.flip(anything, 2, 9), (b"\0\0", b"\0", b"\0\0"),
         [b"\0\x02", b"\0", b"\0\0"]),
        (lambda faults: faults.shorten(anything, 1), (b"12", b"34"), [b"1", b"34"]),
    ],
    ids=["lost", "others lost", "other way lost", "repeated", "late", "flipped", "short"],
)  # fmt: skip
def test_frames_are_spoiled_as_often_as_asked_and_no_others(wire, direction, fault, sent, arrive):
    fault(wire.faults)
    assert getattr(wire, direction)(*sent) == arrive


def test_a_late_frame_of_a_host_that_left_the_bus_is_lost(wire: Wire) -> None:
    wire.faults.delay(anything, 1, 0.25)
    wire.bus.transmit(0x123, b"1")
    wire.clock.sleep_until_ns(100_000_000)
    wire.faults.bus_off(None)
    wire.clock.sleep_until_ns(1_000_000_000)
    assert wire.heard == []


def test_bus_off_is_deaf_and_dumb_until_it_ends(wire: Wire) -> None:
    wire.faults.bus_off(5.0)
    with pytest.raises(Exception, match="bus-off"):
        wire.bus.transmit(0x123, b"1")
    assert wire.from_device(b"1") == []
    wire.clock.sleep_until_ns(5_000_000_000)
    assert wire.from_device(b"2") == [b"2"]
    assert wire.from_host(b"3") == [b"3"]


def test_refused_sdo_requests_name_the_object(host: Host) -> None:
    faults = WireFaults(host.bench.bus, host.clock)
    faults.refuse_sdo(host.bench.drive.node_id, 1)
    with pytest.raises(ObjectAccessError, match=r"6041h:00h: .*08000000h"):
        host.drive.read(0x6041)
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED


def test_a_restarted_drive_has_no_power_and_is_noticed(host: Host) -> None:
    enabled(host)
    WireFaults(host.bench.bus, host.clock).restart(host.bench.drive.node_id)
    with pytest.raises(LinkError, match="restarted"):
        host.cycles(10)
    assert host.bench.drive.power_state is State.SWITCH_ON_DISABLED


def joint(host: Host) -> int:
    """Counts of the joint encoder in the next cycle whose answer is whole (a heartbeat may take its
    place).
    """
    host.cycles(1)
    while not host.encoder.sample().fresh:
        host.cycles(1)
    return round(host.encoder.sample().angle_rad * 262144 / math.tau)


def test_encoder_faults(host: Host) -> None:
    enabled(host)
    device = host.bench.encoder
    host.cycles(300, lambda t: min(0.1 * t, 0.02))
    true = joint(host)
    assert abs(true) > 500
    sensor_faults.flip_bit(device, 10, 2)
    assert [abs(joint(host) - true) > 900 for _ in range(4)][::3] == [True, False]
    sensor_faults.flip_bit(device, 10, FOR_GOOD)
    assert all(abs(joint(host) - true) > 900 for _ in range(20))
    sensor_faults.jump(device, 5000)
    assert joint(host) == pytest.approx(true + 5000, abs=20)
    sensor_faults.reverse(device)
    assert joint(host) == pytest.approx(-true, abs=20)
    sensor_faults.freeze(device)
    held = joint(host)
    host.cycles(200, lambda t: 0.02 + min(0.1 * t, 0.02))
    assert joint(host) == held
    device.distort = None
    assert joint(host) > 1.5 * true


def test_a_refused_mode_stops_the_way_to_power(host: Host) -> None:
    prepared(host)
    sensor_faults.refuse_mode(host.bench.drive)
    with pytest.raises(StateError, match="6061h still reads 0"):
        host.servo.enable()
    assert host.bench.drive.power_state is State.SWITCH_ON_DISABLED
    assert True not in host.powered


@pytest.mark.parametrize(
    "words", [[], [0x06], [0x06, 0x07], [0x06, 0x07, 0x0F], [0x06, 0x07, 0x0F, 0x02]]
)
def test_a_fault_in_every_state_ends_in_fault_without_power(host: Host, words: list[int]) -> None:
    prepared(host)
    host.drive.write(0x605A, 0, 6)
    for word in words:
        host.drive.write(0x6040, 0, word)
    entered: list[State] = []
    drive = host.bench.drive
    drive.entered.append(entered.append)
    powered = drive.power_state in POWERED
    drive.fail(0x7320)
    assert drive.power_state is (State.FAULT_REACTION if powered else State.FAULT)
    drive.fail(0x4310)
    host.wait(0.1)
    assert entered[-1] is State.FAULT
    assert not host.powered or not host.powered[-1]
    assert host.drive.read(0x603F) == 0x4310
    with pytest.raises(DriveFault):
        host.servo.enable()


def test_a_stepped_clock_waits_as_long_as_was_asked() -> None:
    base = SimulatedClock()
    clock = SteppedClock(base)
    clock.step(2.0)
    assert clock.now_ns() == 2_000_000_000
    clock.sleep_until_ns(2_500_000_000)
    assert base.now_ns() == 500_000_000
    clock.step(-3.0)
    clock.sleep_until_ns(0)
    assert base.now_ns() == 1_000_000_000


@pytest.mark.parametrize("length", [0, 7])
@pytest.mark.parametrize("identifier", [0x081, 0x181, 0x281, 0x581, 0x701])
def test_a_frame_of_the_wrong_length_updates_nothing_and_raises_nothing(host, identifier, length):
    prepared(host)
    host.cycles(3)
    before = [slot.values for slot in host.drive.inputs.values()]
    host.bench.bus.attach().send(identifier, bytes(length))
    assert not host.link.pump(lambda: False, 0.0005)
    assert [slot.values for slot in host.drive.inputs.values()] == before
    host.cycles(3)


class Line:
    """A serial line with an station that answers every request."""

    def __init__(self) -> None:
        self.clock = SimulatedClock()
        self.heard: list[tuple[float, bytes]] = []
        self.line = SimulatedLine(self.clock, 1_000_000, self)
        self.faults = LineFaults(self.line, self.clock)

    def receive(self, data: bytes) -> bytes:
        if data:
            self.heard.append((round(self.clock.now_ns() * 1e-9, 6), data))
        return ANSWER if data else b""

    def ask(self, *requests: bytes) -> list[bytes]:
        answers = []
        for request in requests:
            self.line.write(request)
            self.clock.sleep_until_ns(self.clock.now_ns() + 1_000_000)
            answers.append(self.line.read(0.0))
        return answers


ANSWER = encode(Opcode.ANSWER, ERROR.pack(0) + b"\x11\x22\x33\x44")


def test_messages_of_a_line_are_lost_one_way_or_both() -> None:
    line = Line()
    line.faults.lose(True, 1)
    line.faults.lose(False, 1)
    assert line.ask(b"ab", b"cd", b"ef") == [b"", b"", ANSWER]
    assert [data for _, data in line.heard] == [b"cd", b"ef"]


def test_a_spoiled_answer_is_dropped_by_the_decoder_and_the_next_is_found() -> None:
    line = Line()
    line.faults.flip(False, 1, 37)
    line.faults.drop_byte(False, 1, 5)
    line.faults.break_stuffing(False, 1)
    decoder = FrameDecoder()
    found = [decoder.feed(answer) for answer in line.ask(b"1", b"2", b"3", b"4")]
    assert [len(frames) for frames in found] == [0, 0, 0, 1]
    assert decoder.bad == 3


def test_what_is_late_on_a_line_holds_up_what_is_behind_it() -> None:
    line = Line()
    line.faults.delay(True, 1, 0.005)
    line.ask(b"1", b"2")
    line.clock.sleep_until_ns(10_000_000)
    assert line.heard == [(0.00501, b"1"), (0.00501, b"2")]


def test_a_repeated_request_is_heard_twice_and_a_refused_one_never() -> None:
    line = Line()
    line.faults.repeat(True, 1)
    line.faults.refuse(1)
    _, refusal = line.ask(b"1", b"2")
    assert [data for _, data in line.heard] == [b"11"]
    (frame,) = FrameDecoder().feed(refusal)
    assert ERROR.unpack_from(frame.data) == (GENERAL_ERROR,)


@pytest.mark.parametrize(("for_s", "heard"), [(0.0015, [b"3"]), (None, [])])
def test_a_line_is_cut_for_a_time_or_for_good(for_s: float | None, heard: list[bytes]) -> None:
    line = Line()
    line.faults.cut(for_s)
    line.ask(b"1", b"2", b"3")
    assert [data for _, data in line.heard] == heard
