import pytest

from drivers.can.port import cycle_bits, frame_bits
from drivers.canopen import cia402_objects, sensors
from drivers.errors import ConfigurationError, DriveFault, LinkError
from drivers.mock.drive import DRIVE_EDS
from drivers.objects import PdoLayout

from .host import Host, enabled, frame, prepared


def test_a_missing_answer_leaves_the_old_sample_not_fresh(host: Host) -> None:
    enabled(host)
    host.cycles(20)
    good = host.servo.sample()
    assert good.fresh
    host.lose(0x281)
    host.cycles(1, lambda _: 0.001)
    stale = host.servo.sample()
    assert not stale.fresh
    assert stale.device_time_s == good.device_time_s
    assert host.encoder.sample().fresh
    host.bench.bus.frame_filters.clear()
    host.cycles(1)
    assert host.servo.sample().fresh


def test_slow_process_data_may_be_two_periods_old(host: Host) -> None:
    prepared(host)
    host.cycles(20)
    host.lose(0x481)
    host.cycles(10)
    assert host.servo.sample().fresh
    host.cycles(20)
    assert not host.servo.sample().fresh


def test_an_exchange_waits_no_longer_than_its_share_of_the_cycle(host: Host) -> None:
    prepared(host)
    host.lose(0x181)
    before = host.clock.now_ns()
    host.link.exchange()
    assert host.clock.now_ns() - before == 800_000


def test_an_emergency_is_a_fault_in_words_until_an_error_reset(host: Host) -> None:
    prepared(host)
    host.bench.drive.emergency(0x4310, 0x08)
    host.wait(0.001)
    with pytest.raises(DriveFault, match=r"4310h: node 1 .*over-temperature.*cool") as caught:
        host.link.exchange()
    assert caught.value.code == 0x4310
    host.link.exchange()
    host.bench.encoder.emergency(0x5123, 0)
    host.wait(0.001)
    with pytest.raises(DriveFault, match=r"node 2 .*device hardware"):
        host.link.exchange()
    host.bench.drive.emergency(0x4310, 0x08)
    host.bench.drive.clear_errors()
    host.wait(0.001)
    host.link.exchange()


@pytest.mark.parametrize("forgotten", [True, False])
def test_the_emergency_of_a_cleared_fault_is_forgotten(host: Host, forgotten: bool) -> None:
    prepared(host)
    host.bench.drive.emergency(0x4310, 0x08)
    host.link.pump(lambda: False, 0.001)
    if forgotten:
        host.link._nodes[1].forget_faults()
        host.link.exchange()
    else:
        host.link.forget(1)
        with pytest.raises(DriveFault):
            host.link.exchange()


def test_an_error_frame_fails_the_link(host: Host) -> None:
    prepared(host)
    host.bench.bus.disturb()
    with pytest.raises(LinkError, match="120 ohm"):
        host.link.exchange()


def test_a_silent_device_is_lost(host: Host) -> None:
    prepared(host)
    host.cycles(300)
    host.lose(0x702)
    host.cycles(140)
    with pytest.raises(
        LinkError, match=r"node 2 sent no heartbeat for 0\.2\d\d s \(limit 0\.2 s\)"
    ):
        host.cycles(100)
    goes_on(host)


def goes_on(host: Host) -> None:
    """The lost encoder was reported; the exchange serves the others, until it is prepared."""
    before = host.servo.sample().device_time_s
    host.cycles(300)
    assert host.servo.sample().fresh
    assert host.servo.sample().device_time_s > before
    host.bench.bus.frame_filters.clear()
    host.bench.bus.send(frame(0, bytes([128, 2])))  # in STOPPED it answers no request
    host.encoder.prepare(host.cycle_s)
    host.cycles(10)
    host.lose(0x702)
    with pytest.raises(LinkError, match="node 2 sent no heartbeat"):
        host.cycles(300)


