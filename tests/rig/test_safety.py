"""Both sides of every limit, and a latch that only a good sample and a reset can close."""

from __future__ import annotations

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.safety import Check, Latch, Limits, check
from rig.sample import Sample

LIMITS = Limits(
    angle_min=-0.5,
    angle_max=0.6,
    speed=2.0,
    torque=60.0,
    current=25.0,
    following_error=0.03,
    encoder_disagreement=0.01,
    temperature=80.0,
    sample_age=0.005,
    torque_per_ampere=3.0,
    gear_ratio=100.0,
)


def sample(**changes: float) -> Sample:
    angle = changes.get("angle", 0.1)
    values = dict.fromkeys(Sample._fields, 0.0) | {
        "time": 1.25,
        "angle": angle,
        "motor_angle": angle * 100.0,
        "temperature": 25.0,
        "statusword": 0x0637,
        "fresh": True,
    }
    return Sample(**(values | changes))  # type: ignore[arg-type]


def above(value: float) -> float:
    return math.nextafter(value, math.inf)


def test_a_good_sample_passes() -> None:
    assert check(sample(), 0.0, LIMITS) is None


@pytest.mark.parametrize(
    ("kind", "inside", "outside", "limit"),
    [
        (Check.ANGLE, {"angle": 0.6}, {"angle": above(0.6)}, 0.6),
        (Check.ANGLE, {"angle": -0.5}, {"angle": -above(0.5)}, -0.5),
        (Check.SPEED, {"velocity": 2.0}, {"velocity": above(2.0)}, 2.0),
        (Check.SPEED, {"velocity": -2.0}, {"velocity": -above(2.0)}, 2.0),
        (Check.TORQUE, {"current": 20.0}, {"current": above(20.0)}, 60.0),
        (Check.TORQUE, {"current": -20.0}, {"current": -above(20.0)}, 60.0),
        (Check.FOLLOWING_ERROR, {"following_error": 0.03}, {"following_error": above(0.03)}, 0.03),
        (Check.FOLLOWING_ERROR, {"following_error": -0.03}, {"following_error": -above(0.03)}, 0.03),
        (Check.DISAGREEMENT, {"motor_angle": 10.99}, {"motor_angle": 11.01}, 0.01),
        (Check.DISAGREEMENT, {"motor_angle": 9.01}, {"motor_angle": 8.99}, 0.01),
        (Check.TEMPERATURE, {"temperature": 80.0}, {"temperature": above(80.0)}, 80.0),
        (Check.DRIVE_STATE, {"statusword": 0x0637}, {"statusword": 0x0618}, 0x27),
        (Check.DRIVE_STATE, {"statusword": 0x0027}, {"statusword": 0x0007}, 0x27),
    ],
)
def test_both_sides_of_a_limit(kind: Check, inside: dict[str, float], outside: dict[str, float], limit: float) -> None:
    assert check(sample(**inside), 0.0, LIMITS) is None
    trip = check(sample(**outside), 0.0, LIMITS)
    assert trip is not None
    assert (trip.check, trip.limit, trip.time) == (kind, limit, 1.25)


def test_current_limit_below_the_torque_limit() -> None:
    limits = dataclasses.replace(LIMITS, current=10.0)
    assert check(sample(current=10.0), 0.0, limits) is None
    trip = check(sample(current=-above(10.0)), 0.0, limits)
    assert trip is not None
    assert (trip.check, trip.limit) == (Check.CURRENT, 10.0)


def test_sample_age() -> None:
    assert check(sample(), 0.005, LIMITS) is None
    trip = check(sample(), above(0.005), LIMITS)
    assert trip is not None
    assert trip.check is Check.SAMPLE_AGE


@pytest.mark.parametrize("name", ["angle", "velocity", "current", "following_error", "motor_angle", "temperature"])
def test_not_a_number_trips(name: str) -> None:
    assert check(sample(**{name: math.nan}), 0.0, LIMITS) is not None


def test_an_age_that_is_not_a_number_trips() -> None:
    assert check(sample(), math.nan, LIMITS) is not None


@pytest.mark.parametrize("kind", [k for k in Check if k is not Check.NOT_RESET])
def test_every_message_states_value_limit_unit_and_remedy(kind: Check) -> None:
    changes: dict[Check, dict[str, float]] = {
        Check.ANGLE: {"angle": 1.0},
        Check.SPEED: {"velocity": 3.0},
        Check.CURRENT: {"current": 30.0},
        Check.TORQUE: {"current": 21.0},
        Check.FOLLOWING_ERROR: {"following_error": 1.0},
        Check.DISAGREEMENT: {"motor_angle": 90.0},
        Check.TEMPERATURE: {"temperature": 99.0},
        Check.DRIVE_STATE: {"statusword": 0x0218},
        Check.SAMPLE_AGE: {},
    }
    trip = check(sample(**changes[kind]), 1.0 if kind is Check.SAMPLE_AGE else 0.0, LIMITS)
    assert trip is not None
    assert trip.check is kind
    assert "at 1.250 s; " in trip.message
    if kind is not Check.DRIVE_STATE:
        assert kind.value in trip.message
        assert "limit" in trip.message


def test_the_latch_starts_open_and_good_samples_do_not_close_it() -> None:
    latch = Latch()
    assert latch.trip is not None
    assert latch.judge(sample(), 0.0, LIMITS) is not None
    assert "not been reset" in latch.trip.message


def test_reset_needs_a_good_sample() -> None:
    latch = Latch()
    assert latch.reset(sample(velocity=9.0), 0.0, LIMITS) is not None
    assert latch.trip is not None
    assert latch.reset(sample(), 0.0, LIMITS) is None
    assert latch.trip is None


@given(st.floats(-10, 10), st.floats(-10, 10))
def test_the_latch_keeps_its_first_trip(first: float, second: float) -> None:
    latch = Latch()
    latch.reset(sample(), 0.0, LIMITS)
    tripped = latch.judge(sample(velocity=first), 0.0, LIMITS)
    after = latch.judge(sample(velocity=second), 0.0, LIMITS)
    if tripped is not None:
        assert after is tripped
    else:
        assert (after is None) == (abs(second) <= 2.0)
