"""Accelerations of drives whose unit is not that of the speed per second."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest

from drivers.canopen.cia402_servo import homing_settings as settings
from drivers.canopen.motion import ProfilePosition
from drivers.clock import NS
from drivers.homing import HomingOrder
from drivers.mock.makes import LACKS, MAKES, description
from drivers.servo_limits import encode

from .host import SCALES, enabled, make_host
from .test_lean_devices import scales_of
from .test_servo import LIMITS

RAMPED = [make for make in MAKES if make != "EPOS2" and 0x6085 not in LACKS[make]]
DECELERATION = 20.0
"""Of the quick stop, rad/s^2 at the joint."""
SPEED = 1.0


@pytest.mark.parametrize("make", RAMPED)
def test_a_quick_stop_brakes_as_the_bench_file_says(make: str, tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(description(make))
    host = make_host(eds=eds, scales=scales_of(make))
    limits = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=DECELERATION)
    host.servo.write_limits(limits)
    held = host.servo.read_limits().quick_stop_deceleration_rad_s2
    assert held == pytest.approx(DECELERATION, rel=0.01)
    enabled(host)
    host.cycles(300, lambda t: SPEED * t - 0.01)
    machine = host.bench.machine
    began, speed = host.clock.now_ns(), machine.truth().velocity_rad_s
    assert speed == pytest.approx(SPEED, rel=0.1)
    host.servo.quick_stop()
    while abs(machine.truth().velocity_rad_s) > 0.1 * SPEED:
        assert host.clock.now_ns() - began < NS
        host.cycles(1)
    took_s = (host.clock.now_ns() - began) / NS
    assert took_s == pytest.approx(0.9 * speed / DECELERATION, abs=0.012)


def test_a_deceleration_between_two_units_is_never_weaker() -> None:
    coarse = dataclasses.replace(SCALES, acceleration_unit_rad_s2=2 * math.pi * SCALES.gear_ratio)
    address = (0x6085, 0)
    # A drive with 0 in 6085h does not brake, or refuses it.
    weak = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=1.0)
    assert encode(weak, coarse)[address] == 1
    weakest = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=1e-9)
    assert encode(weakest, coarse)[address] == 1
    strong = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=20.0)
    assert encode(strong, coarse)[address] == 4
    whole = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=6 * math.pi)
    assert encode(whole, coarse)[address] == 3
    # The drive's own value goes back as it was.
    own = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=0.0)
    assert encode(own, coarse)[address] == 0


def test_homing_and_profiles_use_the_unit_of_the_acceleration() -> None:
    host = make_host(scales=dataclasses.replace(SCALES, acceleration_unit_rad_s2=2.0))
    order = HomingOrder(17, 0.0, 0.2, 0.1, 1.0)
    held = dict(settings(host.drive, host.servo._scales, order))
    assert held[0x609A, 0] == round(1.0 * 100 / 2.0)
    assert held[0x6099, 1] == math.floor(0.2 * 100 / SCALES.count_rad + 1e-6)
    profile = dict(ProfilePosition(host.servo._scales, 3.0).settings(LIMITS))
    assert (profile[0x6083, 0], profile[0x6084, 0]) == (150, 150)
    assert profile[0x6081, 0] > 1000
