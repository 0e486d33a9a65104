"""Heartbeats, node guarding and life guarding: how drive and program detect a lost partner."""

from contextlib import suppress
from pathlib import Path

import can
import pytest

from drivers.can.port import REMOTE_FLAG, PythonCanPort
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.clock import SimulatedClock
from drivers.errors import ConfigurationError, DeviceError, LinkError, ObjectAccessError
from drivers.interfaces import ServoState
from drivers.mock.canopen.dictionary import key
from drivers.mock.power_state import POWERED, Command, State
from drivers.objects import ObjectAddress

from .host import SCALES, Host, drive_eds, enabled, make_host, prepared

GUARD_REQUEST = REMOTE_FLAG | 0x701
GUARDED = (0x1016,)
WATCH_S = 0.1


def guarded(folder: Path, **options: object) -> Host:
    return make_host(eds=drive_eds(folder, GUARDED), **options)  # type: ignore[arg-type]


def requests(host: Host) -> list[int]:
    """Times of the guard requests since the last call, ns."""
    frames = host.link.take_frames()
    return [f.time_ns for f in frames if f.identifier == GUARD_REQUEST]


def test_life_guarding_is_the_watchdog_of_a_drive_without_a_heartbeat_consumer(tmp_path):
    host = enabled(guarded(tmp_path))
    assert host.servo.watch_s == WATCH_S
    assert host.link.has_watchdog
    host.cycles(300)
    values = host.bench.drive.objects.values
    assert values[key(0x100C)] * values[key(0x100D)] == WATCH_S * 1e3
    assert values[key(0x1017)] == 0
    assert host.drive.nmt_state == 5
    requests(host)
    host.cycles(100)
    assert len(requests(host)) == 4
    waited = 0
    while host.bench.drive.power_state in POWERED and waited < 300:
        host.wait(0.001)
        waited += 1
    assert 75 <= waited <= 150
    assert host.bench.drive.power_state is State.FAULT
    assert requests(host) == []


def test_guard_requests_come_from_the_exchange_alone(tmp_path: Path) -> None:
    host = prepared(guarded(tmp_path))
    host.cycles(5)
    requests(host)
    host.wait(0.5)
    host.lose(0x581)
    host.drive.nmt_state = 5
    with suppress(LinkError):
        host.servo.state()
    # One request finds out whether the silent device is in the NMT state STOPPED.
    assert len(requests(host)) <= 1


def test_the_loop_may_pause_without_power(tmp_path: Path) -> None:
    host = prepared(guarded(tmp_path))
    for pause_s in (0.15, 3.0):
        host.cycles(50)
        host.wait(pause_s)
    host.cycles(300)
    assert host.drive.monitored
    assert host.servo.sample().fresh


def test_lost_answers_are_no_loss_and_those_whose_toggle_bit_stays_are(tmp_path):
    host = enabled(guarded(tmp_path))
    host.cycles(100)
    # After a lost answer the toggle bit of the next one is that of the last one received.
    host.lose(0x701, 2)
    host.cycles(500)
    assert host.drive.monitored
    host.bench.bus.frame_filters.append(
        lambda _t, i, d, sent: (i, bytes([d[0] & 0x7F])) if i == 0x701 else (i, d)
    )
    with pytest.raises(LinkError, match="node 1 sent no answer to guard requests"):
        host.cycles(400)


def test_without_remote_frames_a_drive_runs_only_as_one_without_a_watchdog(tmp_path):
    host = guarded(tmp_path)
    assert not list(host.servo.problems(host.cycle_s))
    assert len(requests(host)) == 1
    host.bench.drive.remote_frames = False
    (error,) = host.servo.problems(host.cycle_s)
    assert "701h" in str(error)
    with pytest.raises(LinkError, match=r"701h.*servo\.stops_alone: false"):
        host.servo.prepare(host.cycle_s)
    host.servo = Cia402Servo(host.drive, host.link, SCALES, stops_alone=False)
    requests(host)
    enabled(host).cycles(300)
    assert not host.link.has_watchdog
    assert requests(host) == []
    assert host.bench.drive.objects.integer(0x1017) == 50
    host.servo.disable()
    assert not host.servo.state().energised


def test_a_device_that_nothing_shows_to_be_lost_is_refused(tmp_path: Path) -> None:
    host = make_host(eds=drive_eds(tmp_path, (0x1016, 0x1017, 0x100C)))
    (error,) = host.servo.description_problems()
    assert "1017h" in str(error)


def test_a_life_guarding_that_an_earlier_program_left_is_ended(tmp_path: Path) -> None:
    host = guarded(tmp_path)
    host.bench.drive.objects.values |= {key(0x100C): 25, key(0x100D): 4}
    host.link.send(GUARD_REQUEST, bytes(1))
    prepared(host)
    host.wait(1.0)
    host.cycles(10)


# Signs of the control loop between slow SDO answers.


@pytest.mark.parametrize("lacks", [(), GUARDED])
@pytest.mark.parametrize("delay_s", [0.02, 0.1])
def test_a_drive_with_slow_sdo_answers_can_be_enabled_and_disabled(tmp_path, delay_s, lacks):
    host = make_host(eds=drive_eds(tmp_path, lacks))
    host.bench.drive.sdo_delay_ns = round(delay_s * 1e9)
    for _ in range(2):
        enabled(host).cycles(100)
        assert host.bench.drive.power_state is State.OPERATION_ENABLED
        host.servo.disable()
        assert host.bench.drive.power_state is State.SWITCH_ON_DISABLED
    assert host.bench.drive.objects.integer(0x603F) == 0


