"""Homing of CiA 402 drives: what is offered, what is sent, and how the power goes off."""

import dataclasses
import math

import pytest

from drivers.errors import ConfigurationError, ObjectAccessError, StateError
from drivers.homing import HomingOrder, HomingState
from drivers.interfaces import ServoState
from drivers.mock.canopen.dictionary import key
from drivers.mock.traits import CSP, HM, Traits

from .host import SCALES, Host, drive_eds, enabled, make_host, prepared
from .test_servo import LIMITS

DEG = math.pi / 180.0


def order(method: int, home_deg: float = 0.0) -> HomingOrder:
    return HomingOrder(method, home_deg * DEG, 10 * DEG, 1 * DEG, 50 * DEG)


def homed(host: Host, wanted: HomingOrder, cycles: int = 4000) -> HomingState:
    """Home, and return how it stands after at most this many cycles."""
    host.servo.write_limits(LIMITS)
    prepared(host).servo.begin_homing(wanted)
    host.servo.start_homing()
    host.cycles(50)
    for _ in range(cycles // 50):
        if host.servo.homing_state() is not HomingState.RUNNING:
            break
        host.cycles(50)
    return host.servo.homing_state()


def searching() -> Host:
    """Return a bench whose joint is on its way to the switch."""
    host = make_host()
    host.servo.write_limits(LIMITS)
    prepared(host).servo.begin_homing(order(17))
    host.servo.start_homing()
    host.cycles(500)
    return host


def mode_of(host: Host) -> int:
    return host.bench.drive.objects.integer(0x6061)


@pytest.mark.parametrize("method", [35, 37])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_present_position_becomes_the_home_position(method: int, sign: int) -> None:
    scales = dataclasses.replace(SCALES, sign=sign, offset_rad=0.03)
    host = make_host(scales=scales)
    assert homed(host, order(method, 12.0)) is HomingState.ATTAINED
    assert host.servo.sample().following_error_rad == 0.0
    host.servo.disable()
    assert host.servo.end_homing() == (8, 8)
    angle = host.servo.readings().motor_angle_rad / SCALES.gear_ratio
    assert angle == pytest.approx(12.0 * DEG, abs=1e-5)
    assert abs(host.bench.machine.truth().angle_rad) < 1e-4
    host.servo.enable()
    host.cycles(200, lambda _: 12.5 * DEG)
    assert host.bench.machine.truth().angle_rad == pytest.approx(0.5 * DEG * sign, abs=0.02 * DEG)


@pytest.mark.parametrize(("method", "edge_deg"), [(17, -20.0), (18, 20.0)])
def test_a_switch_is_found_and_left(host: Host, method: int, edge_deg: float) -> None:
    assert homed(host, order(method, 3.0)) is HomingState.ATTAINED
    truth = host.bench.machine.truth().angle_rad
    assert truth == pytest.approx(edge_deg * DEG, abs=0.2 * DEG)
    shown = host.servo.sample().motor_angle_rad / SCALES.gear_ratio
    assert shown - truth == pytest.approx((3.0 - edge_deg) * DEG, abs=0.05 * DEG)


def test_power_alone_does_not_start_it(host: Host) -> None:
    host.servo.write_limits(LIMITS)
    prepared(host).servo.begin_homing(order(17))
    host.cycles(500)
    assert mode_of(host) == 6
    assert host.servo.homing_state() is HomingState.INTERRUPTED
    assert abs(host.bench.machine.truth().angle_rad) < 1e-4
    assert not host.bench.drive.objects.integer(0x6040) & 1 << 4


def test_switching_on_again_does_not_start_it(host: Host) -> None:
    """The end of a homing may have failed, so that its mode is still selected."""
    host.servo.write_limits(LIMITS)
    prepared(host).servo.begin_homing(order(37))
    host.servo.start_homing()
    motion = host.servo._motion
    assert motion.started
    motion.reset()
    assert not motion.started


def test_a_blocked_joint_is_a_homing_error(host: Host) -> None:
    host.bench.drive.homing.jammed = True
    assert homed(host, order(17)) is HomingState.FAILED
    assert host.bench.drive.objects.integer(0x6041) & 1 << 13
    assert abs(host.bench.machine.truth().angle_rad) < 0.5 * DEG
    host.servo.disable()
    assert host.servo.end_homing() == (8, 8)


def test_a_quick_stop_ends_it() -> None:
    host = searching()
    with pytest.raises(
        StateError, match="its mode of operation cannot be changed from homing: disable it first"
    ):
        host.servo.end_homing()
    host.servo.quick_stop()
    host.cycles(100)
    host.servo.disable()
    at = host.bench.machine.truth().angle_rad
    assert host.servo.end_homing() == (8, 8)
    host.cycles(200)
    assert host.bench.machine.truth().angle_rad == at
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED
    assert not host.bench.drive.objects.integer(0x6040) & 1 << 4
    assert not host.powered[-1]


def test_a_falling_start_bit_interrupts_it_and_a_silent_host_stops_it() -> None:
    host = searching()
    host.drive.stage(1, 0x0F, 0)
    host.cycles(50)
    assert host.servo.homing_state() is HomingState.INTERRUPTED
    host = searching()
    host.wait(0.5)
    assert not host.powered[-1]
    assert abs(host.bench.machine.truth().velocity_rad_s) < 1e-3


def test_an_energised_drive_is_not_homed(host: Host) -> None:
    host.servo.write_limits(LIMITS)
    enabled(host)
    with pytest.raises(StateError, match="disable it before homing"):
        host.servo.begin_homing(order(37))
    assert mode_of(host) == 8


def test_what_the_drive_refuses_is_not_energised() -> None:
    host = prepared(make_host())
    with pytest.raises(ObjectAccessError, match="6098h"):
        host.servo.begin_homing(order(1))
    with pytest.raises(ConfigurationError, match="less than one unit of object 6099h"):
        host.servo.begin_homing(dataclasses.replace(order(17), zero_rad_s=1e-7))
    assert True not in host.powered


def test_a_drive_that_does_not_show_the_mode_is_not_started(host: Host) -> None:
    host.servo.write_limits(LIMITS)
    prepared(host)
    objects = host.bench.drive.objects
    objects.written[0x6060] = lambda _sub, _value: None
    objects.values[key(0x6061)] = 8
    with pytest.raises(StateError, match=r"6061h still reads 8, 1 s after mode 6 \(homing\)"):
        host.servo.begin_homing(order(37))
    assert True not in host.powered
    assert objects.integer(0x6060) == 8


@pytest.mark.parametrize(
    ("lacks", "methods"),
    [
        ((), {17, 18, 35, 37}),
        ((0x6098,), set()),
        ((0x607C,), set()),
        ((0x6099,), {35, 37}),
        ((0x60E3,), {*range(1, 15), *range(17, 31), *range(33, 36), 37}),
    ],
)
def test_homing_is_offered_where_its_objects_are(tmp_path, lacks, methods):
    offer = make_host(eds=drive_eds(tmp_path, lacks)).servo.homing_offer()
    assert set(offer.methods) == methods
    assert all(f"{index:04X}h" in offer.words for index in lacks if index != 0x60E3)


@pytest.mark.parametrize("index", [0x6098, 0x607C])
def test_an_object_of_the_file_that_the_drive_lacks_is_no_offer(host: Host, index: int) -> None:
    del host.bench.drive.objects.entries[key(index)]
    offer = host.servo.homing_offer()
    assert not offer.methods
    assert f"{index:04X}h is in the device's EDS, but not in the device" in offer.words


def test_modes_and_methods_that_a_drive_reports_are_the_offer() -> None:
    host = make_host(traits=Traits(modes=CSP | HM))
    host.bench.drive.objects.values[key(0x60E3, 1)] = -3
    assert host.servo.homing_offer().methods == (-3, 18, 35, 37)
    assert "method 17 is not offered" in host.servo.homing_offer().problem(17)
    assert "6502h reads 00000080h" in make_host(traits=Traits(modes=CSP)).servo.homing_offer().words