@pytest.mark.parametrize(
    ("command", "match"), [(128, "PRE-OPERATIONAL"), (2, "STOPPED"), (129, "restarted")]
)
def test_a_device_that_leaves_operational_is_noticed(host: Host, command: int, match: str) -> None:
    prepared(host)
    host.cycles(5)
    host.bench.bus.send(frame(0, bytes([command, 2])))
    with pytest.raises(LinkError, match=f"node 2 .*{match}"):
        host.cycles(60)
    goes_on(host)


@pytest.mark.parametrize("command", [128, 2])
def test_a_device_that_left_operational_before_its_start_is_not_lost(host, command):
    prepared(host).cycles(5)
    host.bench.bus.send(frame(0, bytes([command, 1])))
    host.link.pump(lambda: False, 0.1)  # its heartbeat is heard, and no exchange reports it
    host.servo.prepare(host.cycle_s)
    host.cycles(5)
    assert host.servo.sample().fresh


def test_the_heartbeat_comes_from_the_exchange_alone(host: Host) -> None:
    prepared(host).cycles(1)
    host.link.take_frames()
    host.cycles(100)
    beats = [f for f in host.link.take_frames() if f.identifier == 0x77F]
    assert len(beats) == 4
    assert all(f.sent and f.data == b"\x05" for f in beats)
    host.wait(0.5)
    # An SDO request that waits for nothing must not feed the watch either.
    host.lose(0x581)
    with pytest.raises(LinkError, match="no SDO response"):
        host.servo.state()
    assert not [f for f in host.link.take_frames() if f.identifier == 0x77F]


def test_after_a_pause_the_next_exchange_sends_a_heartbeat(host: Host) -> None:
    prepared(host).cycles(30)
    for pause_s, cycles in ((0.0, 1), (0.03, 1), (0.03, 2)):
        host.wait(pause_s)
        host.link.take_frames()
        host.cycles(cycles)
        beats = [f for f in host.link.take_frames() if f.identifier == 0x77F]
        assert len(beats) == (pause_s > 0)


def test_a_cycle_takes_the_bus_for_as_long_as_is_planned(host: Host) -> None:
    """The load that a bench file is checked against is that on the wire."""
    prepared(host)
    host.cycles(20)
    host.link.take_frames()
    host.cycles(200)
    frames = [f for f in host.link.take_frames() if f.identifier & 0x780 != 0x700]
    planned = cycle_bits((*cia402_objects.FRAMES, *sensors.ENCODER_FRAMES))
    assert sum(frame_bits(len(f.data)) for f in frames) == pytest.approx(
        200 * planned, abs=frame_bits(8)
    )
    assert planned < 700


def test_all_devices_share_one_cycle(host: Host) -> None:
    host.servo.prepare(0.001)
    with pytest.raises(
        ConfigurationError,
        match=r"cycle time of 0\.002 s, but its link has a cycle time of 0\.001 s",
    ):
        host.encoder.prepare(0.002)


def test_process_data_must_fit_the_device(host: Host) -> None:
    def mapped(*objects: tuple[int, int], number: int = 1) -> None:
        host.drive.map_process_data([], [PdoLayout(number, objects)], 0.001)

    with pytest.raises(ConfigurationError, match="12 bytes, but the limit is 8"):
        mapped((0x6064, 0), (0x606C, 0), (0x60F4, 0))
    with pytest.raises(ConfigurationError, match="not in the device's EDS"):
        mapped((0x5000, 0))
    with pytest.raises(ConfigurationError, match=r"EDS has no TPDO 9 .1808h, 1A08h."):
        mapped((0x6064, 0), number=9)
    with pytest.raises(ConfigurationError, match=r"1008h:00h .*no integer"):
        mapped((0x1008, 0))


def test_node_identifiers_are_checked(host: Host) -> None:
    for taken in (0, 1, 127, 128):
        with pytest.raises(ConfigurationError, match=f"{taken} is not between"):
            host.link.add_node(taken, DRIVE_EDS)
