from itertools import count
from unittest.mock import Mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.canopen.cia402 import CONTROLWORD
from drivers.epos.frames import DLE, Frame, FrameDecoder, Opcode, cycle_bits, encode
from drivers.errors import LinkError, StateError
from drivers.mock.canopen.dictionary import key
from drivers.mock.plant.machine import Reading
from drivers.mock.power_state import State
from drivers.objects import ObjectAddress

from .contract import enabled, prepared
from .serial_host import SerialHost, make_serial_host


def requests(host: SerialHost) -> list[Frame]:
    """Return what the host asked since the last call."""
    sent = b"".join(f.data for f in host.epos.take_frames() if f.sent)
    return FrameDecoder().feed(sent)


@pytest.fixture
def host(serial: SerialHost) -> SerialHost:
    return serial


def test_a_text_comes_in_segments(host: SerialHost) -> None:
    long = "x" * 700
    host.bench.drive.objects.texts[0x1008 << 8] = long
    assert host.drive.read_text(0x1008) == long


def test_a_cycle_is_five_objects_and_fits_eighty_percent(host: SerialHost) -> None:
    enabled(host)
    host.cycles(10)
    host.link.take_frames()
    clock = host.bench.clock
    due = clock.now_ns() + 2_000_000
    clock.sleep_until_ns(due)
    host.link.exchange()
    assert clock.now_ns() - due <= 0.8 * 2_000_000
    assert [frame.opcode for frame in requests(host)] == [0x68, 0x60, 0x60, 0x60, 0x60]


def test_the_others_take_turns(host: SerialHost) -> None:
    prepared(host)
    host.cycles(1)
    host.epos.take_frames()
    host.cycles(6)
    read = [int.from_bytes(data[1:3], "little") for op, data in requests(host) if op == 0x60]
    assert set(read[0::4]) == {0x6041}
    assert sorted(read[3::4]) == sorted([0x606C, 0x606C, 0x2100, 0x2100, 0x6079, 0x2101])


def test_the_controlword_goes_out_when_it_changes_only(host: SerialHost) -> None:
    enabled(host)
    host.cycles(1)
    host.epos.take_frames()
    host.cycles(5)
    host.servo.quick_stop()
    host.cycles(5)
    word = CONTROLWORD[0].to_bytes(2, "little")
    words = [data[4] for op, data in requests(host) if op == 0x68 and data[1:3] == word]
    assert words == [0x02, 0x02]


def corrupt(host: SerialHost, first: int, last: int) -> list[int]:
    """Spoil the answers numbered ``first`` to ``last`` - 1 from now on; returns a counter."""
    seen = [0]

    def spoil(_now: int, data: bytes, from_host: bool) -> bytes:
        if from_host:
            return data
        seen[0] += 1
        return data[:-1] + bytes([data[-1] ^ 1]) if first <= seen[0] - 1 < last else data

    host.line.filters.append(spoil)
    return seen


def test_a_bad_answer_updates_nothing_and_the_next_cycle_is_whole(host: SerialHost) -> None:
    enabled(host)
    host.cycles(200, lambda t: 0.2 * t)
    before = host.servo.sample()
    corrupt(host, 1, 2)
    host.cycles(1, lambda t: 0.1)
    lost = host.servo.sample()
    assert not lost.fresh
    assert host.encoder.sample().fresh
    assert lost[1:6] == before[1:6]
    assert lost.statusword == before.statusword
    host.cycles(1, lambda t: 0.1)
    assert host.servo.sample().fresh
    assert host.epos.lost == 1


def test_a_late_answer_is_not_taken_for_the_next(host: SerialHost) -> None:
    enabled(host)
    host.cycles(50, lambda t: 0.2 * t)
    held: list[bytes] = []

    def delay(_now: int, data: bytes, from_host: bool) -> bytes:
        if from_host:
            return data
        held.append(data)
        # One answer late from here on, as an adapter with a full buffer would be.
        return b"" if len(held) == 1 else held[-2] + data if len(held) == 2 else data

    host.line.filters.append(delay)
    host.cycles(1)
    assert not host.servo.sample().fresh
    for _ in range(5):
        host.cycles(1)
        sample = host.servo.sample()
        assert sample.fresh
        assert sample.statusword & 0x6F == 0x27
        assert abs(sample.motor_angle_rad / 100.0 - host.bench.machine.truth().angle_rad) < 1e-3


