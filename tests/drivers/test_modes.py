"""Drives that take a speed, a torque or set-points instead of positions in every cycle."""

import dataclasses
import math

import pytest

from drivers.canopen.motion import (
    STALE_CYCLES,
    CyclicSpeed,
    CyclicTorque,
    LoopGains,
    Motion,
    Observed,
    ProfilePosition,
)
from drivers.errors import StateError
from drivers.interfaces import ServoState
from drivers.mock.canopen.dictionary import key
from drivers.mock.traits import Traits

from .host import SCALES, Host, enabled, make_host, prepared
from .test_servo import LIMITS

MODES = {"csv": 1 << 8, "cst": 1 << 9, "pp": 1 << 0}
TARGETS = {"csv": 0x60FF, "cst": 0x6071}
INERTIA = 0.204


def motion(mode: str) -> Motion:
    return {
        "csv": lambda: CyclicSpeed(SCALES, LoopGains(0.0)),
        "cst": lambda: CyclicTorque(SCALES, LoopGains(0.0), INERTIA),
        "pp": lambda: ProfilePosition(SCALES, math.radians(2000)),
    }[mode]()


def host_in(mode: str, limited: bool = True) -> Host:
    """Return a bench whose drive offers this mode only."""
    host = make_host(motion=motion(mode), traits=Traits(modes=MODES[mode]))
    if limited:
        host.servo.write_limits(LIMITS)
    return host


def sine(time_s: float) -> float:
    return math.radians(5) * (1 - math.cos(math.tau * time_s))


@pytest.mark.parametrize(("mode", "within_deg"), [("csv", 0.15), ("cst", 0.5), ("pp", 0.35)])
def test_the_joint_follows(mode: str, within_deg: float) -> None:
    host = enabled(host_in(mode))
    worst = 0.0
    for step in range(100):
        begun = 0.02 * step
        host.cycles(20, lambda t, begun=begun: sine(begun + t))
        error = host.bench.machine.truth().angle_rad - sine(begun + 0.02)
        worst = max(worst, abs(error))
    assert math.degrees(worst) < within_deg
    host.servo.disable()
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED
    assert not host.powered[-1]


@pytest.mark.parametrize("mode", TARGETS)
def test_without_limits_there_is_no_power(mode: str) -> None:
    host = prepared(host_in(mode, limited=False))
    with pytest.raises(StateError, match="enforces the limits, and no limits have been set"):
        host.servo.enable()
    assert True not in host.powered


@pytest.mark.parametrize("mode", TARGETS)
def test_a_command_holds_for_one_exchange(mode: str) -> None:
    host = enabled(host_in(mode))
    host.cycles(100, lambda t: 0.5 * t)
    objects = host.bench.drive.objects
    assert objects.integer(TARGETS[mode]) != 0
    host.cycles(1)
    assert objects.integer(TARGETS[mode]) == 0
    host.cycles(1, lambda _: 0.06)
    assert objects.integer(TARGETS[mode]) != 0


@pytest.mark.parametrize("mode", TARGETS)
def test_without_whole_samples_nothing_is_commanded(mode: str) -> None:
    host = enabled(host_in(mode))
    host.cycles(100, lambda t: 0.5 * t)
    host.bench.bus.frame_filters.append(
        lambda _time, identifier, data, _host: None if identifier == 0x181 else (identifier, data)
    )
    objects = host.bench.drive.objects
    host.cycles(STALE_CYCLES, lambda t: 0.05 + 0.5 * t)
    assert objects.integer(TARGETS[mode]) != 0
    host.cycles(2, lambda t: 0.06 + 0.5 * t)
    assert objects.integer(TARGETS[mode]) == 0


@pytest.mark.parametrize("mode", MODES)
def test_a_host_that_falls_silent_stops_the_joint(mode: str) -> None:
    host = enabled(host_in(mode))
    host.cycles(200, lambda t: 0.5 * t)
    host.wait(0.35)
    assert not host.powered[-1]
    assert abs(host.bench.machine.truth().velocity_rad_s) < 1e-3
    # A speed is held for the heartbeat time-out, then braked; a torque is not more than friction.
    assert host.bench.machine.truth().angle_rad < 0.1 + 0.5 * 0.15


