import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.amt21.encoder import COUNTS_PER_TURN, PlausibilityGate, decode, encode
from drivers.errors import ConfigurationError, LinkError

from .contract import enabled
from .serial_host import SerialHost, make_serial_host

MS = 1_000_000
COUNT_RAD = math.tau / COUNTS_PER_TURN


@pytest.fixture
def host(serial: SerialHost) -> SerialHost:
    return serial


def live(host: SerialHost) -> SerialHost:
    enabled(host).cycles(3)
    return host


@pytest.mark.parametrize(
    ("value", "wire"),
    # Position 21AB = 10 0001 1010 1011: odd bits 13, 7, 5, 3, 1 are five, even bits 8, 0 two.
    [(0x21AB, "ab 61"), (0, "00 c0"), (0x3FFF, "ff 3f"), (1, "01 80"), (2, "02 40")],
)
def test_check_bits(value: int, wire: str) -> None:
    assert encode(value) == bytes.fromhex(wire)
    assert decode(bytes.fromhex(wire)) == value


@given(st.integers(0, 0x3FFF), st.integers(0, 15))
def test_every_single_bit_error_is_seen(value: int, bit: int) -> None:
    wire = (int.from_bytes(encode(value), "little") ^ 1 << bit).to_bytes(2, "little")
    assert decode(wire) is None


