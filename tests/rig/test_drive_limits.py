"""The bench's limits beside the drive's own."""

import dataclasses
import math
from typing import Any

import pytest

from drivers.errors import ConfigurationError, LinkError
from drivers.interfaces import LimitSteps, ServoLimits
from drivers.servo_limits import decode, encode, steps
from drivers.units import ServoScales
from rig.runs.run_record import Ending
from rig.wiring.drive_limits import compare, loosened, require_held, require_within_own

WANTED = ServoLimits(-0.5, 0.6, 2.0, 60.0, 25.0, 0.03, 2, 35.0)


def changed(**values: float | None) -> ServoLimits:
    return dataclasses.replace(WANTED, **values)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("field", "tighter", "looser"),
    [
        ("angle_min_rad", -0.4, -0.502),
        ("angle_max_rad", 0.5, 0.602),
        ("speed_rad_s", 1.9, 2.003),
        ("torque_N_m", 59.0, 60.1),
        ("current_A", 24.0, 25.1),
        ("following_error_rad", 0.02, 0.0301),
        ("following_error_rad", 0.02, None),
    ],
)
def test_both_sides_of_each_limit(field: str, tighter: float, looser: float | None) -> None:
    require_held(changed(**{field: tighter}), WANTED)
    with pytest.raises(ConfigurationError, match="does not hold the limits written into it"):
        require_held(changed(**{field: looser}), WANTED)
    require_within_own(changed(**{field: tighter}), WANTED)
    with pytest.raises(ConfigurationError, match="looser than the drive's own limits"):
        require_within_own(changed(**{field: looser}), WANTED)
    assert [row.field for row in compare(changed(**{field: looser}), WANTED) if row.looser] == [
        field
    ]


STEPS = LimitSteps(0.01, 0.02, 0.5, 0.1, 0.001, 0.3)
COARSE = (
    ("angle_min_rad", -0.01),
    ("angle_max_rad", 0.01),
    ("speed_rad_s", 0.02),
    ("torque_N_m", 0.5),
    ("current_A", 0.1),
    ("following_error_rad", 0.001),
)


@pytest.mark.parametrize(("field", "step"), COARSE)
@pytest.mark.parametrize(("share", "same"), [(0.5, True), (1.0, True), (1.01, False), (2.0, False)])
def test_limits_within_one_step_of_the_drive_are_the_same(field, step, share, same):
    other = changed(**{field: getattr(WANTED, field) + share * step})
    assert [row.looser for row in compare(other, WANTED, STEPS) if row.field == field] == [not same]
    if same:
        require_held(other, WANTED, STEPS)
        require_within_own(other, WANTED, STEPS)
        return
    with pytest.raises(ConfigurationError, match="does not hold"):
        require_held(other, WANTED, STEPS)
    with pytest.raises(ConfigurationError, match="looser than the drive's own"):
        require_within_own(other, WANTED, STEPS)


@pytest.mark.parametrize(("share", "same"), [(1.0, True), (1.01, False)])
def test_a_ramp_within_one_step_is_the_same(share: float, same: bool) -> None:
    slower = changed(quick_stop_deceleration_rad_s2=35.0 - share * 0.3)
    row = next(
        r for r in compare(slower, WANTED, STEPS) if r.field == "quick_stop_deceleration_rad_s2"
    )
    assert row.looser is not same


@pytest.mark.parametrize(
    ("rated_A", "rated_N_m", "gear", "current", "torque"),
    [
        (15.0, 0.45, 100.0, 5.0, 12.0),
        (3.21, 0.0302, 51.0, 5.0, 3.885),
        (1.0, 0.388, 1.0, 0.4995, 0.3885),
    ],
)
def test_what_a_run_wrote_does_not_refuse_the_next(rated_A, rated_N_m, gear, current, torque):
    scales = ServoScales(4096, gear, rated_A, rated_N_m)
    asked = changed(current_A=current, torque_N_m=torque)
    left = decode(encode(asked, scales), scales)
    assert left.current_A <= asked.current_A
    assert left.torque_N_m <= asked.torque_N_m
    require_within_own(asked, left, steps(scales))
    more = changed(
        current_A=left.current_A + max(1.1 * scales.current_unit_A, 1.1e-3 * left.current_A),
        torque_N_m=left.torque_N_m
        + max(1.1 * scales.joint_torque_unit_N_m, 1.1e-3 * left.torque_N_m),
    )
    rows = [row.field for row in loosened(more, left, steps(scales))]
    assert rows == ["torque_N_m", "current_A"]


