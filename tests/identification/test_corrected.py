"""The corrected model against formulas of this file, and the way from the catalogue's parameters to
regressors and back.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from identification.effects import MOTION
from identification.effects.device import BOTH, LOWER, UPPER
from identification.effects.effect import Context, Effect
from identification.effects.model import CorrectedModel, Curve, carried
from identification.recording import Array, Bench, Recording
from identification.views.nominal import Nominal
from identification.views.view import View, views

NOMINAL = {
    "J": 0.2, "Mc": 6.8, "Ms": 12.0, "omega_sf": 0.056, "sigma_2": 5.3, "mu_c": 0.052,
    "mu_s": 0.086,
    "omega_sL": 0.033, "mu_2": 0.032,
}  # fmt: skip
BENCH = Bench(
    torque_constant=0.03,
    back_emf_constant=0.026,
    resistance=1.56,
    inductance=1e-3,
    gear_ratio=100.0,
    moment_arm=0.095,
)


def load(v: View) -> Array:
    fall = np.exp(-((v.velocity / 0.033) ** 2))
    return v.sense * v.moment * (0.052 + 0.034 * fall + 0.032 * np.abs(v.velocity))


def system(v: View, alpha: float = 2.0) -> Array:
    fall = np.exp(-(np.abs(v.velocity / 0.056) ** alpha))
    return v.sense * (6.8 + 5.2 * fall + 5.3 * np.abs(v.velocity))


def asked(v: View) -> Array:
    """Return what the nominal model asks of the drive."""
    return 0.2 * v.acceleration + system(v) + load(v) - v.known


def play(series: Array, width: float) -> Array:
    out = np.zeros(len(series))
    for k in range(1, len(series)):
        out[k] = np.clip(out[k - 1] + series[k] - series[k - 1], -0.5 * width, 0.5 * width)
    return out


def mean_step(v: View, knee: float) -> Array:
    """Return tanh(I / knee) as the mean over a hundred instants of each sample."""
    current = v.recording.channels["current"]
    ends = 0.5 * (current[1:] + current[:-1])
    before, after = np.r_[current[:1], ends], np.r_[ends, current[-1:]]
    share = (np.arange(100) + 0.5) / 100.0
    return np.mean(np.tanh((before + (after - before) * share[:, None]) / knee), axis=0)


def lossless(v: View, loss: float) -> Array:
    """Return the current I of 3 I - loss I^2 omega = M, by iteration."""
    current = asked(v) / 3.0
    for _ in range(60):
        current = (asked(v) + loss * current**2 * v.velocity) / 3.0
    return current


def built_up(v: View, travel: float, motion: float, torque: float) -> Array:
    """Return the drive's torque M of M - a |M| z - d M z^2 = what is asked, by iteration."""
    z = np.zeros(len(v.angle))
    for k in range(1, len(z)):
        step = v.angle[k] - v.angle[k - 1]
        z[k] = np.sign(step) + (z[k - 1] - np.sign(step)) * np.exp(-abs(step) / travel)
    drive = asked(v)
    for _ in range(60):
        drive = asked(v) + motion * np.abs(drive) * z + torque * drive * z**2
    return drive


def misread(v: View) -> Array:
    """Return the nominal torque of an error of the reading of 0.2 mrad at the joint."""
    speed = np.gradient(2e-4 * np.sin(2.0 * v.motor + 0.3), v.time)
    return 0.2 * np.gradient(speed, v.time) + (5.3 + 0.032 * v.moment) * speed


def loose(v: View, gap: float) -> Array:
    return np.where(play(v.angle, gap) * v.sense < 0.499999 * gap, 1.0, 0.0)


def one(v: View) -> Array:
    return np.ones(len(v.time))