@pytest.mark.parametrize("mode", MODES)
def test_a_quick_stop_brakes(mode: str) -> None:
    host = enabled(host_in(mode))
    host.cycles(200, lambda t: 0.5 * t)
    host.servo.quick_stop()
    host.cycles(100, lambda t: 0.1 + 0.5 * t)
    assert abs(host.bench.machine.truth().velocity_rad_s) < 1e-3
    assert host.servo.state() in (ServoState.SWITCH_ON_DISABLED, ServoState.QUICK_STOP_ACTIVE)


@pytest.mark.parametrize("mode", TARGETS)
def test_the_loop_stops_at_the_end_of_the_angle(mode: str) -> None:
    host = host_in(mode)
    host.servo.write_limits(dataclasses.replace(LIMITS, angle_max_rad=0.1, speed_rad_s=1.0))
    enabled(host)
    peak = top = 0.0
    for step in range(60):
        host.cycles(10, lambda t, begun=0.01 * step: 2.0 * (begun + t))
        truth = host.bench.machine.truth()
        peak, top = max(peak, truth.velocity_rad_s), max(top, truth.angle_rad)
    assert 0.09 < top < 0.105
    assert peak < 1.1


def test_a_torque_is_never_more_than_its_limit() -> None:
    host = host_in("cst")
    host.servo.write_limits(dataclasses.replace(LIMITS, torque_N_m=20.0))
    enabled(host)
    asked = []
    for step in range(60):
        host.cycles(5, lambda t, begun=0.005 * step: 5.0 * (begun + t))
        asked.append(host.bench.drive.objects.integer(0x6071))
    assert max(asked) == math.floor(20.0 / SCALES.joint_torque_unit_N_m)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_torque_needs_no_unit_of_the_speed(sign: int) -> None:
    scales = dataclasses.replace(SCALES, sign=sign)
    torque = CyclicTorque(scales, LoopGains(0.0), INERTIA)
    # The drive tells its speed in rpm, which is 68 times too small for the unit of the scales.
    host = make_host(scales=scales, motion=torque, traits=Traits(modes=1 << 9, rpm=True))
    host.servo.write_limits(LIMITS)
    enabled(host)
    for step in range(50):
        host.cycles(20, lambda t, begun=0.02 * step: sine(begun + t))
        error = sign * host.bench.machine.truth().angle_rad - sine(0.02 * step + 0.02)
        assert abs(math.degrees(error)) < 0.5


@pytest.mark.parametrize(("counts", "own"), [(4096.0, False), (40.0, True)])
def test_where_the_encoder_is_coarse_the_drive_s_speed_counts(counts: float, own: bool) -> None:
    scales = dataclasses.replace(SCALES, counts_per_turn=counts)
    torque = CyclicTorque(scales, LoopGains(0.0), INERTIA)
    torque.begin(0.001)
    torque.take_limits(LIMITS)
    torque.reset()
    seen = Observed(0x27, 0.0, 0.25, True)
    torque._value(1, 0.0, seen)
    assert torque._speed(seen, 75.0) == 0.0
    torque._value(2, 0.0, seen._replace(angle_rad=1e-4))
    assert torque._speed(seen, 75.0) == pytest.approx(0.25 if own else 0.1)


def test_a_lost_set_point_is_sent_again() -> None:
    host = enabled(host_in("pp"))
    host.cycles(50, lambda t: 0.2 * t)
    lost = [3]

    def lose(_time: int, identifier: int, data: bytes, _host: bool) -> tuple[int, bytes] | None:
        if identifier == 0x201 and lost[0]:
            lost[0] -= 1
            return None
        return identifier, data

    host.bench.bus.frame_filters.append(lose)
    host.cycles(5, lambda t: 0.01)
    host.cycles(300, lambda _: 0.02)
    assert host.bench.machine.truth().angle_rad == pytest.approx(0.02, abs=1e-3)


def test_a_profile_ends_at_the_last_set_point_though_the_host_is_silent() -> None:
    host = enabled(host_in("pp"))
    host.cycles(2, lambda _: 0.01)
    host.wait(0.05)
    assert host.bench.machine.truth().angle_rad == pytest.approx(0.01, abs=1e-3)
    assert host.bench.drive.objects.values[key(0x6041)] & 0x6F == 0x27
