"""What the machine can hide, each effect against a closed form or a limiting case."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.mock.plant.effects.pack import KNOWN, effect_vector, problems
from drivers.mock.plant.effects.table import HEAT
from drivers.mock.plant.parts.constants import Machine

from .track import EXACT, PER_AMPERE, Effects, Track, clock, cruise, sine, steady_torque

OFF: Effects = {
    "cogging": {"torque_Nm": 0.0, "per_motor_turn": 7.0, "phase_rad": 1.0},
    "torque_ripple": {"fraction": 0.0, "per_motor_turn": 7.0, "phase_rad": 1.0},
    "current_loop_lag": {"time_s": 0.0},
    "inverter_dead_time": {"voltage_V": 0.0},
    "brush_drop": {"voltage_V": 0.0, "current_A": 1.0},
    "winding_heating": {"rise_K_per_W": 0.0, "time_s": 60.0},
    "supply_sag": {"resistance_ohm": 0.0},
    "gear_mesh_ripple": {"amplitude_rad": 0.0, "per_turn": 30.0, "phase_rad": 1.0},
    "transmission_efficiency": {"efficiency": 1.0},
    "asymmetric_coulomb": {"torque_Nm": 0.0},
    "asymmetric_viscous": {"coefficient_Nms_rad": 0.0},
    "quadratic_drag": {"coefficient_Nms2_rad2": 0.0},
    "stribeck_shape": {"alpha": 2.0},
    "friction_memory": {"time_s": 0.0},
    "dwell_static_friction": {"growth_Nm": 0.0, "time_s": 1.0},
    "position_dependent_friction": {"torque_Nm": 0.0, "center_rad": 0.0, "width_rad": 0.1},
    "viscous_thermal_drift": {"fraction": 0.0, "time_s": 100.0},
    "coulomb_drift": {"rate_Nm_s": 0.0},
    "gravity_imbalance": {"torque_Nm": 0.0, "zero_rad": 1.0},
    "return_spring": {"stiffness_Nm_rad": 0.0, "rest_rad": 1.0},
    "end_stop": {"angle_rad": 0.1, "stiffness_Nm_rad": 0.0},
    "load_exponent": {"exponent": 1.0},
    "load_position_dependence": {"slope_per_rad": 0.0},
    "load_swing": {"fraction": 0.0, "frequency_Hz": 1.0, "decay_s": 1.0},
    "load_inertia": {"inertia_kgm2": 0.0},
    "lever_pivot_friction": {"torque_Nm": 0.0},
    "load_dependent_friction": {"coefficient": 0.0},
    "time_skew": {"time_s": 0.0},
    "transport_delay": {"time_s": 0.0},
    "current_offset": {"current_A": 0.0},
    "current_drift": {"rate_A_s": 0.0},
    "encoder_eccentricity": {"amplitude_rad": 0.0, "phase_rad": 1.0},
    "encoder_slip": {"angle_rad": 0.0, "at_s": 0.0, "recording": 1.0},
}


@pytest.mark.parametrize("weight", [0.0, 30.6])
def test_effects_of_no_size_leave_every_bit_as_it_was(weight: float) -> None:
    path = sine(1.0)
    nominal, hiding = (Track(effects, path, weight, Machine()) for effects in ({}, OFF))
    for name in ("angle", "speed", "now_A", "motor", "seen", "current", "voltage", "supply"):
        np.testing.assert_array_equal(getattr(hiding, name), getattr(nominal, name))
    np.testing.assert_allclose(hiding.work, nominal.work, rtol=1e-9)


@pytest.mark.parametrize(
    "stiff",
    [
        {"backlash": {"gap_rad": 0.0}},
        {"compliance": {"stiffness_Nm_rad": 1e6}},
        {"coupling_hysteresis": {"torque_Nm": 5.0, "deflection_rad": 0.0}},
    ],
)
def test_two_masses_on_a_stiff_shaft_move_as_one(stiff: Effects) -> None:
    nominal, hiding = (Track(effects, sine()) for effects in ({}, stiff))
    assert np.max(np.abs(hiding.angle - nominal.angle)) < 5e-4
    assert np.max(np.abs(hiding.motor - hiding.angle)) < 8e-5


def test_joint_stands_while_the_rotor_crosses_the_gap() -> None:
    gap = 0.007
    track = Track({"backlash": {"gap_rad": gap}}, sine(2.0))
    moving = track.time > 0.5
    twist = (track.motor - track.angle)[moving]
    assert np.max(np.abs(twist)) == pytest.approx(0.5 * gap, abs=1e-4)
    inside = np.abs(twist) < 0.45 * gap
    assert 10 < np.sum(inside) < 400
    assert np.all(track.speed[moving][inside] == 0.0)  # friction holds it


def test_backlash_loses_no_energy_but_in_the_contacts() -> None:
    """Friction's work never decreases, and the motor pays for all of it."""
    track = Track({"backlash": {"gap_rad": 0.01}}, sine(3.0))
    assert np.all(np.diff(track.work) >= 0.0)
    put_in = np.sum(PER_AMPERE * track.current[1:] * np.diff(track.motor))
    assert put_in > 0.99 * track.work[-1]