Formula = Callable[[View], Array]
FORMULAS: dict[tuple[str, str], tuple[dict[str, float], Formula]] = {
    ("cogging", "drive"): (
        {"torque_Nm": 0.5, "per_motor_turn": 7.0, "phase_rad": 0.3},
        lambda v: 0.5 * np.sin(7.0 * v.motor + 0.3),
    ),
    ("torque_ripple", "drive"): (
        {"fraction": 0.1, "per_motor_turn": 7.0, "phase_rad": 0.3},
        lambda v: asked(v) * (1.0 - 1.0 / (1.0 + 0.1 * np.sin(7.0 * v.motor + 0.3))),
    ),
    ("torque_saturation", "drive"): (
        {"knee_A": 30.0, "rational": 0.0},
        lambda v: asked(v) - 90.0 * np.arctanh(asked(v) / 90.0),
    ),
    ("stray_loss", "drive"): (
        {"coefficient_Nms_A2rad": 0.01},
        lambda v: asked(v) - 3.0 * lossless(v, 0.01),
    ),
    ("transmission_efficiency", "drive"): (
        {"efficiency": 0.8},
        lambda v: asked(v) * np.where(asked(v) * v.velocity >= 0.0, -0.25, 0.2),
    ),
    ("gear_friction", "drive"): (
        {"travel_rad": 0.02, "against_motion": 0.2, "against_torque": 0.1},
        lambda v: asked(v) - built_up(v, 0.02, 0.2, 0.1),
    ),
    ("current_offset", "drive"): ({"current_A": 0.3}, lambda v: -0.9 * one(v)),
    ("current_drift", "drive"): ({"rate_A_s": 0.01}, lambda v: -0.03 * (v.time - v.time[0])),
    ("asymmetric_coulomb", "torque"): ({"torque_Nm": 0.4}, lambda v: 0.4 * one(v)),
    ("asymmetric_viscous", "torque"): (
        {"coefficient_Nms_rad": -0.7},
        lambda v: -0.7 * np.abs(v.velocity),
    ),
    ("quadratic_drag", "torque"): (
        {"coefficient_Nms2_rad2": 1.3},
        lambda v: 1.3 * v.velocity * np.abs(v.velocity),
    ),
    ("stribeck_shape", "torque"): (
        {"alpha": 1.2},
        lambda v: (
            system(v, 1.2)
            - system(v)
            + v.sense
            * v.moment
            * 0.034
            * (
                np.exp(-(np.abs(v.velocity / 0.033) ** 1.2))
                - np.exp(-(np.abs(v.velocity / 0.033) ** 2.0))
            )
        ),
    ),
    ("encoder_ripple", "torque"): (
        {"amplitude_rad": 0.02, "per_turn": 2.0, "phase_rad": 0.3, "at_motor": 1.0},
        lambda v: -misread(v),
    ),
    ("friction_play", "torque"): (
        {"gap_rad": 0.1, "friction_share": 0.8, "inertia_kgm2": 0.15},
        lambda v: (
            -0.8 * loose(v, 0.1) * (system(v) + load(v))
            - 0.15 * np.gradient(loose(v, 0.1) * v.velocity, v.time)
        ),
    ),
    ("position_dependent_friction", "torque"): (
        {"torque_Nm": 1.0, "center_rad": 0.1, "width_rad": 0.05},
        lambda v: v.sense * np.exp(-0.5 * ((v.angle - 0.1) / 0.05) ** 2),
    ),
    ("viscous_thermal_drift", "torque"): (
        {"fraction": 0.3, "time_s": 7.0},
        lambda v: -0.3 * 5.3 * v.velocity * (1.0 - np.exp(-v.run_time / 7.0)),
    ),
    ("coulomb_drift", "torque"): (
        {"rate_Nm_s": 0.01, "time_s": 7.0},
        lambda v: v.sense * 0.07 * (1.0 - np.exp(-v.run_time / 7.0)),
    ),
    ("gravity_imbalance", "torque"): (
        {"torque_Nm": 2.0, "zero_rad": 0.3},
        lambda v: 2.0 * np.sin(v.angle - 0.3),
    ),
    ("return_spring", "torque"): (
        {"stiffness_Nm_rad": 3.0, "rest_rad": 0.2},
        lambda v: 3.0 * (v.angle - 0.2),
    ),
    ("constant_torque", "torque"): ({"torque_Nm": 0.4}, lambda v: -0.4 * one(v)),
    ("end_stop", "torque"): (
        {"angle_rad": 0.2, "stiffness_Nm_rad": 40.0, "other_rad": -0.25},
        lambda v: 40.0 * (np.maximum(v.angle - 0.2, 0.0) + np.minimum(v.angle + 0.25, 0.0)),
    ),
    ("load_exponent", "torque"): (
        {"exponent": 1.3},
        lambda v: load(v) * ((v.moment / 0.095 / 3000.0) ** 0.3 - 1.0),
    ),
    ("load_position_dependence", "torque"): (
        {"slope_per_rad": 0.3},
        lambda v: 0.3 * load(v) * v.angle,
    ),
    ("wrong_weight", "torque"): ({"mass_kg": 25.0, "recording": 1.0}, lambda v: 0.25 * load(v)),
    ("load_swing", "torque"): (
        {"fraction": 0.3, "frequency_Hz": 0.7, "decay_s": 3.0},
        lambda v: 0.3 * load(v) * np.cos(1.4 * np.pi * v.time) * np.exp(-v.time / 3.0),
    ),
    ("load_inertia", "torque"): (
        {"inertia_kgm2": 0.3},
        lambda v: 0.3 * 20.0 / 30.6 * v.acceleration,
    ),
    ("lever_pivot_friction", "torque"): ({"torque_Nm": 1.1}, lambda v: 1.1 * v.sense),
    ("backlash", "twist"): ({"gap_rad": 0.007}, lambda v: play(v.motor / 100.0, 0.007)),
    ("compliance", "twist"): ({"stiffness_Nm_rad": 900.0}, lambda v: v.torque / 900.0),
    ("gear_mesh_ripple", "twist"): (
        {"amplitude_rad": 1e-3, "per_turn": 23.0, "phase_rad": 0.4, "with_torque": 0.0},
        lambda v: 1e-3 * np.sin(23.0 * v.angle + 0.4),
    ),
    ("coupling_hysteresis", "twist"): (
        {"torque_Nm": 4.0, "deflection_rad": 2e-3},
        lambda v: 2e-3 * np.clip((v.torque - play(v.torque, 8.0)) / 4.0, -1.0, 1.0),
    ),
    ("encoder_eccentricity", "twist"): (
        {"amplitude_rad": 1e-3, "phase_rad": 0.4},
        lambda v: -1e-3 * np.sin(v.angle + 0.4),
    ),
    ("encoder_slip", "twist"): (
        {"angle_rad": 0.01, "at_s": 2.0, "recording": 1.0},
        lambda v: np.where(v.time >= 2.0, -0.01, 0.0),
    ),
    ("brush_drop", "voltage"): (
        {"voltage_V": 0.8, "current_A": 1.5},
        lambda v: 0.8 * mean_step(v, 1.5),
    ),
    ("supply_sag", "voltage"): (
        {"resistance_ohm": 0.2, "supply_V": 60.0},
        lambda v: 0.2 * v.current * (v.voltage / 60.0) ** 2,
    ),
}
"""Effect and quantity of the model to parameters, and to what the effect adds to the quantity."""