@pytest.mark.parametrize("lacks", [(), GUARDED])
def test_a_drive_that_is_never_enabled_is_not_kept_alive_for_long(tmp_path, lacks):
    """The sum of the waits is bounded, however many requests are answered late."""
    host = prepared(make_host(eds=drive_eds(tmp_path, lacks)))
    host.link.take_frames()
    begun = host.clock.now_ns()
    with suppress(DeviceError), host.drive.kept_alive(0.5):
        host.drive.watch(WATCH_S)
        host.bench.drive.sdo_delay_ns = 250_000_000
        for _ in range(8):
            host.drive.read(0x6064)
    signs = (0x77F,) if not lacks else (GUARD_REQUEST,)
    sent = [f.time_ns - begun for f in host.link.take_frames() if f.identifier in signs]
    assert 0.4e9 < max(sent) < 0.5e9
    assert host.clock.now_ns() - begun > 1.5e9


# What a preparation reads and writes is read by the check.


def prepared_objects(host: Host) -> set[ObjectAddress]:
    """Objects that preparing and enabling accesses, less those of states and identities."""
    seen: set[ObjectAddress] = set()
    read, write = host.drive.read, host.drive.write

    def reads(index: int, subindex: int = 0) -> int:
        seen.add((index, subindex))
        return read(index, subindex)

    def writes(index: int, subindex: int, value: int) -> None:
        seen.add((index, subindex))
        write(index, subindex, value)

    host.drive.read = reads  # type: ignore[method-assign]
    host.drive.write = writes  # type: ignore[method-assign]
    enabled(host)
    host.servo.write_limits(host.servo.read_limits())
    host.servo.disable()
    host.drive.read, host.drive.write = read, write  # type: ignore[method-assign]
    # The entries of a mapping are written after its count, which some devices need to show them.
    return {(index, sub) for index, sub in seen if not (0x1600 <= index < 0x1C00 and sub)}


def test_an_object_without_which_a_run_fails_is_found_by_the_check(tmp_path: Path) -> None:
    eds = drive_eds(tmp_path)
    host = make_host(eds=eds)
    accessed = prepared_objects(host)
    host.link.close()
    assert {(0x60C2, 1), (0x6007, 0), (0x605A, 0), (0x6060, 0)} <= accessed
    found = 0
    for address in sorted(accessed):
        host = make_host(eds=eds)
        del host.bench.drive.objects.entries[key(*address)]
        refused = list(host.servo.problems(host.cycle_s))
        failed = False
        try:
            enabled(host)
            host.servo.write_limits(host.servo.read_limits())
            host.servo.disable()
        except (ObjectAccessError, ConfigurationError):
            failed = True
        assert bool(refused) or not failed, f"{address[0]:04X}h:{address[1]:02X}h"
        if failed:
            assert any(f"{address[0]:04X}h" in str(error) for error in refused)
        found += failed
        host.link.close()
    assert found >= 15


def test_requests_without_an_answer_do_not_keep_power_on(tmp_path: Path) -> None:
    host = enabled(make_host(eds=drive_eds(tmp_path)))
    host.cycles(30)
    begun = host.clock.now_ns()
    host.lose(0x581)
    off: list[int] = []
    host.bench.drive.entered.append(
        lambda state: off.append(host.clock.now_ns() - begun) if state is State.FAULT else None
    )
    for _ in range(4):
        with suppress(DeviceError):
            host.servo.state()
    assert off
    assert off[0] < 0.35e9


def test_a_drive_that_switched_off_by_itself_is_no_longer_watched(tmp_path: Path) -> None:
    host = enabled(make_host(eds=drive_eds(tmp_path)))
    host.cycles(30)
    host.servo.quick_stop()
    host.cycles(60)
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED
    assert host.bench.drive.objects.integer(0x1016, 1) == 0
    host.wait(0.5)
    host.link.exchange()


def test_a_guarded_drive_that_ignores_the_quick_stop_is_not_kept_alive(tmp_path: Path) -> None:
    """While the drive brakes, a request that is not answered asks for no NMT state."""
    host = enabled(guarded(tmp_path))
    host.cycles(30)
    host.bench.drive.deaf_to = frozenset({Command.QUICK_STOP})
    host.lose(0x581)
    with suppress(DeviceError):
        host.servo.quick_stop()
    requests(host)
    for _ in range(5):
        with suppress(DeviceError):
            host.servo.state()
    assert requests(host) == []
    assert host.bench.drive.power_state is State.FAULT


# Guard requests on the wire.


def test_an_interface_that_would_send_data_instead_is_refused() -> None:
    class Socketcand(can.BusABC):
        """As python-can 4.6, which drops the flag of a remote frame."""

        def __init__(self) -> None:
            super().__init__(channel=0)

        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            raise AssertionError("sent as a data frame")

    Socketcand.__module__ = "can.interfaces.socketcand.socketcand"
    bus = Socketcand()
    with pytest.raises(OSError, match="sends no remote frames"):
        PythonCanPort(bus, SimulatedClock(0)).transmit(GUARD_REQUEST, bytes(1))
    bus.shutdown()


@pytest.mark.parametrize("lacks", [(), GUARDED])
def test_a_slow_drive_that_has_stopped_does_not_fault_while_its_state_is_read(tmp_path, lacks):
    """Some drives go into fault after the loss of their master also without power."""
    host = enabled(make_host(eds=drive_eds(tmp_path, lacks)))
    host.cycles(30)
    host.bench.drive.sdo_delay_ns = 100_000_000
    lost: list[int] = []
    host.bench.drive.connection_lost = lost.append  # type: ignore[method-assign]
    with suppress(LinkError):
        host.servo.quick_stop()
    host.cycles(60)
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED
    host.wait(1.0)
    assert lost == []
