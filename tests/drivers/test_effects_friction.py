"""Hidden friction, loads and torques of the device, each against a closed form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from .track import EXACT, PER_AMPERE, Effects, Track, clock, cruise, sine, steady_torque

SOFT = replace(EXACT, loops=replace(EXACT.loops, velocity_gain_N_m_s_rad=None, position_gain=400.0))
MOMENT = 0.095 * 10.0 * 9.80665


def change(effects: Effects, speed: float, weight_kg: float = 0.0) -> float:
    return steady_torque(effects, speed, weight_kg) - steady_torque({}, speed, weight_kg)


def breakaway(effects: Effects, wait_s: float = 0.0, weight_kg: float = 0.0) -> float:
    """Return the torque at which the soft drive breaks the joint loose, after a rest of
    ``wait_s``.
    """
    t = clock(wait_s + 1.0)
    track = Track(effects, 0.1 * np.maximum(t - wait_s, 0.0), weight_kg, SOFT)
    return PER_AMPERE * float(track.now_A[np.flatnonzero(np.abs(track.speed) > 0.02)[0] - 1])


def test_shape_of_the_stribeck_curve() -> None:
    for alpha in (1.0, 3.0):
        speed = 0.08
        falls = [math.exp(-((speed / 0.0557) ** a)) for a in (alpha, 2.0)]
        wanted = (12.025 - 6.825) * (falls[0] - falls[1])
        assert change({"stribeck_shape": {"alpha": alpha}}, speed) == pytest.approx(
            wanted, abs=0.03
        )


def test_static_friction_grows_at_rest() -> None:
    growth, time_s = 4.0, 1.0
    effect = {"dwell_static_friction": {"growth_Nm": growth, "time_s": time_s}}
    base = breakaway({})
    for wait_s in (0.2, 2.0):
        rest_s = wait_s + base / 40.0  # the soft drive asks for 40 N m/s
        wanted = growth * (1.0 - math.exp(-rest_s / time_s))
        assert breakaway(effect, wait_s) - breakaway({}, wait_s) == pytest.approx(wanted, abs=0.2)


@pytest.mark.parametrize("of_speed", [0.0, 1.0])
def test_friction_that_remembers_keeps_its_steady_level(of_speed: float) -> None:
    effect = {"friction_memory": {"time_s": 0.02, "of_speed": of_speed}}
    assert change(effect, 0.3) == pytest.approx(0.0, abs=0.02)
    late, prompt = (Track(e, sine(2.0, 0.05, 2.0)) for e in (effect, {}))
    assert np.max(np.abs(late.current - prompt.current)[600:]) * PER_AMPERE > 1.0


def test_patch_is_where_it_is() -> None:
    effect = {
        "position_dependent_friction": {"torque_Nm": 2.0, "center_rad": 0.3, "width_rad": 0.08}
    }
    path = cruise(0.2, 3.0)
    worn, smooth = Track(effect, path), Track({}, path)
    bump = 2.0 * np.exp(-0.5 * ((smooth.angle - 0.3) / 0.08) ** 2)
    np.testing.assert_allclose(
        PER_AMPERE * (worn.current - smooth.current)[500:], bump[500:], atol=0.05
    )


def test_drifts_run_on_through_pauses() -> None:
    coulomb = {"coulomb_drift": {"rate_Nm_s": 0.01}}
    viscous = {"viscous_thermal_drift": {"fraction": 0.5, "time_s": 50.0}}
    levelled = {"coulomb_drift": {"rate_Nm_s": 0.05, "time_s": 20.0}}
    for effect, wanted in (
        (coulomb, 0.01 * 100.9),
        (levelled, 0.05 * 20.0 * (1.0 - math.exp(-100.9 / 20.0))),
        (viscous, -0.5 * 5.3462 * 0.5 * (1.0 - math.exp(-100.9 / 50.0))),
    ):
        track = Track(effect, cruise(0.5), pause_s=100.0)
        torque = PER_AMPERE * float(np.mean(track.current[-200:]))
        assert torque - steady_torque({}, 0.5) == pytest.approx(wanted, abs=0.02)


def test_spring_pulls_to_its_rest() -> None:
    effect = {"return_spring": {"stiffness_Nm_rad": 10.0, "rest_rad": 0.1}}
    path = cruise(0.3, 2.0)
    sprung, free = Track(effect, path), Track({}, path)
    np.testing.assert_allclose(
        PER_AMPERE * (sprung.current - free.current)[500:],
        10.0 * (free.angle[500:] - 0.1),
        atol=0.03,
    )


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_end_stop_pushes_only_beyond_its_angle(side: float) -> None:
    effect = {"end_stop": {"angle_rad": side * 0.2, "stiffness_Nm_rad": 50.0}}
    path = side * cruise(0.2, 2.0)
    stopped, free = Track(effect, path), Track({}, path)
    extra = PER_AMPERE * (stopped.current - free.current) * side
    depth = side * free.angle - 0.2
    assert np.all(np.abs(extra[(depth < -0.001) & (free.time > 0.5)]) < 1e-6)
    inside = depth > 0.05
    np.testing.assert_allclose(extra[inside], 50.0 * (depth[inside] + 2e-3 * 0.2), atol=0.05)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_pair_of_end_stops_pushes_from_either_end(side: float) -> None:
    both = {"end_stop": {"angle_rad": 0.2, "stiffness_Nm_rad": 50.0, "other_rad": -0.2}}
    single = {"end_stop": {"angle_rad": side * 0.2, "stiffness_Nm_rad": 50.0}}
    path = side * cruise(0.2, 2.0)
    np.testing.assert_allclose(Track(both, path).current, Track(single, path).current, atol=1e-9)


def test_load_friction_follows_a_power_of_the_force() -> None:
    speed = 0.5
    for weight, exponent in ((10.0, 0.7), (30.6, 0.7), (20.0, 1.3)):
        force = weight * 10.0 * 9.80665
        felt = 3000.0 * (force / 3000.0) ** exponent
        wanted = 0.095 * (felt - force) * (0.052 + 0.032 * speed)
        assert change({"load_exponent": {"exponent": exponent}}, speed, weight) == pytest.approx(
            wanted, abs=0.03
        )


def test_load_depends_on_the_angle() -> None:
    path = cruise(0.4, 2.0)
    effect = {"load_position_dependence": {"slope_per_rad": 0.5}}
    track, free = Track(effect, path, 30.6), Track({}, path, 30.6)
    wanted = 30.6 * MOMENT * 0.5 * free.angle * (0.052 + 0.032 * 0.4)
    np.testing.assert_allclose(
        PER_AMPERE * (track.current - free.current)[500:], wanted[500:], atol=0.1
    )


def test_load_swings_and_calms_down() -> None:
    path = cruise(0.4, 3.0)
    effect = {"load_swing": {"fraction": 0.3, "frequency_Hz": 1.5, "decay_s": 1.0}}
    track, free = Track(effect, path, 20.0), Track({}, path, 20.0)
    swing = 0.3 * np.cos(2.0 * np.pi * 1.5 * free.time) * np.exp(-free.time / 1.0)
    wanted = 20.0 * MOMENT * swing * (0.052 + 0.032 * 0.4)
    np.testing.assert_allclose(
        PER_AMPERE * (track.current - free.current)[500:], wanted[500:], atol=0.15
    )


def test_weights_have_inertia_of_their_own() -> None:
    """Where it accelerates evenly, the added torque is the added inertia, in proportion to the
    mass.
    """
    t = clock(0.8)
    path = 0.5 * 4.0 * t * t
    effect = {"load_inertia": {"inertia_kgm2": 0.5}}
    for weight in (15.3, 30.6):
        track, free = (Track(e, path, weight) for e in (effect, {}))
        extra = PER_AMPERE * np.mean((track.current - free.current)[-200:])
        assert extra == pytest.approx(0.5 * 4.0 * weight / 30.6, rel=0.03)
    assert change(effect, 0.5) == 0.0


def test_pivot_rubs_under_any_weight_alike() -> None:
    effect = {"lever_pivot_friction": {"torque_Nm": 1.2}}
    assert change(effect, 0.5) == 0.0
    for weight in (5.0, 30.6):
        assert change(effect, 0.5, weight) == pytest.approx(1.2, abs=0.02)


def test_load_friction_of_a_gravity_load() -> None:
    gravity = {"gravity_imbalance": {"torque_Nm": 10.0, "zero_rad": -1.2}}
    both = {**gravity, "load_dependent_friction": {"coefficient": 0.1}}
    path = cruise(0.1)
    rubbing, free = Track(both, path), Track(gravity, path)
    wanted = 0.1 * 10.0 * np.abs(np.sin(free.angle + 1.2))
    np.testing.assert_allclose(
        PER_AMPERE * (rubbing.current - free.current)[500:], wanted[500:], atol=0.02
    )


@pytest.mark.parametrize(
    ("effects", "speed", "wanted"),
    [
        ({"x_root_drag": {"coefficient_Nms05_rad05": 2.0}}, 0.5, 2.0 * (math.sqrt(0.5001) - 0.01)),
        (
            {"x_speed_resonance": {"torque_Nm": 2.0, "speed_rad_s": 0.5, "width_rad_s": 0.1}},
            0.5,
            2.0,
        ),
        ({"x_quadrant_friction": {"torque_Nm": 1.5}}, 0.5, 1.5),
        (
            {"x_quadrant_friction": {"torque_Nm": 1.5}},
            -0.5,
            -1.5,
        ),  # friction grows on the way out, to either side
        ({"x_travel_memory": {"torque_Nm": 1.5, "travel_rad": 0.02}}, 0.5, 1.5),
        ({"x_acceleration_drag": {"coefficient_Nms2_rad": 0.1}}, 0.5, 0.0),
        ({"x_loaded_drag": {"coefficient_s2_rad2": 0.1}}, 0.5, 0.0),
    ],
)
def test_effects_of_no_catalogue_at_a_steady_speed(
    effects: Effects, speed: float, wanted: float
) -> None:
    assert change(effects, speed) == pytest.approx(wanted, abs=0.03)


def test_drag_of_no_catalogue_under_a_load() -> None:
    effect = {"x_loaded_drag": {"coefficient_s2_rad2": 0.1}}
    assert change(effect, 0.5, 20.0) == pytest.approx(20.0 * MOMENT * 0.1 * 0.25, abs=0.03)


def test_one_way_patch_is_felt_one_way() -> None:
    effect = {"x_one_way_patch": {"torque_Nm": 2.0, "center_rad": 0.2, "width_rad": 0.08}}
    path = np.concatenate((cruise(0.2, 2.0), cruise(0.2, 2.0)[::-1]))
    track, free = Track(effect, path), Track({}, path)
    extra = PER_AMPERE * (track.current - free.current)
    bump = 2.0 * np.exp(-0.5 * ((free.angle - 0.2) / 0.08) ** 2)
    np.testing.assert_allclose(extra[500:1900], bump[500:1900], atol=0.05)
    assert np.max(np.abs(extra[2600:3400])) < 0.02


def test_torques_in_time_are_the_same_at_every_angle() -> None:
    path = cruise(0.3, 2.0)
    effect = {"x_timed_torque": {"torque_Nm": 1.0, "frequency_Hz": 2.0, "phase_rad": 0.4}}
    track, free = Track(effect, path), Track({}, path)
    wanted = -np.sin(2.0 * np.pi * 2.0 * free.time + 0.4)
    np.testing.assert_allclose(
        PER_AMPERE * (track.current - free.current)[500:], wanted[500:], atol=0.12
    )


@pytest.mark.parametrize(
    "effect",
    [
        {"x_bursts": {"torque_Nm": 1.0, "period_s": 0.5, "length_s": 0.1}},
        {"x_switching_torque": {"torque_Nm": 1.0, "period_s": 0.3}},
        {"x_wandering_torque": {"torque_Nm": 1.0, "period_s": 0.5}},
    ],
)
def test_irregular_torques_have_their_size_and_repeat(effect: Effects) -> None:
    path = cruise(0.15, 4.0)
    track, again, free = Track(effect, path), Track(effect, path), Track({}, path)
    extra = PER_AMPERE * (track.current - free.current)[500:]
    assert 0.5 < np.max(np.abs(extra)) < 1.6
    assert np.std(extra) > 0.1
    np.testing.assert_array_equal(track.current, again.current)


def test_two_wells_pull_inwards_and_cost_nothing() -> None:
    effect = {"x_two_wells": {"torque_Nm": 1.0, "center_rad": 0.2, "width_rad": 0.05}}
    path = cruise(0.2, 2.2)
    track, free = Track(effect, path), Track({}, path)
    extra = PER_AMPERE * (track.current - free.current)
    u = (free.angle - 0.2) / 0.05
    np.testing.assert_allclose(extra[500:], (u * np.exp(0.5 - 0.5 * u * u))[500:], atol=0.06)
    assert abs(np.trapezoid(extra, free.angle)) < 0.1 * np.trapezoid(np.abs(extra), free.angle)


def test_drag_that_grows_with_acceleration() -> None:
    t = clock(0.8)
    effect = {"x_acceleration_drag": {"coefficient_Nms2_rad": 0.1}}
    track, free = (Track(e, 0.5 * 4.0 * t * t) for e in (effect, {}))
    assert PER_AMPERE * np.mean((track.current - free.current)[-200:]) == pytest.approx(
        0.1 * 4.0, abs=0.03
    )
