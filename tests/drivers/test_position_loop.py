"""The position loop of the host, as a pure function."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.motion import AT_REST, LoopGains, LoopState, derived, step
from drivers.errors import ConfigurationError
from drivers.interfaces import ServoLimits

LIMITS = ServoLimits(-0.5, 0.5, 2.0, 75.0, 25.0, 0.03, 2, 35.0)
CYCLE_S = 0.001
ANGLES = st.floats(-3.0, 3.0)
SPEEDS = st.floats(-20.0, 20.0)


@given(ANGLES, ANGLES, SPEEDS, ANGLES, st.floats(-500.0, 500.0))
def test_no_command_leads_over_a_limit(target, angle, speed, before, integral):
    gains = derived(CYCLE_S, 0.2)
    state = LoopState(before, integral)
    _, asked, torque = step(state, gains, LIMITS, CYCLE_S, target, angle, speed)
    assert abs(asked) <= LIMITS.speed_rad_s
    left = (LIMITS.angle_max_rad if asked > 0 else -LIMITS.angle_min_rad) - math.copysign(
        angle, angle * asked
    )
    if asked:
        assert asked * asked <= 2 * LIMITS.quick_stop_deceleration_rad_s2 * left * (1 + 1e-9)
    assert abs(torque) <= LIMITS.torque_N_m
    if abs(speed) > LIMITS.speed_rad_s:
        assert torque * speed <= 0.0


@pytest.mark.parametrize("name", ["target", "angle", "speed"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_missing_value_is_no_command(name: str, value: float) -> None:
    values = {"target": 0.5, "angle": 0.25, "speed": 0.125, name: value}
    target, angle, speed = values.values()
    with pytest.raises(ConfigurationError):
        step(AT_REST, derived(CYCLE_S, 0.2), LIMITS, CYCLE_S, target, angle, speed)


GAINS = LoopGains(10.0, 5.0, 4.0)


def test_one_step_in_figures() -> None:
    state, speed, torque = step(LoopState(0.1999, 1.0), GAINS, LIMITS, CYCLE_S, 0.2, 0.1, 0.3)
    assert speed == pytest.approx(0.1 + 10 * 0.1)
    assert state.target_rad == 0.2
    assert state.integral_N_m == pytest.approx(1.0 + 5 * 4 * 0.001 * 0.8)
    assert torque == pytest.approx(5 * 0.8 + state.integral_N_m)
    assert AT_REST.integral_N_m == 0.0


@pytest.mark.parametrize(
    ("integral", "speed", "grows"), [(74.0, 0.5, False), (-74.0, 1.5, False), (90.0, 1.1, True)]
)
def test_in_the_torque_limit_the_integral_only_shrinks(integral, speed, grows):
    """The speed that is asked for is 1 rad/s; the third error leads out of the limit."""
    state, asked, torque = step(LoopState(0.2, integral), GAINS, LIMITS, CYCLE_S, 0.2, 0.1, speed)
    assert asked == pytest.approx(1.0)
    assert torque == math.copysign(75.0, integral)
    assert (state.integral_N_m != integral) is grows


@pytest.mark.parametrize(
    ("angle", "target", "speed"),
    [
        (0.45, 9.0, math.sqrt(2 * 35 * 0.05)),
        (-0.45, -9.0, -math.sqrt(2 * 35 * 0.05)),
        (0.0, 9.0, 2.0),
        (0.5, 9.0, 0.0),
        (0.6, 9.0, 0.0),
        (-0.6, -9.0, 0.0),
        (0.6, 0.5, -1.0),
    ],
)
def test_the_speed_in_front_of_an_end(angle: float, target: float, speed: float) -> None:
    _, found, _ = step(AT_REST, LoopGains(10.0), LIMITS, CYCLE_S, target, angle, 0.0)
    assert found == pytest.approx(speed)


def test_the_gains_that_follow_from_cycle_and_inertia() -> None:
    assert derived(0.001, None) == LoopGains(60.0)
    assert derived(0.0005, None) == LoopGains(60.0)
    assert derived(0.01, None) == LoopGains(pytest.approx(6.0))
    tuned = derived(0.01, 0.2)
    assert (tuned.position_1_s, tuned.speed_N_m_s_rad, tuned.reset_1_s) == pytest.approx(
        (6.0, 3.0, 3.0)
    )
    slow = derived(0.001, 0.2, LoopGains(0.0, 8.0))
    assert (slow.position_1_s, slow.reset_1_s) == pytest.approx((16.0, 8.0))


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
