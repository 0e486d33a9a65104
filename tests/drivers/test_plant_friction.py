"""Set-valued friction: rest is exact, slip obeys the equation of motion, energy goes where the
closed form says.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from drivers.mock.plant.effects.friction import WORK_SIZE, step_slipping
from drivers.mock.plant.effects.pack import effect_vector
from drivers.mock.plant.machine import SimulatedMachine, friction_vector
from drivers.mock.plant.parts.constants import Joint, Machine, Sensing
from drivers.mock.plant.parts.friction import friction

JOINT = Joint()
STEP_S = 25e-6
FORCES_N = (0.0, 3000.0)
NO_EFFECTS = effect_vector(Machine())


def step_velocity(
    speed: float, held: float, torque: float, force_N: float
) -> tuple[float, float, float]:
    w = np.zeros(WORK_SIZE)
    p = friction_vector(JOINT, force_N)
    w[: len(p)] = p
    return step_slipping(speed, held, torque, STEP_S, w, NO_EFFECTS)


def magnitude(speed: float, force_N: float) -> float:
    """Eq. 9 and 13 with the printed values, written out."""
    system = 6.825 + (12.025 - 6.825) * math.exp(-((speed / 0.0557) ** 2)) + 5.3462 * speed
    load = 0.052 + (0.086 - 0.052) * math.exp(-((speed / 0.0326) ** 2)) + 0.032 * speed
    return system + force_N * 0.095 * load


def exact_machine() -> SimulatedMachine:
    return SimulatedMachine(Machine(sensing=Sensing(0, 0, 0.0)), np.random.default_rng(0))


@given(speed=st.floats(0.0, 3.0), force=st.floats(0.0, 5000.0))
def test_magnitude_is_eq_9_plus_13(speed: float, force: float) -> None:
    found, _ = friction(speed, friction_vector(JOINT, force))
    assert found == pytest.approx(magnitude(speed, force), rel=1e-13)


@given(
    speed=st.floats(1e-3, 3.0),
    force=st.floats(0.0, 5000.0),
    alpha=st.sampled_from([0.5, 1.0, 2.0, 3.0]),
)
def test_slope_is_the_derivative_of_the_magnitude(speed: float, force: float, alpha: float) -> None:
    p = friction_vector(Joint(alpha=alpha), force)
    h = 1e-5 * speed
    difference = (friction(speed + h, p)[0] - friction(speed - h, p)[0]) / (2.0 * h)
    assert friction(speed, p)[1] == pytest.approx(difference, rel=1e-4, abs=1e-4)


@given(share=st.floats(-1.0, 1.0), force=st.floats(0.0, 5000.0))
def test_shaft_at_rest_stays_exactly_there_below_the_static_limit(
    share: float, force: float
) -> None:
    static = magnitude(0.0, force)
    torque = math.copysign(min(abs(share), 1.0 - 1e-12) * static, share)
    speed, impulse, held = step_velocity(0.0, static, torque, force)
    assert speed == 0.0
    assert impulse == 0.0
    assert held == pytest.approx(static)


@given(
    excess=st.floats(1e-3, 50.0), side=st.sampled_from([-1.0, 1.0]), force=st.floats(0.0, 5000.0)
)
def test_shaft_breaks_away_just_above_it_toward_the_torque(
    excess: float, side: float, force: float
) -> None:
    static = magnitude(0.0, force)
    speed, _, _ = step_velocity(0.0, static, side * (static + excess), force)
    assert side * speed > 0.0


@given(
    speed=st.floats(-2.0, 2.0).filter(lambda v: abs(v) > 1e-6),
    torque=st.floats(-80.0, 80.0),
    force=st.floats(0.0, 5000.0),
)
def test_one_step_conserves_momentum_and_never_passes_through_zero(
    speed: float, torque: float, force: float
) -> None:
    p = friction_vector(JOINT, force)
    after, impulse, _ = step_velocity(speed, friction(abs(speed), p)[0], torque, force)
    assert after * speed >= 0.0
    assert impulse >= 0.0
    if after != 0.0:
        change = JOINT.inertia_kg_m2 * (after - speed)
        assert change == pytest.approx(torque * STEP_S - math.copysign(impulse, speed), abs=1e-12)


@pytest.mark.parametrize("force", FORCES_N)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_sliding_below_coulomb_stops_and_holds_without_chatter(force: float, side: float) -> None:
    p = friction_vector(JOINT, force)
    torque = (
        side * 0.999 * magnitude(0.0, force)
    )  # below Ms, far above Mc: the worst case for a regularised law
    speed, held = side * 0.01, friction(0.01, p)[0]
    speeds = []
    for _ in range(20000):
        speed, _, held = step_velocity(speed, held, -torque, force)
        speeds.append(speed)
    stopped = speeds.index(0.0)
    assert 0 < stopped < 1000
    assert all(v * side > 0.0 for v in speeds[:stopped])
    assert all(v == 0.0 for v in speeds[stopped:])


@pytest.mark.parametrize("force", FORCES_N)
def test_coasting_loses_exactly_its_kinetic_energy_over_the_distance_of_the_closed_form(
    force: float,
) -> None:
    machine = exact_machine()
    machine.press(force)
    machine.power(True)
    machine.follow(1.2 * np.arange(1, 6001) / 20000.0)
    machine.power(False)
    start = machine.truth()
    machine.advance(400_000_000)
    stop = machine.truth()
    inertia = JOINT.inertia_kg_m2
    kinetic = 0.5 * inertia * start.velocity_rad_s**2
    assert start.velocity_rad_s > 1.0
    assert stop.velocity_rad_s == 0.0
    assert stop.friction_work_J - start.friction_work_J == pytest.approx(kinetic, rel=1e-6)
    distance, _ = integrate.quad(
        lambda v: inertia * v / magnitude(v, force), 0.0, start.velocity_rad_s
    )
    assert stop.angle_rad - start.angle_rad == pytest.approx(distance, rel=1e-6)


def test_electrical_torque_work_is_kinetic_energy_plus_friction_work() -> None:
    machine = exact_machine()
    machine.power(True)
    time = np.arange(1, 40001) / 20000.0
    path = 0.3 * np.sin(2.0 * np.pi * time) * np.minimum(time, 1.0) ** 2
    torque_per_ampere = 0.03 * 100.0
    work = angle = dissipated = 0.0
    for target in np.split(path, len(path)):
        machine.follow(target)
        current, now = machine.latch().current_A, machine.truth()
        work += torque_per_ampere * current * (now.angle_rad - angle)
        assert now.friction_work_J >= dissipated
        angle, dissipated = now.angle_rad, now.friction_work_J
        kinetic = 0.5 * JOINT.inertia_kg_m2 * now.velocity_rad_s**2
        # Twice the speed in a period times half the torque's change in it: order h^2 over the run.
        assert work == pytest.approx(kinetic + dissipated, abs=1e-6)
    assert dissipated > 10.0
