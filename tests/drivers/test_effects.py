"""What the machine can hide, against closed forms; the plants are compared in ``tests/worlds``."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from drivers.mock.plant.effects.pack import KNOWN, effect_vector, problems
from drivers.mock.plant.effects.table import HEAT
from drivers.mock.plant.parts.constants import Machine

from .track import PER_AMPERE, Effects, Track, cruise, sine, steady_torque

MOMENT = 0.095 * 10.0 * 9.80665
BACK_EMF = 2.588
LOAD = 0.052 + 0.032 * 0.4
"""Load coefficient at 0.4 rad/s."""
OFF: Effects = {
    "current_loop_lag": {"time_s": 0.0},
    "winding_heating": {"rise_K_per_W": 0.0, "time_s": 60.0},
    "supply_sag": {"resistance_ohm": 0.0},
    "stray_loss": {"coefficient_Nms_A2rad": 0.0},
    "constant_torque": {"torque_Nm": 0.0},
    "transmission_efficiency": {"efficiency": 1.0},
    "asymmetric_coulomb": {"torque_Nm": 0.0},
    "stribeck_shape": {"alpha": 2.0},
    "friction_memory": {"time_s": 0.0},
    "dwell_static_friction": {"growth_Nm": 0.0, "time_s": 1.0},
    "end_stop": {"angle_rad": 0.1, "stiffness_Nm_rad": 0.0},
    "load_exponent": {"exponent": 1.0},
    "load_swing": {"fraction": 0.0, "frequency_Hz": 1.0, "decay_s": 1.0},
    "time_skew": {"time_s": 0.0},
    "transport_delay": {"time_s": 0.0},
    "encoder_slip": {"angle_rad": 0.0, "at_s": 0.0, "recording": 1.0},
}
"""Effects of no size."""
nominal = cache(lambda speed, weight_kg: steady_torque({}, speed, weight_kg))


def stribeck(alpha: float) -> float:
    falls = [math.exp(-((0.08 / 0.0557) ** a)) for a in (alpha, 2.0)]
    return (12.025 - 6.825) * (falls[0] - falls[1])


def felt(weight_kg: float, exponent: float) -> float:
    force = weight_kg * 10.0 * 9.80665
    more = 3000.0 * (force / 3000.0) ** exponent - force
    return 0.095 * more * (0.052 + 0.032 * 0.5)


def stray(weight_kg: float) -> float:
    """Return the loss at 0.8 rad/s and 0.05 N m s/(A^2 rad): M - M_0 of M = M_0 + c I^2 omega."""
    plain = nominal(0.8, weight_kg)
    torque = plain
    for _ in range(60):
        torque = plain + 0.05 * (torque / PER_AMPERE) ** 2 * 0.8
    return torque - plain


def sided(name: str, key: str, size: float, at: float, to_side: Callable[[float], float]) -> list:
    """Return the rows of an effect to either side, at a speed of 0.8 rad/s."""
    return [({name: {key: size}}, side * 0.8, 0.0, at * to_side(side)) for side in (1.0, -1.0)]


ROOT: Effects = {"x_root_drag": {"coefficient_Nms05_rad05": 2.0}}
RESONANCE: Effects = {
    "x_speed_resonance": {"torque_Nm": 2.0, "speed_rad_s": 0.5, "width_rad_s": 0.1}
}
QUADRANT: Effects = {"x_quadrant_friction": {"torque_Nm": 1.5}}
PIVOT: Effects = {"lever_pivot_friction": {"torque_Nm": 1.2}}
WOUND: Effects = {
    "gear_friction": {"travel_rad": 0.01, "against_motion": 0.2, "against_torque": 0.05}
}
LOADED: Effects = {"x_loaded_drag": {"coefficient_s2_rad2": 0.1}}


@pytest.mark.parametrize(
    ("effects", "speed", "weight_kg", "wanted"),
    [
        *sided("asymmetric_coulomb", "torque_Nm", 1.5, 1.5, lambda _: 1.0),
        *sided("asymmetric_viscous", "coefficient_Nms_rad", 2.0, 2.0 * 0.8, lambda _: 1.0),
        *sided("quadratic_drag", "coefficient_Nms2_rad2", 3.0, 3.0 * 0.8**2, lambda side: side),
        *(({"stribeck_shape": {"alpha": a}}, 0.08, 0.0, stribeck(a)) for a in (1.0, 3.0)),
        *(
            ({"load_exponent": {"exponent": n}}, 0.5, weight, felt(weight, n))
            for weight, n in ((10.0, 0.7), (30.6, 0.7), (20.0, 1.3))
        ),
        ({"load_inertia": {"inertia_kgm2": 0.5}}, 0.5, 20.0, 0.0),
        *((PIVOT, 0.5, weight, 1.2 * (weight > 0.0)) for weight in (0.0, 5.0, 30.6)),
        ({"current_offset": {"current_A": 0.4}}, 0.5, 0.0, 0.4 * PER_AMPERE),
        *(
            (WOUND, side * 0.5, 20.0, side * (0.25 / 0.75) * nominal(0.5, 20.0))
            for side in (1.0, -1.0)
        ),
        *(({"constant_torque": {"torque_Nm": 9.0}}, side * 0.5, 0.0, -9.0) for side in (1.0, -1.0)),
        *(
            ({"stray_loss": {"coefficient_Nms_A2rad": 0.05}}, side * 0.8, weight, side * loss)
            for side in (1.0, -1.0)
            for weight, loss in ((0.0, stray(0.0)), (30.6, stray(30.6)))
        ),
        (ROOT, 0.5, 0.0, 2.0 * (math.sqrt(0.5001) - 0.01)),
        (RESONANCE, 0.5, 0.0, 2.0),
        # Friction grows on the way out, to either side.
        *((QUADRANT, side * 0.5, 0.0, side * 1.5) for side in (1.0, -1.0)),
        ({"x_travel_memory": {"torque_Nm": 1.5, "travel_rad": 0.02}}, 0.5, 0.0, 1.5),
        ({"x_acceleration_drag": {"coefficient_Nms2_rad": 0.1}}, 0.5, 0.0, 0.0),
        (LOADED, 0.5, 0.0, 0.0),
        (LOADED, 0.5, 20.0, 20.0 * MOMENT * 0.1 * 0.25),
    ],
)
def test_torque_at_a_steady_speed(effects, speed, weight_kg, wanted):
    found = steady_torque(effects, speed, weight_kg) - nominal(speed, weight_kg)
    assert found == pytest.approx(wanted, abs=0.03)


GRAVITY: Effects = {"gravity_imbalance": {"torque_Nm": 10.0, "zero_rad": -1.2}}
PATCH = {"torque_Nm": 2.0, "center_rad": 0.3, "width_rad": 0.08}
COGGING = {"torque_Nm": 1.0, "per_motor_turn": 4.0, "phase_rad": 0.7}
SWING = {"fraction": 0.3, "frequency_Hz": 1.5, "decay_s": 1.0}
TIMED = {"torque_Nm": 1.0, "frequency_Hz": 2.0, "phase_rad": 0.4}
WELLS = {"torque_Nm": 1.0, "center_rad": 0.2, "width_rad": 0.05}


def bump(angle: np.ndarray, center: float) -> np.ndarray:
    return 2.0 * np.exp(-0.5 * ((angle - center) / 0.08) ** 2)


def wells(free: Track) -> np.ndarray:
    u = (free.angle - 0.2) / 0.05
    return u * np.exp(0.5 - 0.5 * u * u)


def swing(free: Track) -> np.ndarray:
    share = 0.3 * np.cos(2.0 * np.pi * 1.5 * free.time) * np.exp(-free.time / 1.0)
    return 20.0 * MOMENT * share * LOAD


@pytest.mark.parametrize(
    ("effects", "base", "speed", "weight_kg", "wanted", "within"),
    [
        ({"position_dependent_friction": PATCH}, {}, 0.2, 0.0, lambda f: bump(f.angle, 0.3), 0.05),
        ({"return_spring": {"stiffness_Nm_rad": 10.0, "rest_rad": 0.1}}, {}, 0.3, 0.0,
         lambda free: 10.0 * (free.angle - 0.1), 0.03),
        ({"load_position_dependence": {"slope_per_rad": 0.5}}, {}, 0.4, 30.6,
         lambda free: 30.6 * MOMENT * 0.5 * free.angle * LOAD, 0.1),
        ({"load_swing": SWING}, {}, 0.4, 20.0, swing, 0.15),
        ({"load_dependent_friction": {"coefficient": 0.1}}, GRAVITY, 0.1, 0.0,
         lambda free: 0.1 * 10.0 * np.abs(np.sin(free.angle + 1.2)), 0.02),
        ({"x_timed_torque": TIMED}, {}, 0.3, 0.0,
         lambda free: -np.sin(2.0 * np.pi * 2.0 * free.time + 0.4), 0.12),
        ({"x_two_wells": WELLS}, {}, 0.2, 0.0, wells, 0.06),
        ({"gravity_imbalance": {"torque_Nm": 5.0, "zero_rad": 0.3}}, {}, 0.3, 0.0,
         lambda free: 5.0 * np.sin(free.angle - 0.3), 0.05),
        ({"cogging": COGGING}, {}, 0.1, 0.0,
         lambda free: -np.sin(4.0 * 100.0 * free.angle + 0.7), 0.1),
        ({"end_stop": {"angle_rad": 0.2, "stiffness_Nm_rad": 50.0}}, {}, 0.2, 0.0,
         lambda free: 50.0 * np.maximum(free.angle - 0.2, 0.0), 0.06),
        ({"current_drift": {"rate_A_s": 0.2}}, {}, 0.2, 0.0,
         lambda free: 0.2 * PER_AMPERE * free.time, 0.03),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) and value else "",
)  # fmt: skip
def test_torque_along_a_cruise(effects, base, speed, weight_kg, wanted, within):
    path = cruise(speed, 2.5)
    track, free = (Track(e, path, weight_kg) for e in ({**base, **effects}, base))
    extra = PER_AMPERE * (track.current - free.current)[500:]
    np.testing.assert_allclose(extra, wanted(free)[500:], atol=within)


def means(
    effects: Effects, speed: float = 0.2, weight_kg: float = 20.0
) -> tuple[float, float, float]:
    """Return mean voltage, current and supply at a steady speed."""
    track = Track(effects, cruise(speed), weight_kg)
    return tuple(float(np.mean(v[-200:])) for v in (track.voltage, track.current, track.supply))  # type: ignore[return-value]


def test_supply_sags_and_the_log_does_not_know() -> None:
    ohm = 0.5
    voltage, current, supply = means({"supply_sag": {"resistance_ohm": ohm}})
    assert supply == pytest.approx(60.0 - ohm * voltage / 60.0 * current, abs=1e-3)
    reaching = 1.56 * current + BACK_EMF * 0.2
    assert voltage * supply / 60.0 == pytest.approx(reaching, rel=1e-3)
    assert voltage > reaching


def test_coupling_slips_once_and_stays() -> None:
    slip = {"encoder_slip": {"angle_rad": 3e-3, "at_s": 0.5, "recording": 2.0}}
    first, second, third = (Track(slip, sine(1.0), on=k) for k in (1, 2, 3))
    shift = second.seen - second.angle
    assert np.max(np.abs(first.seen - first.angle)) < 2e-6
    assert np.max(np.abs(shift[second.time < 0.499])) < 2e-6
    np.testing.assert_allclose(shift[second.time > 0.501], 3e-3, atol=2e-6)
    assert (
        np.max(np.abs(third.seen - third.angle)) < 2e-6
    )  # it was not running in its second recording
    second.machine.power(False)
    second.machine.power(True)
    second.machine.advance(1_000_000)
    seen, truth = second.machine.latch(), second.machine.truth()
    assert seen.joint_counts * second.machine.joint_count_rad - truth.angle_rad == pytest.approx(
        3e-3, abs=2e-6
    )


def test_eccentric_encoder_reads_a_sine_more() -> None:
    track = Track({"encoder_eccentricity": {"amplitude_rad": 2e-3, "phase_rad": 0.6}}, sine())
    wanted = 2e-3 * np.sin(track.angle + 0.6)
    np.testing.assert_allclose(track.seen - track.angle, wanted, atol=2e-6)


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
        assert torque - nominal(0.5, 0.0) == pytest.approx(wanted, abs=0.02)


def test_one_way_patch_is_felt_one_way() -> None:
    effect = {"x_one_way_patch": {"torque_Nm": 2.0, "center_rad": 0.2, "width_rad": 0.08}}
    path = np.concatenate((cruise(0.2, 2.0), cruise(0.2, 2.0)[::-1]))
    track, free = Track(effect, path), Track({}, path)
    extra = PER_AMPERE * (track.current - free.current)
    bump = 2.0 * np.exp(-0.5 * ((free.angle - 0.2) / 0.08) ** 2)
    np.testing.assert_allclose(extra[500:1900], bump[500:1900], atol=0.05)
    assert np.max(np.abs(extra[2600:3400])) < 0.02


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


def test_the_motor_encoder_swings_within_a_turn() -> None:
    ripple = {"amplitude_rad": 0.02, "per_turn": 2.0, "phase_rad": 0.3}
    free = Track({"encoder_ripple": ripple}, cruise(0.2))
    error = free.motor - free.angle
    assert error == pytest.approx(2e-4 * np.sin(2.0 * 100.0 * free.angle + 0.3), abs=3e-6)
