"""The flow controller by itself: what it asks for, where it stops, and that it does not wind up
there.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.model.gas_generator import GasGenerator, equilibrium_pressure, throat_area
from rig.common.sample import Sample
from rig.config.sequence import FlowController, FlowSection, FlowStep
from rig.planning.hot_fire import (
    LawState,
    Regulator,
    angle_for,
    control,
    make_law,
    pressure_for,
)

CYCLE_S = 1e-3
LAW = make_law(FlowController(), CYCLE_S, math.radians(120.0))


def held(angle: float, pressure: float) -> LawState:
    return LawState(pressure, angle, angle)


def test_pressure_as_wanted_leaves_the_valve_where_it_is() -> None:
    state = held(0.2, 2e6)
    assert control(LAW, state, 2e6, 2e6) == state


def test_too_much_pressure_opens_the_valve_by_gain_and_integral() -> None:
    state = held(0.2, 2e6)
    wanted = 2e6 / math.exp(0.005)
    after = control(LAW, state, wanted, 2e6)
    assert after.angle - 0.2 == pytest.approx(
        math.radians(8.0) * 0.005 * (1.0 + 8.0 * CYCLE_S), rel=1e-9
    )


def test_a_step_is_no_faster_than_the_valve_may_go() -> None:
    after = control(LAW, held(0.2, 2e6), 1e6, 2e6)
    assert after.angle - 0.2 == pytest.approx(math.radians(50.0) * CYCLE_S)
    slow = make_law(FlowController(), CYCLE_S, math.radians(10.0))
    assert control(slow, held(0.2, 2e6), 1e6, 2e6).angle - 0.2 == pytest.approx(
        math.radians(10.0) * CYCLE_S
    )


def test_at_its_bound_the_integral_waits() -> None:
    state = held(LAW.most, 2e6)
    for _ in range(5000):
        state = control(LAW, state, 0.5e6, 2e6)
    assert state.angle == LAW.most
    assert state.integral == LAW.most
    # Once the pressure falls below what is wanted, it leaves the bound at once.
    state = LawState(0.4e6, state.integral, state.angle)
    assert control(LAW, state, 0.5e6, 0.4e6).angle < LAW.most


def test_from_outside_its_range_it_comes_back_at_its_own_speed() -> None:
    state = held(-0.1, 2e6)
    after = control(LAW, state, 2e6, 2e6)
    assert after.angle == pytest.approx(-0.1 + LAW.step)


@given(
    angle=st.floats(0.0, LAW.most),
    pressure=st.floats(1e5, 1e7),
    wanted=st.floats(1e5, 1e7),
    reading=st.floats(-1e6, 2e7),
)
def test_it_always_stays_in_range_and_below_its_speed(
    angle: float, pressure: float, wanted: float, reading: float
) -> None:
    after = control(LAW, held(angle, pressure), wanted, reading)
    assert LAW.least <= after.angle <= LAW.most
    assert abs(after.angle - angle) <= LAW.step * (1.0 + 1e-9)


def test_the_regulator_starts_where_the_valve_is_and_answers_each_sample() -> None:
    regulator = Regulator(LAW, [2e6] * 3, 0.2)
    targets = regulator.targets()
    assert next(targets) == 0.2
    regulator.see(Sample(*[0.0] * 16, 2e6))  # type: ignore[arg-type]
    assert next(targets) == pytest.approx(0.2)
    regulator.see(Sample(*[0.0] * 16, 4e6))  # type: ignore[arg-type]
    assert next(targets) > 0.2


def test_a_flow_asks_for_its_pressure_and_angle() -> None:
    g = GasGenerator()
    angles = np.deg2rad([6.0, 15.0, 25.0])
    pressure = equilibrium_pressure(throat_area(angles, g.valve), g, exact=False)
    flow = g.rho_b * g.A_b * g.a * (pressure * 1e-6) ** g.n
    np.testing.assert_allclose(pressure_for(flow, g), pressure, rtol=1e-12)
    np.testing.assert_allclose(angle_for(flow, g), angles, atol=1e-5)
    # Beyond what the valve gives, the nearest angle at which its throat changes.
    assert np.rad2deg(angle_for(np.array([5.0, 0.1]), g)) == pytest.approx([4.23, 29.65], abs=0.02)


def test_the_command_goes_from_step_to_step() -> None:
    steps = (FlowStep(at_s=0.0, flow_kg_s=1.0), FlowStep(at_s=1.0, flow_kg_s=2.0))
    command = FlowSection(steps=steps, ramp_s=0.2).command(2.0, CYCLE_S)
    assert command.shape == (2000,)
    np.testing.assert_allclose(command[[0, 1000, 1100, 1200, 1999]], [1.0, 1.0, 1.5, 2.0, 2.0])
    np.testing.assert_allclose(
        FlowSection(steps=steps, ramp_s=0.0).command(2.0, CYCLE_S)[[1000, 1001]], [1.0, 2.0]
    )
