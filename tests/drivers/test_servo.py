from dataclasses import replace

import pytest

from drivers import servo_limits
from drivers.errors import ConfigurationError, LinkError, StateError
from drivers.interfaces import ServoLimits, ServoState

from .host import SCALES, Host, make_host, prepared

LIMITS = ServoLimits(
    angle_min_rad=-0.6,
    angle_max_rad=0.7,
    speed_rad_s=1.5,
    torque_N_m=30.0,
    current_A=12.0,
    following_error_rad=0.05,
    quick_stop_option=6,
    quick_stop_deceleration_rad_s2=8.0,
)


def assert_within(found: ServoLimits, wanted: ServoLimits) -> None:
    """Each limit as wanted to one unit of the drive, and never wider."""
    for name in ("speed_rad_s", "torque_N_m", "current_A", "angle_max_rad"):
        assert 0 <= getattr(wanted, name) - getattr(found, name) + 1e-9 < 0.046, name
    assert 0 <= found.angle_min_rad - wanted.angle_min_rad + 1e-9 < 1e-4
    assert found.following_error_rad == pytest.approx(wanted.following_error_rad, abs=1e-4)
    assert found.quick_stop_option == wanted.quick_stop_option
    assert found.quick_stop_deceleration_rad_s2 == pytest.approx(
        wanted.quick_stop_deceleration_rad_s2, abs=1e-4
    )


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("window", [0.05, None])
def test_limits_survive_the_way_to_the_drive_and_back(sign: int, window: float | None) -> None:
    host = make_host(scales=replace(SCALES, sign=sign, offset_rad=0.1))
    limits = replace(LIMITS, following_error_rad=window)
    host.servo.write_limits(limits)
    held = host.servo.read_limits()
    assert_within(held, limits)
    host.servo.write_limits(held)
    assert host.servo.read_limits() == held


class Deaf:
    """A drive that says yes and keeps what it had."""

    def read(self, index: int, subindex: int = 0) -> int:
        return 5

    def read_text(self, index: int, subindex: int = 0) -> str:
        return ""

    def write(self, index: int, subindex: int, value: int) -> None:
        pass


def test_a_limit_that_does_not_read_back_is_named() -> None:
    with pytest.raises(ConfigurationError, match=r"607Dh:01h reads 5 after -39113 was written"):
        servo_limits.write(Deaf(), SCALES, LIMITS)


def test_power_that_came_unseen_is_taken_back(host: Host) -> None:
    prepared(host)
    asked = False

    def blind(_time: int, identifier: int, data: bytes, _sent: bool) -> tuple[int, bytes] | None:
        nonlocal asked
        asked = asked or (identifier == 0x201 and data[:2] == b"\x0f\0")
        return None if asked and identifier == 0x181 else (identifier, data)

    host.bench.bus.frame_filters.append(blind)
    with pytest.raises(StateError, match="still in state 'switched on', 1 s after"):
        host.servo.enable()
    assert True in host.powered
    assert not host.powered[-1]
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED


def test_a_bus_lost_just_after_enabling_ends_by_the_drives_own_watch(host: Host) -> None:
    prepared(host)

    def cut(_time: int, identifier: int, data: bytes, sent: bool) -> tuple[int, bytes] | None:
        if identifier == 0x201 and data[:2] == b"\x0f\0":
            host.bench.bus.down = True
        return identifier, data

    host.bench.bus.frame_filters.append(cut)
    with pytest.raises(LinkError, match="bus-off"):
        host.servo.enable()
    assert host.powered[-1]
    host.wait(0.3)
    assert not host.powered[-1]


def test_a_watch_that_does_not_read_back_stops_preparation(host: Host) -> None:
    host.bench.drive.objects.written[0x1016] = lambda _sub, _v: host.bench.drive.objects.reset(
        0x1016, 0x1016
    )
    with pytest.raises(
        ConfigurationError, match="would not detect that the control loop has stopped"
    ):
        prepared(host)