class TestGate:
    def make(self) -> PlausibilityGate:
        gate = PlausibilityGate(speed_counts_s=10_000.0, acceleration_counts_s2=500_000.0)
        gate.start(100, 0.002)
        assert gate.admit(100, 0)
        return gate

    def test_takes_what_the_joint_can_do_and_keeps_the_position_otherwise(self) -> None:
        gate = self.make()
        assert not gate.admit(100, 0)  # the same instant says nothing new
        for step in range(1, 20):
            assert gate.admit(100 + step * step // 2, 2 * MS * step)
        gate = self.make()
        assert not gate.admit(100 + 512, 2 * MS)
        assert gate.position == 100
        assert not gate.admit(160, 4 * MS)
        assert gate.admit(160, 20 * MS)

    @pytest.mark.parametrize(
        ("moved", "good"), [(22, True), (23, False), (-22, True), (-23, False)]
    )
    def test_speed_on_both_sides_of_the_limit(self, moved: int, good: bool) -> None:
        gate = PlausibilityGate(10_000.0, 1e9)
        gate.start(8000, 0.002)
        assert gate.admit(8000, 0)
        assert gate.admit(8000 + moved, 2 * MS) is good

    @pytest.mark.parametrize(("moved", "good"), [(6, True), (7, False), (-6, True), (-7, False)])
    def test_acceleration_on_both_sides_of_the_limit(self, moved: int, good: bool) -> None:
        assert self.make().admit(100 + moved, 2 * MS) is good

    def test_follows_through_the_end_of_the_turn(self) -> None:
        gate = PlausibilityGate(10_000.0, 500_000.0)
        gate.start(COUNTS_PER_TURN - 2, 0.002)
        assert gate.position == -2
        assert gate.admit(1, 2 * MS)
        assert gate.position == 1

    def test_a_pause_is_no_obstacle_while_half_a_turn_takes_longer(self) -> None:
        half_turn_s = COUNTS_PER_TURN / 2 / 10_000.0
        gate = self.make()
        assert gate.admit(100 + 7000, round((half_turn_s - 0.002) * 1e9))
        assert gate.position == 7100

    @pytest.mark.parametrize("turns", [-3, 0, 2])
    def test_after_a_longer_pause_another_sensor_decides_the_turn(self, turns: int) -> None:
        gate = self.make()
        assert not gate.admit(200, 900 * MS)
        assert not gate.admit(200, 902 * MS, lambda: None)
        assert gate.position == 100
        elsewhere = turns * COUNTS_PER_TURN + 200 - 8000
        assert gate.admit(200, 904 * MS, lambda: elsewhere)
        assert gate.position == turns * COUNTS_PER_TURN + 200
        assert gate.admit(201, 906 * MS)
        assert not gate.admit(300, 908 * MS, lambda: elsewhere)


@pytest.mark.parametrize("echo", [False, True], ids=["silent adapter", "adapter with echo"])
def test_follows_the_joint_below_zero(echo: bool) -> None:
    host = live(make_serial_host(echo=echo))
    host.cycles(200, lambda t: -0.05 * math.sin(math.pi / 0.8 * t))
    sample = host.encoder.sample()
    assert sample.fresh
    assert sample.angle_rad == pytest.approx(-0.05, abs=2e-3)


@pytest.mark.parametrize(("pause_s", "cycle_s"), [(0.022, 0.002), (3.0, 0.01)])
def test_answers_are_used_again_after_a_pause_of_the_host(pause_s: float, cycle_s: float) -> None:
    host = live(make_serial_host(cycle_s=cycle_s))
    host.cycles(200, lambda t: 0.2 * math.sin(t))
    before = host.encoder.sample().angle_rad
    host.wait(pause_s)
    host.cycles(1)
    sample = host.encoder.sample()
    assert sample.fresh
    assert sample.angle_rad == pytest.approx(before, abs=0.01)


def test_the_stamp_is_the_instant_of_asking(host: SerialHost) -> None:
    live(host)
    asked: list[int] = []
    write = host.encoder_line.write

    def noted(data: bytes) -> None:
        asked.append(host.bench.clock.now_ns())
        write(data)

    host.encoder_line.write = noted  # type: ignore[method-assign]
    host.link.exchange()
    assert [host.encoder.sample().device_time_s] == [at / 1e9 for at in asked]


def flip(mask: int):
    def spoil(_now: int, data: bytes, from_host: bool) -> bytes:
        if from_host or len(data) != 2:
            return data
        return (int.from_bytes(data, "little") ^ mask).to_bytes(2, "little")

    return spoil


@pytest.mark.parametrize("mask", [1 << 3, 1 << 12 | 1 << 10, 1 << 9 | 1 << 15])
def test_a_bad_or_implausible_answer_leaves_the_angle(host: SerialHost, mask: int) -> None:
    live(host)
    before = host.encoder.sample()
    host.encoder_line.filters.append(flip(mask))
    host.cycles(3)
    sample = host.encoder.sample()
    assert not sample.fresh
    assert sample.angle_rad == before.angle_rad
    host.encoder_line.filters.clear()
    host.cycles(1)
    assert host.encoder.sample().fresh


def test_a_silent_encoder_is_not_fresh_and_the_servo_goes_on(host: SerialHost) -> None:
    live(host)
    host.encoder_line.cut = True
    host.cycles(3)
    assert not host.encoder.sample().fresh
    assert host.servo.sample().fresh


def test_no_encoder_is_a_link_error(host: SerialHost) -> None:
    host.encoder_line.cut = True
    with pytest.raises(LinkError, match="no encoder answers at address 54h"):
        host.encoder.prepare(host.cycle_s)


def test_answers_that_disagree_at_rest_stop_preparation(host: SerialHost) -> None:
    values = iter(range(0, 3000, 100))
    host.amt21.distort = lambda counts: counts + next(values)
    with pytest.raises(ConfigurationError, match="must agree to 2 counts"):
        host.encoder.prepare(host.cycle_s)


@pytest.mark.parametrize("use", ["write", "read"])
def test_a_line_that_fails_is_reported_once_until_it_works_again(host, monkeypatch, use):
    live(host)

    def gone(*_: object) -> None:
        raise OSError(5, "gone")

    for _ in range(2):
        with monkeypatch.context() as patch:
            patch.setattr(host.encoder_line, use, gone)
            with pytest.raises(LinkError, match="gone"):
                host.cycles(1)
            before = host.servo.sample().device_time_s
            host.cycles(3)
            assert host.servo.sample().fresh
            assert host.servo.sample().device_time_s > before
            assert not host.encoder.sample().fresh
        host.cycles(5)
        assert host.encoder.sample().fresh