def test_an_answer_that_was_not_awaited_is_not_taken_for_the_next(host: SerialHost) -> None:
    prepared(host)
    asked = [host.drive.read(0x1018, subindex) for subindex in (1, 2)]
    assert asked[0] != asked[1]
    # The guard reports its end in the wait for the first answer.
    host.epos.guard = Mock()
    host.epos.guard.feed.side_effect = [None, LinkError("the guardian has ended"), *[None] * 100]
    with pytest.raises(LinkError, match="has ended"):
        host.drive.read(0x1018, 1)
    # The answer arrives after the next request was sent.
    assert host.drive.read(0x1018, 2) == asked[1]


def test_two_frames_for_one_request_are_not_believed(host: SerialHost) -> None:
    enabled(host)
    host.cycles(5)
    alien = encode(Opcode.ANSWER, bytes(8))
    host.line.filters.append(lambda _now, data, from_host: data if from_host else data + alien)
    host.cycles(1)
    assert not host.servo.sample().fresh


def test_a_silent_drive_is_reported_as_lost(host: SerialHost) -> None:
    enabled(host)
    host.cycles(5)
    host.line.cut = True
    with pytest.raises(
        LinkError, match=r"node 1 sent no complete answer for 0\.20\d s \(limit 0\.2 s\)"
    ):
        host.cycles(150)
    host.cycles(150)
    assert not host.servo.sample().fresh
    host.line.cut = False
    host.cycles(10)
    assert host.servo.sample().fresh
    # Prepared again, it is missed again.
    host.servo.disable()
    prepared(host)
    host.line.cut = True
    with pytest.raises(LinkError, match="sent no complete answer"):
        host.cycles(150)


def test_one_lost_answer_outside_the_cycle_is_asked_for_again(host: SerialHost) -> None:
    enabled(host)
    host.cycles(5)
    corrupt(host, 0, 1)
    host.servo.disable()
    assert host.bench.drive.power_state is State.SWITCH_ON_DISABLED
    assert host.epos.lost == 1


def test_angle_position_current_and_stamp_are_of_one_instant(host: SerialHost) -> None:
    """Position and current rise evenly, so that they are known at any time."""
    enabled(host)
    drive, clock = host.bench.drive, host.bench.clock
    rate, half_cycle, began = 50.0, 1e3 * host.cycle_s / 2, clock.now_ns()  # 1/ms, ms
    asked_ms: list[float] = []
    measure, counts = drive._measure, host.amt21._counts

    def now_ms() -> float:
        return (clock.now_ns() - began) / 1e6

    def rising(reading: Reading) -> None:
        measure(reading)
        drive._values[key(0x6064)] = round(rate * now_ms())
        drive._values[key(0x6078)] = round(rate * (now_ms() - half_cycle))

    def asked() -> int:
        asked_ms.append(now_ms())
        return counts()

    drive._measure, host.amt21._counts = rising, asked  # type: ignore[method-assign]
    host.cycles(4)
    values = host.drive._values
    assert values[0x6064, 0].value == pytest.approx(rate * asked_ms[-1], abs=2.5)
    assert values[0x6078, 0].value == pytest.approx(rate * (asked_ms[-1] - half_cycle), abs=2.5)
    stamp_ms = (host.drive.sync_us * 1000 - began) / 1e6
    assert stamp_ms == pytest.approx(asked_ms[-1], abs=0.02)
    assert host.encoder.sample().device_time_s * 1e3 == pytest.approx(
        stamp_ms + began / 1e6, abs=0.02
    )


def test_the_time_stamp_begins_without_a_jump(host: SerialHost) -> None:
    host.bench.clock.sleep_until_ns(host.bench.clock.now_ns() + 7_000_000_000)
    prepared(host)
    began = host.servo.sample().device_time_s
    corrupt(host, 0, 1)
    for _ in range(3):
        host.cycles(1)
        assert 0.0 <= host.servo.sample().device_time_s - began < 0.1


