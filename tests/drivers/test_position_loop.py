"""The position loop of the host, as a pure function."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.position_loop import (
    AT_REST,
    LoopGains,
    LoopLimits,
    LoopState,
    derived,
    step,
)
from drivers.errors import ConfigurationError

LIMITS = LoopLimits(-0.5, 0.5, 2.0, 75.0, 35.0)
CYCLE_S = 0.001
ANGLES = st.floats(-3.0, 3.0)
SPEEDS = st.floats(-20.0, 20.0)


@given(ANGLES, ANGLES, SPEEDS, ANGLES, st.floats(-500.0, 500.0))
def test_no_command_leads_over_a_limit(
    target: float, angle: float, speed: float, before: float, integral: float
) -> None:
    gains = derived(CYCLE_S, 0.2)
    state = LoopState(before, integral)
    _, asked, torque = step(state, gains, LIMITS, CYCLE_S, target, angle, speed)
    assert abs(asked) <= LIMITS.speed_rad_s
    left = (LIMITS.angle_max_rad if asked > 0 else -LIMITS.angle_min_rad) - math.copysign(
        angle, angle * asked
    )
    if asked:
        assert asked * asked <= 2 * LIMITS.deceleration_rad_s2 * left * (1 + 1e-9)
    assert abs(torque) <= LIMITS.torque_N_m
    if abs(speed) > LIMITS.speed_rad_s:
        assert torque * speed <= 0.0


def test_the_speed_of_the_target_is_fed_forward() -> None:
    gains = derived(CYCLE_S, None)
    state, first, _ = step(AT_REST, gains, LIMITS, CYCLE_S, 0.1, 0.1, 0.0)
    assert first == 0.0
    _, second, _ = step(state, gains, LIMITS, CYCLE_S, 0.1005, 0.1, 0.0)
    assert second == pytest.approx(0.5 + 60 * 0.0005)


def test_the_integral_does_not_grow_in_the_limit() -> None:
    gains = derived(CYCLE_S, 0.2)
    state = AT_REST
    for _ in range(5000):
        state, _, torque = step(state, gains, LIMITS, CYCLE_S, 0.4, -0.4, 0.0)
    assert torque <= LIMITS.torque_N_m
    assert abs(state.integral_N_m) <= LIMITS.torque_N_m


@pytest.mark.parametrize("name", ["target", "angle", "speed"])
def test_a_missing_value_is_no_command(name: str) -> None:
    values = {"target": 0.0, "angle": 0.0, "speed": 0.0, name: math.nan}
    with pytest.raises(ConfigurationError, match="a value is missing"):
        step(AT_REST, derived(CYCLE_S, 0.2), LIMITS, CYCLE_S, *values.values())


@pytest.mark.parametrize("cycle_s", [0.001, 0.002, 0.01, 0.1])
def test_gains_that_are_derived_hold_a_bare_inertia(cycle_s: float) -> None:
    """With two cycles between a sample and the effect of its command."""
    inertia, gains, state = 0.2, derived(cycle_s, 0.2), AT_REST
    angle = speed = 0.0
    waiting = [0.0]
    for _ in range(3000):
        state, _, torque = step(state, gains, LIMITS, cycle_s, 0.3, angle, speed)
        waiting.append(torque)
        speed += waiting.pop(0) / inertia * cycle_s
        angle += speed * cycle_s
    assert angle == pytest.approx(0.3, abs=1e-3)
    assert speed == pytest.approx(0.0, abs=1e-3)


def test_stated_gains_are_kept() -> None:
    assert derived(CYCLE_S, 0.2, LoopGains(7.0, 8.0, 9.0)) == LoopGains(7.0, 8.0, 9.0)
    assert derived(CYCLE_S, None, LoopGains(7.0, 8.0, 9.0)) == LoopGains(7.0)
    assert derived(CYCLE_S, 0.0, LoopGains(0.0, 8.0)).position_1_s == 60.0