@pytest.fixture(scope="module")
def view() -> View:
    time = np.arange(8000) / 1000.0
    angle = 0.35 * np.sin(1.7 * (time - np.clip(time - 3.0, 0.0, 0.4)))
    angle = np.round(angle / 2.4e-5) * 2.4e-5
    velocity = np.gradient(angle, time)
    current = (8.0 * np.sign(np.cos(1.7 * time)) + 2.0 * velocity) / 3.0
    channels = {
        "time": time,
        "angle": angle,
        "motor_angle": 100.0 * angle,
        "current": current,
        "voltage": 1.56 * current + 2.6 * velocity,
        "supply_voltage": np.full(len(time), 60.0),
    }
    recording = Recording(name="r", channels=channels, bench=BENCH, weight_mass=20.0)
    return views([recording], 30.0)[0]


@pytest.mark.parametrize(("name", "quantity"), list(FORMULAS))
def test_an_effect_adds_what_its_equation_states(name: str, quantity: str, view: View) -> None:
    parameters, formula = FORMULAS[name, quantity]
    plain = CorrectedModel(NOMINAL)
    model = CorrectedModel(NOMINAL, 2.0, {name: parameters})
    added = getattr(model, quantity)(view) - getattr(plain, quantity)(view)
    expected = formula(view)
    assert np.max(np.abs(expected)) > 0.0
    off = np.abs(added - expected)
    # Where the current is equal at both ends of a sample, its value at the sample is taken.
    tolerance = 1e-3 if name == "brush_drop" else 1e-6
    assert np.mean(off > tolerance * np.max(np.abs(expected))) < 0.002


@pytest.mark.parametrize("effect", MOTION, ids=lambda e: e.name)
def test_parameters_come_back_from_regressors(effect: Effect, view: View) -> None:
    nominal = Nominal(NOMINAL, tuple(NOMINAL), 2.0)
    given = {q.name: q.low + 0.6 * (q.high - q.low) for q in effect.parameters}
    if effect.place is not None:
        given["recording"] = 1.0
    shape, coefficients = effect.at(given, nominal)
    width = {c(view, nominal, shape).shape[0] for c in effect.columns.values()}
    assert width == {len(coefficients)}
    if len(shape) > 1 and "mass_kg" in given:  # a sought mass has a coefficient, a given one none
        shape, coefficients = shape[:1], (shape[1] / 20.0 - 1.0,)
    found = effect.read(np.array(coefficients), shape, Context((view,), nominal))
    assert found == pytest.approx({q.name: given[q.name] for q in effect.parameters})


