"""A reported speed in another unit ends a run as soon as the joint has moved."""

from __future__ import annotations

import math
from typing import Any

import pytest

from drivers.errors import ConfigurationError
from drivers.interfaces import Lacks
from rig.control.cycle import Cycle
from rig.control.motion_proof import LONGEST_S, STEP_RAD, STEPS, SpeedWitness
from rig.control.readings import at_rest
from rig.control.session import Ending

from .test_safety import LIMITS

GEAR = LIMITS.gear_ratio


class Remedies:
    """A drive that names the factor as its remedy."""

    def speed_remedy(self, factor: float) -> str:
        return f"factor {factor:.4f}"


def witnessed(
    factor: float, speed: float = 0.2, cycles: int = 1000, start_s: float = 0.0, **changes: Any
) -> int | None:
    """Return the cycle in which the speed was found good; None where it is not decided."""
    witness = SpeedWitness(Remedies(), GEAR)  # type: ignore[arg-type]
    calm = at_rest(LIMITS)
    for cycle in range(cycles):
        time = 1e-3 * cycle
        moved = calm._replace(
            time=start_s + time, motor_angle=speed * time * GEAR, velocity=factor * speed, **changes
        )
        if witness.decided(moved):
            return cycle
    return None


@pytest.mark.parametrize("factor", [0.3, 0.7, 1.0, 3.9])
def test_the_same_unit_is_found_after_some_travel(factor: float) -> None:
    for start_s in (0.0, 100.0):
        found = witnessed(factor, start_s=start_s)
        assert found == pytest.approx(STEPS * STEP_RAD / 0.2 * 1e3, abs=3 * STEPS)


def test_three_travels_of_a_hundredth_of_a_radian_decide() -> None:
    assert (STEPS, STEP_RAD, LONGEST_S) == (3, 0.01, 1.0)


@pytest.mark.parametrize("speed", [0.2, -0.2])
@pytest.mark.parametrize("factor", [0.0, 1 / 68.3, 0.2, 6.0, 9.55, 68.3, -1.0])
def test_another_unit_is_refused_with_the_factor(factor: float, speed: float) -> None:
    with pytest.raises(ConfigurationError) as caught:
        witnessed(factor, speed)
    assert str(caught.value).endswith(
        f"must be 0.25 to 4 times: factor {factor:.4f}".replace("-0.0000", "0.0000")
    )


def test_a_joint_at_rest_decides_nothing() -> None:
    assert witnessed(1.0, speed=0.0) is None
    assert witnessed(68.0, speed=0.0) is None


def test_too_slow_a_travel_and_stale_samples_decide_nothing() -> None:
    assert witnessed(68.0, speed=0.9 * STEP_RAD, cycles=10_000) is None
    assert witnessed(68.0, fresh=False) is None


def test_a_run_ends_before_its_first_stage_and_takes_the_power_off(
    runner: Any, fake_bench: Any
) -> None:
    bench = fake_bench()
    follow = bench.exchange

    def wrong() -> None:
        follow()
        bench.speed *= 1 / 68.3

    bench.exchange = wrong
    _, outcome = runner(bench)
    assert outcome.ending is Ending.FAILED
    assert "the speed that the drive reports is 0.01464 times the change" in outcome.message
    assert outcome.safe.verified
    assert bench.calls["quick_stop"] == 1
    assert max(map(abs, bench.targets)) < 0.1 + 2 * STEPS * STEP_RAD


def test_limits_on_what_a_drive_does_not_report_are_not_checked(fake_bench: Any) -> None:
    bench = fake_bench()
    bench.lacks = lambda cycle_s: Lacks(temperature=True)
    cycle = Cycle(LIMITS, 1_000_000, bench.devices(), None, None, None)  # type: ignore[arg-type]
    assert cycle._limits.reports_supply
    assert not cycle._limits.reports_temperature
    cycle.use(LIMITS)
    assert not cycle._limits.reports_temperature
    assert math.isfinite(cycle._limits.temperature)
