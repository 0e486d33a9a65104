"""Both sides of every limit, and a latch that only a good sample and a reset can close."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.common.sample import Sample
from rig.control.safety import Check, Latch, Trip, check, check_stage_time
from rig.planning.limits import GasLimits, Limits

LIMITS = Limits(
    angle_min=-0.5,
    angle_max=0.6,
    speed=2.0,
    torque=60.0,
    current=25.0,
    following_error=0.03,
    encoder_disagreement=0.01,
    temperature=80.0,
    supply_min=48.0,
    supply_max=72.0,
    sample_age=0.005,
    lateness=0.02,
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
        "supply_voltage": 60.0,
        "statusword": 0x0637,
        "fresh": True,
    }
    return Sample(**(values | changes))  # type: ignore[arg-type]


def above(value: float) -> float:
    return math.nextafter(value, math.inf)


def below(value: float) -> float:
    return math.nextafter(value, -math.inf)


def test_what_a_drive_does_not_report_is_not_checked_and_all_else_is() -> None:
    blind = dataclasses.replace(
        LIMITS, temperature=math.inf, supply_min=-math.inf, supply_max=math.inf
    )
    silent = {"temperature": math.nan, "supply_voltage": math.nan}
    assert check(sample(**silent), 0.0, 0.0, blind) is None
    assert check(sample(**silent, current=25.1), 0.0, 0.0, blind) is not None
    # Without an upper limit the lower one holds, and a reading that fails still trips.
    open_ended = dataclasses.replace(LIMITS, supply_max=math.inf)
    for supply in (47.9, math.nan):
        trip = check(sample(supply_voltage=supply), 0.0, 0.0, open_ended)
        assert trip.check is Check.SUPPLY


def test_a_good_sample_passes() -> None:
    assert check(sample(), LIMITS.sample_age, LIMITS.lateness, LIMITS) is None


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
        (
            Check.FOLLOWING_ERROR,
            {"following_error": -0.03},
            {"following_error": -above(0.03)},
            0.03,
        ),
        (Check.DISAGREEMENT, {"motor_angle": 10.99}, {"motor_angle": 11.01}, 0.01),
        (Check.DISAGREEMENT, {"motor_angle": 9.01}, {"motor_angle": 8.99}, 0.01),
        (Check.TEMPERATURE, {"temperature": 80.0}, {"temperature": above(80.0)}, 80.0),
        (Check.SUPPLY, {"supply_voltage": 48.0}, {"supply_voltage": below(48.0)}, 48.0),
        (Check.SUPPLY, {"supply_voltage": 72.0}, {"supply_voltage": above(72.0)}, 72.0),
        (Check.DRIVE_STATE, {"statusword": 0x0637}, {"statusword": 0x0618}, 0x27),
        (Check.DRIVE_STATE, {"statusword": 0x0027}, {"statusword": 0x0007}, 0x27),
    ],
)
def test_both_sides_of_a_limit(kind, inside, outside, limit):
    assert check(sample(**inside), 0.0, 0.0, LIMITS) is None
    trip = check(sample(**outside), 0.0, 0.0, LIMITS)
    assert (trip.check, trip.limit, trip.time) == (kind, limit, 1.25)


def test_current_limit_below_the_torque_limit() -> None:
    limits = dataclasses.replace(LIMITS, current=10.0)
    assert check(sample(current=10.0), 0.0, 0.0, limits) is None
    trip = check(sample(current=-above(10.0)), 0.0, 0.0, limits)
    assert (trip.check, trip.limit) == (Check.CURRENT, 10.0)


@pytest.mark.parametrize(
    "name",
    [
        "angle",
        "velocity",
        "current",
        "following_error",
        "motor_angle",
        "temperature",
        "supply_voltage",
    ],
)
def test_not_a_number_trips(name: str) -> None:
    assert check(sample(**{name: math.nan}), 0.0, 0.0, LIMITS) is not None


def test_an_age_or_lateness_that_is_not_a_number_trips() -> None:
    assert check(sample(), math.nan, 0.0, LIMITS) is not None
    assert check(sample(), 0.0, math.nan, LIMITS) is not None


def test_time_under_power() -> None:
    assert check_stage_time(30.0, 30.0, 7.0) is None
    trip = check_stage_time(above(30.0), 30.0, 7.0)
    assert trip == Trip(Check.STAGE_TIME, above(30.0), 30.0, "s", 7.0)
    assert (
        "time under power in this stage 30 s is beyond its limit 30 s at 7.000 s; " in trip.message
    )
    assert check_stage_time(math.nan, 30.0, 7.0) is not None


@pytest.mark.parametrize(
    ("changes", "age", "late", "found"),
    [
        ({}, 0.0, 1.0, (Check.LATENESS, 1.0, 0.02, "s")),
        ({}, 1.0, 0.0, (Check.SAMPLE_AGE, 1.0, 0.005, "s")),
        ({"statusword": 0x0618}, 0.0, 0.0, (Check.DRIVE_STATE, 0x0618, 0x27, "1")),
        ({"angle": 0.7}, 0.0, 0.0, (Check.ANGLE, 0.7, 0.6, "rad")),
        ({"velocity": -3.0}, 0.0, 0.0, (Check.SPEED, 3.0, 2.0, "rad/s")),
        ({"current": -26.0}, 0.0, 0.0, (Check.CURRENT, 26.0, 25.0, "A")),
        ({"current": -21.0}, 0.0, 0.0, (Check.TORQUE, 63.0, 60.0, "N m")),
        ({"following_error": -1.0}, 0.0, 0.0, (Check.FOLLOWING_ERROR, 1.0, 0.03, "rad")),
        ({"angle": 0.5, "motor_angle": 25.0}, 0.0, 0.0, (Check.DISAGREEMENT, 0.25, 0.01, "rad")),
        ({"temperature": 99.0}, 0.0, 0.0, (Check.TEMPERATURE, 99.0, 80.0, "deg C")),
        ({"supply_voltage": 12.0}, 0.0, 0.0, (Check.SUPPLY, 12.0, 48.0, "V")),
    ],
)
def test_a_trip_says_what_it_saw(changes, age, late, found):
    assert check(sample(**changes), age, late, LIMITS) == Trip(*found, 1.25)


@pytest.mark.parametrize(
    ("order", "changes"),
    [
        ((Check.DRIVE_STATE, Check.ANGLE), {"statusword": 0x0618, "angle": 9.0}),
        ((Check.ANGLE, Check.SPEED), {"angle": 9.0, "velocity": 9.0}),
        ((Check.SPEED, Check.CURRENT), {"velocity": 9.0, "current": 99.0}),
        ((Check.CURRENT, Check.TORQUE), {"current": 99.0}),
        ((Check.TORQUE, Check.FOLLOWING_ERROR), {"current": 22.0, "following_error": 1.0}),
        (
            (Check.FOLLOWING_ERROR, Check.DISAGREEMENT),
            {"following_error": 1.0, "motor_angle": 90.0},
        ),
        ((Check.DISAGREEMENT, Check.TEMPERATURE), {"motor_angle": 90.0, "temperature": 99.0}),
        ((Check.TEMPERATURE, Check.SUPPLY), {"temperature": 99.0, "supply_voltage": 0.0}),
    ],
)
def test_of_two_broken_limits_the_cause_is_named(order, changes):
    trip = check(sample(**changes), 0.0, 0.0, LIMITS)
    assert trip.check is order[0]


HOT = dataclasses.replace(
    LIMITS,
    gas=GasLimits(
        pressure=6e6,
        contact_force=4000.0,
        back_pressure=0.5e6,
        area=lambda angle: 8e-4 - 1e-3 * angle,
    ),
)
"""At 0.1 rad the area is 7e-4 m^2, and 4000 N are 6.214 MPa; at 0 rad they are 5.5 MPa."""


@pytest.mark.parametrize(
    ("kind", "inside", "outside", "limit"),
    [
        (Check.PRESSURE, {"pressure": 6e6}, {"pressure": above(6e6)}, 6e6),
        (
            Check.CONTACT_FORCE,
            {"pressure": 5.5e6, "angle": 0.0},
            {"pressure": 5.5e6 + 1.0, "angle": 0.0},
            4000.0,
        ),
    ],
)
def test_both_sides_of_the_gas_limits(kind, inside, outside, limit):
    assert check(sample(**inside), 0.0, 0.0, HOT) is None
    trip = check(sample(**outside), 0.0, 0.0, HOT)
    assert (trip.check, trip.limit, trip.time) == (kind, limit, 1.25)
    assert trip.unit == {Check.PRESSURE: "Pa", Check.CONTACT_FORCE: "N"}[kind]
    assert trip.value > limit
    # The same sample means nothing to a bench without a transmitter.
    assert check(sample(**outside), 0.0, 0.0, LIMITS) is None


def test_a_transmitter_that_says_nothing_trips() -> None:
    trip = check(sample(pressure=math.nan), 0.0, 0.0, HOT)
    assert trip.check is Check.PRESSURE


def test_a_force_that_is_no_number_trips() -> None:
    assert HOT.gas is not None
    blind = dataclasses.replace(HOT, gas=dataclasses.replace(HOT.gas, area=lambda _angle: math.nan))
    trip = check(sample(pressure=1e6), 0.0, 0.0, blind)
    assert trip.check is Check.CONTACT_FORCE


def test_a_disagreement_of_exactly_the_limit_passes() -> None:
    limits = dataclasses.replace(LIMITS, encoder_disagreement=0.25)
    assert check(sample(angle=0.5, motor_angle=75.0), 0.0, 0.0, limits) is None
    assert check(sample(angle=0.5, motor_angle=above(75.0)), 0.0, 0.0, limits) is not None


def asked() -> Latch:
    latch = Latch()
    latch.ask()
    return latch


def test_the_latch_closes_only_by_a_reset_that_was_asked_for() -> None:
    latch = Latch()
    assert latch.trip == Trip(Check.NOT_RESET, 0.0, 0.0, "1", 0.0)
    assert "its reset was not requested" in latch.trip.message
    assert latch.judge(sample(), 0.0, 0.0, LIMITS) is latch.trip
    trip = latch.reset(sample(), 0.0, 0.0, LIMITS)
    assert trip.check is Check.NOT_RESET
    assert latch.trip is trip
    latch.ask()
    assert latch.reset(sample(), 0.0, 0.0, LIMITS) is None
    # A closed latch opens again at a reset that nobody asked for.
    opened = latch.reset(sample(), 0.0, 0.0, LIMITS)
    assert opened.check is Check.NOT_RESET
    # Opened on purpose, it forgets what was asked for before.
    latch.ask()
    assert latch.reset(sample(), 0.0, 0.0, LIMITS) is None
    latch.ask()
    latch.open()
    assert latch.trip == opened
    assert latch.reset(sample(), 0.0, 0.0, LIMITS) == opened


@pytest.mark.parametrize(
    ("changes", "age", "late", "why"),
    [
        ({"velocity": 9.0}, 0.0, 0.0, Check.SPEED),
        ({}, 1.0, 0.0, Check.SAMPLE_AGE),
        ({}, 0.0, 1.0, Check.LATENESS),
    ],
)
def test_reset_needs_good_inputs(changes, age, late, why):
    latch = asked()
    assert latch.reset(sample(**changes), age, late, LIMITS) is latch.trip
    assert latch.trip.check is why
    # Asking was good for one reset: the next needs another.
    assert latch.reset(sample(), 0.0, 0.0, LIMITS) is not None
    latch.ask()
    assert latch.reset(sample(), 0.0, 0.0, LIMITS) is None
    assert latch.trip is None


@pytest.mark.parametrize(("age", "late"), [(1.0, 0.0), (0.0, 1.0)])
def test_the_latch_judges_age_and_lateness(age: float, late: float) -> None:
    latch = asked()
    latch.reset(sample(), 0.0, 0.0, LIMITS)
    assert latch.judge(sample(), 0.0, 0.0, LIMITS) is None
    trip = latch.judge(sample(), age, late, LIMITS)
    assert trip.check is (Check.SAMPLE_AGE if age else Check.LATENESS)


def test_a_trip_is_not_cleared_by_a_reset_that_nobody_asked_for() -> None:
    latch = asked()
    latch.reset(sample(), 0.0, 0.0, LIMITS)
    trip = latch.judge(sample(velocity=9.0), 0.0, 0.0, LIMITS)
    assert latch.reset(sample(), 0.0, 0.0, LIMITS) is trip
    assert latch.trip is trip


@given(st.floats(-10, 10), st.floats(-10, 10))
def test_the_latch_keeps_its_first_trip(first: float, second: float) -> None:
    latch = asked()
    latch.reset(sample(), 0.0, 0.0, LIMITS)
    tripped = latch.judge(sample(velocity=first), 0.0, 0.0, LIMITS)
    after = latch.judge(sample(velocity=second), 0.0, 0.0, LIMITS)
    if tripped is not None:
        assert after is tripped
    else:
        assert (after is None) == (abs(second) <= 2.0)


@pytest.mark.parametrize(
    ("name", "flag"), [("temperature", "reports_temperature"), ("supply_voltage", "reports_supply")]
)
def test_only_a_value_that_the_drive_does_not_report_is_left_out(name: str, flag: str) -> None:
    missing = sample(**{name: math.nan})
    assert check(missing, 0.0, 0.0, LIMITS) is not None
    blind = dataclasses.replace(LIMITS, **{flag: False})
    assert check(missing, 0.0, 0.0, blind) is None
    for other in ("temperature", "supply_voltage", "velocity", "current", "angle"):
        if other != name:
            assert check(sample(**{name: math.nan, other: math.nan}), 0.0, 0.0, blind) is not None