@pytest.mark.parametrize(
    ("side", "at", "middle"),
    [
        (LOWER, 0.2, 0.4), (LOWER, -0.2, -0.1), (UPPER, -0.2, -0.4), (UPPER, 0.2, 0.1),
        (BOTH, 0.2, 0.4), (LOWER, 2.9, 3.1),
    ],
)  # fmt: skip
def test_a_stop_keeps_its_end_of_the_travel(
    side: float, at: float, middle: float, view: View
) -> None:
    nominal = Nominal(NOMINAL, tuple(NOMINAL), 2.0)
    moved = dataclasses.replace(view, angle=view.angle - np.mean(view.angle) + middle)
    shape = side, at + 0.4 * (side == BOTH), at
    stop = next(e for e in MOTION if e.name == "end_stop")
    found = stop.read(np.array([40.0]), shape, Context((moved,), nominal))
    assert all(q.low <= found[q.name] <= max(q.high, 3.6) for q in stop.parameters)
    again, size = stop.at(found, nominal)
    expected = 40.0 * stop.torque(moved, nominal, shape)
    assert np.max(np.abs(expected)) > 1.0
    assert np.array(size) @ stop.torque(moved, nominal, again) == pytest.approx(expected[0])


def test_what_rest_added_is_there_as_it_ends_and_gone_in_motion(view: View) -> None:
    """The search looks for it in breakaways alone."""
    model = CorrectedModel(NOMINAL, 2.0, {"dwell_static_friction": {"growth_Nm": 2.0, "time_s": 1}})
    found = model.torque(view) - CorrectedModel(NOMINAL).torque(view)
    assert len(view.breakaways) > 0
    rested = np.maximum(view.rest_time, np.roll(view.rest_time, 1))[view.breakaways]
    expected = view.sense[view.breakaways] * 2.0 * (1.0 - np.exp(-rested))
    assert found[view.breakaways] == pytest.approx(expected, abs=1e-9)
    assert np.max(np.abs(expected)) > 0.3
    after = np.concatenate([view.breakaways + k for k in range(1, 20)])
    assert np.max(np.abs(found[after])) < 1e-9
    assert np.any(found[view.still])


def test_a_gear_s_torque_swings_as_its_ratio_does(view: View) -> None:
    given = {"amplitude_rad": 1e-3, "per_turn": 23.0, "phase_rad": 0.4, "with_torque": 1.0}
    model = CorrectedModel(NOMINAL, 2.0, {"gear_mesh_ripple": given})
    steepness = 1e-3 * 23.0 * np.cos(23.0 * view.angle + 0.4)
    assert model.drive(view) - view.transmitted == pytest.approx(asked(view) * steepness, abs=1e-4)


def test_the_nominal_torque_is_that_of_the_paper(view: View) -> None:
    expected = 0.2 * view.acceleration + system(view) + load(view)
    assert CorrectedModel(NOMINAL).torque(view) == pytest.approx(expected, abs=1e-9)


def test_effects_of_which_others_depend_are_in_the_nominal_values() -> None:
    effects = {
        "gravity_imbalance": {"torque_Nm": 2.0, "zero_rad": 0.0},
        "return_spring": {"stiffness_Nm_rad": 3.0, "rest_rad": 0.5},
        "current_offset": {"current_A": 0.3},
        "transmission_efficiency": {"efficiency": 0.8},
        "presliding": {"stiffness_Nm_rad": 4e3},
    }
    nominal = CorrectedModel(NOMINAL, 2.0, effects).nominal
    assert nominal.undeclared == pytest.approx((2.0, 0.0, 3.0, -1.5))
    assert nominal.zero_A == 0.3
    assert nominal.efficiency == pytest.approx(0.8)
    assert nominal.presliding_stiffness == 4e3


def test_a_curve_is_carried_in_its_own_equation_alone(view: View) -> None:
    grid = np.linspace(-0.3, 0.3, 7)
    curve = Curve("torque", "angle", "rad", "N m", grid, grid**2)
    missing = carried(curve, "torque", view)
    assert missing == pytest.approx(np.interp(view.angle, grid, grid**2))
    assert not np.any(carried(curve, "voltage", view))
    found = CorrectedModel(NOMINAL, 2.0, {}, curve).torque(view)
    assert found - CorrectedModel(NOMINAL).torque(view) == pytest.approx(missing)