def test_shaft_twists_with_its_torque() -> None:
    stiffness = 2000.0
    track = Track({"compliance": {"stiffness_Nm_rad": stiffness}}, cruise(0.3))
    twist = np.mean((track.motor - track.angle)[-200:])
    assert twist == pytest.approx(PER_AMPERE * np.mean(track.current[-200:]) / stiffness, rel=0.02)


def test_coupling_has_a_loop_that_speed_does_not_change() -> None:
    effect = {"coupling_hysteresis": {"torque_Nm": 4.0, "deflection_rad": 0.003}}
    widths = []
    for frequency in (0.5, 1.0):
        track = Track(effect, sine(3.0 / frequency, 0.2, frequency))
        twist = (track.motor - track.angle)[len(track.time) // 2 :]
        widths.append(np.ptp(twist))
    assert widths[0] == pytest.approx(2.0 * 0.003, rel=0.1)
    assert widths[1] == pytest.approx(widths[0], rel=0.03)


@pytest.mark.parametrize("deflection", [1e-4, 5e-3])
def test_coupling_takes_energy_and_never_gives_any(deflection: float) -> None:
    effect = {"coupling_hysteresis": {"torque_Nm": 2.0, "deflection_rad": deflection}}
    track = Track(effect, sine(3.0, 0.02, 3.0))
    assert np.max(np.abs(track.angle)) < 0.03
    into_joint = np.cumsum(PER_AMPERE * track.current[1:] * np.diff(track.motor)) - track.work[1:]
    assert into_joint[-1] > 0.0
    assert (
        np.min(np.diff(into_joint[::333])) > -0.02
    )  # over whole cycles: what the joint's inertia takes, it gives


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_friction_differs_by_side(side: float) -> None:
    speed = 0.8
    base = steady_torque({}, side * speed)
    coulomb = steady_torque({"asymmetric_coulomb": {"torque_Nm": 1.5}}, side * speed) - base
    viscous = (
        steady_torque({"asymmetric_viscous": {"coefficient_Nms_rad": 2.0}}, side * speed) - base
    )
    assert coulomb == pytest.approx(1.5, abs=0.02)
    assert viscous == pytest.approx(2.0 * speed, abs=0.02)
    drag = steady_torque({"quadratic_drag": {"coefficient_Nms2_rad2": 3.0}}, side * speed) - base
    assert drag == pytest.approx(side * 3.0 * speed**2, abs=0.02)


def test_bristles_bend_in_proportion_before_they_slip() -> None:
    """Below a tenth of breakaway a soft push moves the joint by torque over stiffness, and it comes
    back.
    """
    stiffness = 5e3
    soft = replace(
        EXACT, loops=replace(EXACT.loops, velocity_gain_N_m_s_rad=None, position_gain=400.0)
    )
    t = clock(4.0)
    push = np.where(t < 2.0, np.clip(t, 0.0, 1.0), np.clip(3.0 - t, 0.0, 1.0)) * 2.5e-3
    track = Track({"presliding": {"stiffness_Nm_rad": stiffness}}, push, machine=soft)
    at_top = track.angle[1900]
    assert at_top == pytest.approx(PER_AMPERE * track.now_A[1900] / stiffness, rel=0.1)
    assert abs(track.angle[-1]) < 0.1 * at_top
    assert Track({}, push, machine=soft).angle[1900] == 0.0


def test_cogging_is_a_sine_of_the_motor_angle() -> None:
    order = 4.0
    path = cruise(0.1, 2.0)
    effect = {"cogging": {"torque_Nm": 1.0, "per_motor_turn": order, "phase_rad": 0.7}}
    change = PER_AMPERE * (Track(effect, path).current - Track({}, path).current)[1000:]
    shaft = 100.0 * Track(effect, path).motor[1000:]
    basis = np.column_stack([np.sin(order * shaft + 0.7), np.cos(order * shaft + 0.7)])
    (along, across), *_ = np.linalg.lstsq(basis, change, rcond=None)
    assert along == pytest.approx(-1.0, abs=0.05)
    assert abs(across) < 0.05


def test_ripple_grows_with_the_current() -> None:
    effect = {"torque_ripple": {"fraction": 0.1, "per_motor_turn": 4.0, "phase_rad": 0.0}}
    spread = []
    for weight in (0.0, 30.6):
        track = Track(effect, cruise(0.3, 2.0), weight)
        spread.append((np.std(track.current[1000:]), np.mean(track.current[1000:])))
    assert spread[1][0] / spread[0][0] == pytest.approx(spread[1][1] / spread[0][1], rel=0.1)
    assert spread[0][0] == pytest.approx(0.1 / math.sqrt(2.0) * spread[0][1], rel=0.15)


def test_mesh_error_shows_between_the_encoders() -> None:
    effect = {"gear_mesh_ripple": {"amplitude_rad": 1e-3, "per_turn": 30.0, "phase_rad": 0.5}}
    track = Track(effect, cruise(0.5, 2.0))
    np.testing.assert_allclose(
        track.motor - track.angle, 1e-3 * np.sin(30.0 * track.angle + 0.5), atol=3e-6
    )


def test_gear_loses_a_share_of_what_it_passes() -> None:
    lossy = steady_torque({"transmission_efficiency": {"efficiency": 0.8}}, 0.6)
    assert lossy == pytest.approx(steady_torque({}, 0.6) / 0.8, rel=2e-3)


@pytest.mark.parametrize("speed", [0.5, 1.0])
def test_joint_encoder_is_late_by_a_time(speed: float) -> None:
    delay = 0.00413
    track = Track({"transport_delay": {"time_s": delay}}, cruise(speed))
    lag = np.mean((track.angle - track.seen)[-200:])
    assert lag == pytest.approx(speed * delay, rel=2e-3)


def test_skewed_current_is_that_of_a_moment_ago() -> None:
    skew = 0.005
    straight, skewed = (Track(e, sine()) for e in ({}, {"time_skew": {"time_s": skew}}))
    np.testing.assert_array_equal(skewed.angle, straight.angle)
    np.testing.assert_allclose(skewed.current[5:], straight.current[:-5], atol=1e-9)


def test_offset_is_in_the_sensor() -> None:
    plain, shifted = (steady_torque(e, 0.5) for e in ({}, {"current_offset": {"current_A": 0.4}}))
    assert shifted - plain == pytest.approx(0.4 * PER_AMPERE, abs=0.01)
    drift = Track({"current_drift": {"rate_A_s": 0.2}}, cruise(0.2, 2.0))
    change = drift.current - Track({}, cruise(0.2, 2.0)).current
    assert np.polyfit(drift.time[1000:], change[1000:], 1)[0] == pytest.approx(0.2, rel=0.02)


def test_imbalance_pulls_with_the_sine_of_the_angle() -> None:
    effect = {"gravity_imbalance": {"torque_Nm": 5.0, "zero_rad": 0.3}}
    path = sine(4.0, 0.4, 0.5)
    with_it, without = Track(effect, path), Track({}, path)
    change = PER_AMPERE * (with_it.current - without.current)
    sliding = (np.abs(without.speed) > 0.3) & (without.time > 0.8)
    np.testing.assert_allclose(
        change[sliding], 5.0 * np.sin(without.angle[sliding] - 0.3), atol=0.25
    )


def test_winding_warms_with_its_losses() -> None:
    """Stalled under 30.6 kg: R rises by 0.393 % a kelvin, and the flux falls by 0.1 %."""
    rise, time_s = 0.3, 1.0
    path = cruise(0.05, 6.0)
    hot = Track({"winding_heating": {"rise_K_per_W": rise, "time_s": time_s}}, path, 30.6)
    cold = Track({}, path, 30.6)
    current = np.mean(hot.current[-500:])
    resistance = (np.mean(hot.voltage[-500:]) - 2.588 * 0.05) / current
    heat = rise * resistance * current**2
    assert resistance == pytest.approx(1.56 * (1.0 + 0.00393 * heat), rel=0.01)
    assert current == pytest.approx(np.mean(cold.current[-500:]) / (1.0 - 0.001 * heat), rel=0.01)
    hot.machine.power(False)
    hot.machine.rest(20.0)
    hot.machine.power(True)
    hot.machine.advance(50_000_000)
    assert hot.machine._x[HEAT] < 0.05 * heat


def test_wrong_weight_is_on_one_recording_only() -> None:
    effect = {"wrong_weight": {"mass_kg": 20.0, "recording": 2.0}}
    path = cruise(0.5)
    torques = [np.mean(Track(effect, path, 10.0, on=k).current[-200:]) for k in (1, 2, 3)]
    right, heavy = (np.mean(Track({}, path, kg).current[-200:]) for kg in (10.0, 20.0))
    assert torques == pytest.approx([right, heavy, right], rel=1e-9)


def test_every_known_effect_moves_something() -> None:
    """No name is accepted that nothing listens to."""
    slots = [p.slot for parameters in KNOWN.values() for p in parameters.values()]
    assert sorted(slots) == list(range(len(slots)))


@pytest.mark.parametrize(
    ("effects", "says"),
    [
        ({"backlsh": {"gap_rad": 0.1}}, "no such effect"),
        ({"backlash": {"gap": 0.1}}, "gap_rad is missing"),
        ({"backlash": {"gap_rad": 0.01, "width": 1.0}}, "no such parameter"),
        ({"backlash": {"gap_rad": -0.01}}, "within 0 to 0.1"),
        ({"backlash": {"gap_rad": float("nan")}}, "within 0 to 0.1"),
    ],
)
def test_effects_that_cannot_be_are_refused(effects: Effects, says: str) -> None:
    assert any(says in text for _, text in problems(effects))
    with pytest.raises(ValueError, match=says):
        effect_vector(replace(Machine(), effects=effects))


def test_a_rotor_heavier_than_the_whole_is_refused() -> None:
    heavy = replace(Machine(), motor=replace(Machine().motor, rotor_inertia_kg_m2=3e-5))
    with pytest.raises(ValueError, match="needs inertia on both sides"):
        effect_vector(replace(heavy, effects={"backlash": {"gap_rad": 0.01}}))