def test_a_limit_that_is_not_a_number_is_looser() -> None:
    with pytest.raises(ConfigurationError):
        require_held(changed(current_A=math.nan), WANTED)


def test_the_drive_must_brake_as_asked() -> None:
    require_held(changed(quick_stop_deceleration_rad_s2=40.0), WANTED)
    with pytest.raises(
        ConfigurationError,
        match=r"quick stop deceleration .6085h.: drive 1719 deg/s.2, wanted 2005",
    ):
        require_held(changed(quick_stop_deceleration_rad_s2=30.0), WANTED)
    with pytest.raises(ConfigurationError, match=r"quick stop option .605Ah.: drive 6, wanted 2"):
        require_held(changed(quick_stop_option=6), WANTED)


def test_the_bench_file_sets_how_to_brake_but_may_not_keep_the_power_on() -> None:
    require_within_own(changed(quick_stop_deceleration_rad_s2=1.0), WANTED)
    require_within_own(WANTED, changed(quick_stop_option=6))
    require_within_own(changed(quick_stop_option=6), changed(quick_stop_option=5))
    for option in range(9):
        rows = loosened(changed(quick_stop_option=option), WANTED)
        assert [row.field for row in rows] == ["quick_stop_option"] * (option in (5, 6, 7, 8))


def test_every_limit_is_named_at_once() -> None:
    with pytest.raises(ConfigurationError) as caught:
        require_within_own(changed(torque_N_m=99.0, speed_rad_s=9.0), WANTED)
    words = str(caught.value)
    assert "joint speed (607Fh): bench file 515.7 deg/s, drive 114.6 deg/s" in words
    assert "joint torque (6072h): bench file 99 N m, drive 60 N m" in words


def test_the_rounding_reaches_a_thousandth_and_no_further() -> None:
    for at, beyond, field in (
        (999.0, 998.999, "quick_stop_deceleration_rad_s2"),
        (1001.0, 1001.001, "torque_N_m"),
    ):
        wanted = changed(**{field: 1000.0})
        require_held(changed(**{field: at}), wanted)
        with pytest.raises(ConfigurationError):
            require_held(changed(**{field: beyond}), wanted)


def test_a_drive_that_holds_something_looser_is_not_enabled(runner, fake_bench, monkeypatch):
    def forgetful(self: Any, limits: ServoLimits) -> None:
        self.limits = dataclasses.replace(limits, speed_rad_s=2.9)

    monkeypatch.setattr(fake_bench, "write_limits", forgetful)
    bench = fake_bench()
    _, outcome = runner(bench)
    assert outcome.ending is Ending.FAILED
    assert "joint speed (607Fh): drive 166.2 deg/s, wanted 120 deg/s" in outcome.message
    assert bench.calls["enable"] == 0


def test_the_drive_gets_its_own_limits_back(runner: Any, fake_bench: Any) -> None:
    own = ServoLimits(-1.0, 1.0, 3.0, 80.0, 30.0, None, 2, 10.0)
    bench = fake_bench(limits=own)
    bench.faults["exchange", 700] = lambda: bench.overrides.update(current_A=26.0)
    _, outcome = runner(bench)
    assert outcome.ending is Ending.TRIPPED
    assert bench.limits == own
    assert bench.order[-2:] == ["state", "write_limits"]


def test_a_drive_that_stays_on_keeps_the_tight_limits(runner: Any, fake_bench: Any) -> None:
    def gone() -> None:
        raise LinkError("gone")

    bench = fake_bench(overrides={"stuck": True})
    for call in range(1, 1000):
        bench.faults["quick_stop", call] = gone
    _, outcome = runner(bench)
    assert not outcome.safe.verified
    assert bench.limits == runner.plan.servo_limits


def test_only_a_limit_that_the_drive_has_no_object_for_is_left_out() -> None:
    held = changed(torque_N_m=math.nan, quick_stop_option=-1)
    unheld = frozenset({"torque_N_m", "quick_stop_option"})
    every = frozenset(field.name for field in dataclasses.fields(ServoLimits))
    require_held(held, WANTED, STEPS, taken=every - unheld)
    require_within_own(WANTED, held, STEPS, unheld=unheld)
    for part in (frozenset({"torque_N_m"}), frozenset({"quick_stop_option"}), frozenset()):
        with pytest.raises(ConfigurationError):
            require_held(held, WANTED, STEPS, taken=every - part)
    looser = changed(torque_N_m=math.nan, current_A=99.0)
    with pytest.raises(ConfigurationError, match="motor current"):
        require_held(looser, WANTED, STEPS, taken=every - unheld)