def test_a_jump_of_the_position_is_not_continued() -> None:
    """The counter of 32 bits ends, the drive sets a new zero, or it moves as fast as it can."""
    host = enabled(make_serial_host(fastest_1_s=1e6))
    host.cycles(2)
    drive, slot = host.bench.drive, host.drive._values[0x6064, 0]
    measure = drive._measure
    for jump, continued in ((0, False), (1 << 31, False), (10_000, False), (1000, True)):
        wanted = (slot.before[0] + jump + (1 << 31)) % (1 << 32) - (1 << 31)

        def jumped(reading: Reading, wanted: int = wanted) -> None:
            measure(reading)
            drive._values[key(0x6064)] = wanted

        drive._measure = jumped  # type: ignore[method-assign]
        host.cycles(1)
        assert (slot.value != wanted) is continued
        host.cycles(1)


def test_nothing_is_continued_from_before_an_incomplete_cycle(host: SerialHost) -> None:
    enabled(host)
    host.cycles(200, lambda t: 0.5 * t)
    slot = host.drive._values[0x6064, 0]
    for complete in (True, False):
        if not complete:
            corrupt(host, 2, 3)
            host.cycles(1, lambda t: 0.2 + 0.5 * t)
            assert not host.servo.sample().fresh
            assert slot.before is None
        host.cycles(1, lambda t: 0.2 + 0.5 * t)
        assert host.servo.sample().fresh
        assert (slot.value != slot.before[0]) is complete


@pytest.mark.parametrize(
    ("verb", "state"),
    [("quick_stop", State.QUICK_STOP_ACTIVE), ("disable", State.SWITCH_ON_DISABLED)],
)
def test_a_stop_is_said_even_where_nobody_is_heard(host, verb, state):
    enabled(host).cycles(5)
    host.line.filters.append(lambda _now, data, from_host: data if from_host else b"")
    host.cycles(1)
    entered: list[State] = []
    host.bench.drive.entered.append(entered.append)
    with pytest.raises(LinkError, match="no correct answer"):
        getattr(host.servo, verb)()
    assert entered[0] is state


def test_nothing_else_is_said_where_nobody_is_heard(host: SerialHost) -> None:
    prepared(host)
    heard: list[bytes] = []
    host.line.filters.append(
        lambda _now, data, from_host: b"" if not from_host else heard.append(data) or data
    )
    with pytest.raises(LinkError, match="no correct answer"):
        host.drive.write(*CONTROLWORD, 0x0F)
    assert heard
    frames = [frame for data in heard for frame in FrameDecoder().feed(data)]
    assert [frame.opcode for frame in frames].count(Opcode.WRITE_OBJECT) <= 1


def test_a_drive_whose_preparation_failed_midway_cannot_be_sampled(host, monkeypatch):
    """A run samples the drive while it brakes, whatever ended the preparation."""
    node, asked = host.servo._channel, count()
    real = node._input  # type: ignore[attr-defined]

    def lost(address: ObjectAddress) -> object:
        if next(asked) > 0:
            raise LinkError("no answer")
        return real(address)

    monkeypatch.setattr(node, "_input", lost)
    with pytest.raises(LinkError):
        host.servo.prepare(host.cycle_s)
    monkeypatch.undo()
    with pytest.raises(StateError, match="prepare"):
        host.servo.sample()


