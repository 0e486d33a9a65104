"""The torque offset 60B2h: added by the drive's loops, in its own unit, and gone with the power."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.interfaces import ServoState
from drivers.mock.drive import FOLLOWING_ERROR

from .host import Host, enabled, make_host, prepared


@pytest.fixture
def host() -> Host:
    return make_host(torque_offset=True)


def held(host: Host) -> int:
    """What the drive itself has in 60B2h."""
    return host.bench.drive.objects.integer(0x60B2)


def current(host: Host, cycles: int = 40) -> float:
    """Mean motor current over the last cycles, A."""
    values = []
    for _ in range(cycles):
        host.cycles(1)
        values.append(host.servo.sample().current_A)
    return sum(values) / len(values)


def test_a_resting_joint_takes_the_torque_as_current(host: Host) -> None:
    """Position P and velocity PI see no error, so that the current is the offset's: 6 N m over 3 N
    m/A.
    """
    enabled(host)
    before = current(host)
    host.servo.set_torque_offset(6.0)
    host.cycles(20)
    assert current(host) - before == pytest.approx(2.0, abs=0.02)
    assert host.bench.machine.truth().angle_rad == 0.0


def test_it_does_not_pass_the_limit_of_the_current(host: Host) -> None:
    prepared(host)
    host.servo.write_limits(replace(host.servo.read_limits(), current_A=3.0))
    host.servo.enable()
    host.servo.set_torque_offset(11.9)
    host.cycles(30)
    assert current(host) == pytest.approx(3.0, abs=0.02)


def test_the_drive_adds_nothing_to_a_ramp_of_its_own(host: Host) -> None:
    """A fault stops the drive by itself, with 60B2h still as it was: the offset must not push the
    joint on.
    """
    enabled(host)
    host.servo.set_torque_offset(8.0)
    host.cycles(20)
    host.bench.drive.fail(FOLLOWING_ERROR)
    host.wait(0.01)
    assert held(host) == 178
    host.wait(0.05)
    assert host.servo.state() is ServoState.FAULT
    assert host.bench.machine.truth().current_A == 0.0
    assert host.bench.machine.truth().angle_rad == 0.0