def test_a_lost_port_is_opened_again_and_the_guard_is_told_meanwhile(host, monkeypatch):
    link, servo, line = host.epos, enabled(host).servo, host.line
    back: list[object] = []

    def connect() -> object:
        if not back:
            raise FileNotFoundError(2, "No such file or directory")
        return back.pop()

    def unplugged(data: bytes) -> None:
        raise OSError(5, "Input/output error")

    guard = Mock()
    link.guard, link._connect = guard, connect  # type: ignore[assignment]
    monkeypatch.setattr(line, "write", unplugged)
    # The simulated line is plugged in again below.
    monkeypatch.setattr(line, "close", lambda: None)
    with pytest.raises(LinkError, match=r"is gone: .*Input/output error"):
        servo.state()
    before = guard.feed.call_count
    for _ in range(3):
        with pytest.raises(LinkError, match=r"cannot be opened: .*No such file"):
            servo.quick_stop()
    assert guard.feed.call_count >= before + 3
    monkeypatch.undo()
    back.append(line)
    servo.quick_stop()
    servo.disable()
    assert host.bench.drive.power_state is State.SWITCH_ON_DISABLED
    assert not back
    link.close()
    with pytest.raises(LinkError, match="is not open"):
        servo.state()


READ = bytes.fromhex("90 02 60 02 01 B0 30 00 2E 62")
ANSWER = bytes.fromhex("90 02 00 04 00 00 00 00 01 90 90 00 00 9A 5C")

frames = st.builds(
    Frame,
    st.integers(0, 255),
    st.binary(max_size=510).map(lambda data: data if len(data) % 2 == 0 else data[1:]),
)
doubled = st.lists(st.sampled_from([0x90, 0x02, 0x00]), max_size=20).map(bytes)


def test_the_frames_printed_by_the_maker() -> None:
    assert encode(Opcode.READ_OBJECT, bytes.fromhex("01 B0 30 00")) == READ
    assert encode(Opcode.ANSWER, bytes.fromhex("00 00 00 00 01 90 00 00")) == ANSWER
    assert FrameDecoder().feed(READ + ANSWER) == [
        Frame(0x60, bytes.fromhex("01 B0 30 00")),
        Frame(0x00, bytes.fromhex("00 00 00 00 01 90 00 00")),
    ]


def test_odd_data_gets_a_dummy_byte() -> None:
    assert FrameDecoder().feed(encode(0x6A, b"\x01\x02\x03")) == [Frame(0x6A, b"\x01\x02\x03\x00")]


def test_too_much_data_is_refused() -> None:
    with pytest.raises(
        ValueError, match="512 bytes do not fit into a frame, which has at most 510"
    ):
        encode(0, bytes(511))


@given(st.lists(frames, max_size=4), st.data())
def test_frames_survive_any_cutting(sent: list[Frame], data: st.DataObject) -> None:
    stream = b"".join(encode(*frame) for frame in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    decoder = FrameDecoder()
    got = []
    for first, last in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        got += decoder.feed(stream[first:last])
    assert got == sent
    assert decoder.bad == 0


@settings(max_examples=50)
@given(st.one_of(st.binary(max_size=40), doubled), frames)
def test_a_frame_behind_garbage_is_found_at_the_latest_after_another(garbage, frame):
    decoder = FrameDecoder()
    decoder.feed(garbage)
    # What looks like the start of a long frame may swallow the next one or two, no more than its
    # length.
    got = [found for _ in range(600) for found in decoder.feed(encode(*frame))]
    assert got[-1] == frame
    assert len(got) >= 1


@given(frames, st.data())
def test_one_wrong_bit_never_gives_another_frame(frame: Frame, data: st.DataObject) -> None:
    wire = bytearray(encode(*frame))
    bit = data.draw(st.integers(0, 8 * len(wire) - 1))
    wire[bit // 8] ^= 1 << bit % 8
    decoder = FrameDecoder()
    assert all(found == frame for found in decoder.feed(bytes(wire)))


def test_a_megabaud_line_carries_five_objects_in_two_milliseconds() -> None:
    worst = bytes([DLE]) * 4
    write = len(encode(Opcode.WRITE_OBJECT, b"\x01\x7a\x60\x00" + worst)) + len(
        encode(Opcode.ANSWER, bytes(4))
    )
    read = len(encode(Opcode.READ_OBJECT, b"\x01\x64\x60\x00")) + len(
        encode(Opcode.ANSWER, bytes(4) + worst)
    )
    assert write * 10 <= cycle_bits(1, 0)
    assert read * 10 <= cycle_bits(0, 1)
    assert cycle_bits(1, 4) <= 0.8 * 2000
