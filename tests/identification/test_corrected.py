"""The corrected model in plain numpy against the regressors of the search, which are written
apart.
"""

from __future__ import annotations

import inspect
import math

import numpy as np
import pytest

from identification.corrected.model import CorrectedModel, carried
from identification.corrected.motor import DRIVE, VOLTAGE
from identification.corrected.signals import signals_of
from identification.corrected.states import dahl_friction, lagged, play
from identification.corrected.torque import TORQUE, nominal_torque
from identification.corrected.transmission import TRANSMISSION
from identification.diagnosis.catalogue import MOTION
from identification.diagnosis.result import Curve
from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.view import View, views
from identification.diagnosis.terms import TERMS, memory
from identification.recording import Bench, Recording

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
LINEAR = {
    "cogging": ({"torque_Nm": 0.5, "per_motor_turn": 7.0, "phase_rad": 0.0}, (7.0,), (0.5, 0.0)),
    "asymmetric_coulomb": ({"torque_Nm": 0.4}, (), (0.4,)),
    "asymmetric_viscous": ({"coefficient_Nms_rad": -0.7}, (), (-0.7,)),
    "quadratic_drag": ({"coefficient_Nms2_rad2": 1.3}, (), (1.3,)),
    "stribeck_shape": ({"alpha": 1.2}, (1.2, 1.0), (1.0,)),
    "friction_memory": ({"time_s": 0.01, "of_speed": 1.0}, (0.01, 1.0), (1.0,)),
    "presliding": ({"stiffness_Nm_rad": 3e3}, (3e3,), (1.0,)),
    "position_dependent_friction": (
        {"torque_Nm": 1.0, "center_rad": 0.1, "width_rad": 0.05},
        (0.1, 0.05),
        (1.0,),
    ),
    "coulomb_drift": ({"rate_Nm_s": 0.01, "time_s": 7.0}, (7.0,), (0.01,)),
    "gravity_imbalance": (
        {"torque_Nm": 2.0, "zero_rad": 0.3},
        (),
        (2.0 * math.cos(0.3), 2.0 * math.sin(0.3)),
    ),
    "return_spring": ({"stiffness_Nm_rad": 3.0, "rest_rad": 0.2}, (), (3.0, 0.6)),
    "end_stop": (
        {"angle_rad": 0.2, "stiffness_Nm_rad": 40.0, "other_rad": -0.25},
        (0.0, 0.2, -0.25),
        (40.0,),
    ),
    "load_position_dependence": ({"slope_per_rad": 0.3}, (), (0.3,)),
    "load_inertia": ({"inertia_kgm2": 0.3}, (), (0.3,)),
    "lever_pivot_friction": ({"torque_Nm": 1.1}, (), (1.1,)),
    "current_offset": ({"current_A": 0.3}, (), (0.3,)),
    "current_drift": ({"rate_A_s": 0.01}, (0.0,), (0.01,)),
    "backlash": ({"gap_rad": 0.007}, (0.007, 0.0, 0.0, 0.0), (1.0,)),
    "compliance": ({"stiffness_Nm_rad": 900.0}, (), (1.0 / 900.0, 0.0, 0.0, 0.0, 0.0)),
    "gear_mesh_ripple": (
        {"amplitude_rad": 1e-3, "per_turn": 23.0, "phase_rad": 0.0},
        (23.0, 1.0),
        (1e-3, 0.0),
    ),
    "coupling_hysteresis": (
        {"torque_Nm": 4.0, "deflection_rad": 2e-3},
        (4.0, 0.0, 2e-3, 0.0, 0.0),
        (1.0,),
    ),
    "encoder_eccentricity": ({"amplitude_rad": 1e-3, "phase_rad": 0.0}, (), (1e-3, 0.0)),
    "brush_drop": ({"voltage_V": 0.8, "current_A": 0.5}, (0.05, 0.0, 10.0), (0.8,)),
    "inverter_dead_time": ({"voltage_V": 0.8}, (1e-6, 0.0, 1.0), (0.8,)),
    "supply_sag": ({"resistance_ohm": 0.2}, (), (0.2,)),
}
"""Effect to its parameters, and to the shape and coefficients that the search would find for
them.
"""


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
    recording = Recording("r", channels, BENCH, "loaded", 20.0)
    return views([recording], 30.0)[0]


@pytest.mark.parametrize("name", list(LINEAR))
def test_an_effect_adds_what_the_search_fits(name: str, view: View) -> None:
    parameters, shape, coefficients = LINEAR[name]
    s, model = signals_of(view), CorrectedModel(NOMINAL, 2.0, {name: parameters})
    m, plain = model.numbers(view.recording), CorrectedModel(NOMINAL, 2.0)
    predicted = {
        "torque": (model.torque(s, m) - plain.torque(s, m))
        - (model.drive(s, m) - plain.drive(s, m)),
        "transmission": model.twist(s, m),
        "voltage": model.voltage(s, m) - plain.voltage(s, m),
    }
    term = next(t for t in TERMS if t.name == name)
    nominal = Nominal(NOMINAL, tuple(NOMINAL), 2.0)
    for equation, columns in term.columns.items():
        # The search takes the ratio's swing of the model's torque, so that none is measured; the
        # rest of it is exact.
        if equation == "breakaway" or (name, equation) == ("gear_mesh_ripple", "torque"):
            continue
        expected = np.array(coefficients) @ columns(view, nominal, shape)
        assert np.max(np.abs(expected)) > 0.0
        off = np.abs(predicted[equation] - expected)
        # The sample at which a rest ends counts as rest in the search alone.
        assert np.mean(off > 1e-6 * np.max(np.abs(expected))) < 0.002, equation


def test_what_rest_added_is_there_as_it_ends_and_gone_in_motion(view: View) -> None:
    """The search looks for it in breakaways alone."""
    s, m = signals_of(view), CorrectedModel(NOMINAL, 2.0).numbers(view.recording)
    found = TORQUE["dwell_static_friction"](s, m, 2.0, 1.0)
    term = next(t for t in TERMS if t.name == "dwell_static_friction")
    sought = 2.0 * term.columns["breakaway"](view, Nominal(NOMINAL, tuple(NOMINAL), 2.0), (1.0,))[0]
    assert len(view.breakaways) > 0
    assert found[view.breakaways] == pytest.approx(sought[view.breakaways], abs=1e-12)
    assert np.max(np.abs(sought[view.breakaways])) > 0.3
    after = np.concatenate([view.breakaways + k for k in range(1, 20)])
    assert not np.any(found[after])
    assert np.any(found[view.still])


def test_a_gear_s_torque_swings_as_its_ratio_does(view: View) -> None:
    """Power passes whole: drive times the motor's speed is the joint's torque times the joint's
    speed.
    """
    s = signals_of(view)
    m = CorrectedModel(NOMINAL, 2.0).numbers(view.recording)
    given = {"amplitude_rad": 1e-3, "per_turn": 23.0, "phase_rad": 0.4}
    at_joint = s["drive"] + DRIVE["gear_mesh_ripple"](s, m, **given)
    step = 1e-6
    ahead = TRANSMISSION["gear_mesh_ripple"]({**s, "angle": s["angle"] + step}, m, **given)
    ratio = 1.0 + (ahead - TRANSMISSION["gear_mesh_ripple"](s, m, **given)) / step
    assert at_joint == pytest.approx(s["drive"] * ratio, rel=1e-5)
    term = next(t for t in TERMS if t.name == "gear_mesh_ripple")
    nominal = Nominal(NOMINAL, tuple(NOMINAL), 2.0)
    coefficients = np.array([1e-3 * math.cos(0.4), 1e-3 * math.sin(0.4)])
    fitted = coefficients @ term.columns["torque"](view, nominal, (23.0, 1.0))
    assert fitted == pytest.approx(-nominal.torque(view) * (ratio - 1.0), abs=1e-4)


def test_the_nominal_torque_is_that_of_the_diagnosis(view: View) -> None:
    model = CorrectedModel(NOMINAL, 2.0)
    expected = Nominal(NOMINAL, tuple(NOMINAL), 2.0).torque(view)
    sliding = view.sense == np.sign(view.velocity)
    assert np.mean(sliding) > 0.9
    found = nominal_torque(signals_of(view), model.numbers(view.recording))
    assert found[sliding] == pytest.approx(expected[sliding], abs=1e-9)


def test_every_effect_of_the_catalogue_is_carried_with_its_own_parameters() -> None:
    tables = (TORQUE, DRIVE, TRANSMISSION, VOLTAGE)
    assert {name for table in tables for name in table} == set(MOTION)
    for table in tables:
        for name, function in table.items():
            named = set(list(inspect.signature(function).parameters)[2:])
            assert named - {"recording"} == {q.name for q in MOTION[name].parameters}, name


def test_a_size_of_nothing_adds_nothing(view: View) -> None:
    s = signals_of(view)
    m = CorrectedModel(NOMINAL, 2.0).numbers(view.recording)
    same = {"load_exponent": 1.0, "transmission_efficiency": 1.0, "stribeck_shape": 2.0}
    for name, value in same.items():
        table = DRIVE if name in DRIVE else TORQUE
        assert np.max(np.abs(table[name](s, m, value))) < 1e-12, name
    assert np.max(np.abs(TORQUE["wrong_weight"](s, m, 20.0, 1))) < 1e-12
    assert np.max(np.abs(DRIVE["time_skew"](s, m, 0.0))) < 1e-12
    assert np.max(np.abs(DRIVE["current_loop_lag"](s, m, 0.0))) < 1e-12


def test_a_heavier_weight_than_its_label_scales_the_load_of_its_recording_alone(view: View) -> None:
    s, m = signals_of(view), CorrectedModel(NOMINAL, 2.0).numbers(view.recording)
    unloaded = nominal_torque({**s, "moment": 0.0 * s["moment"]}, m)
    heavier = nominal_torque({**s, "moment": 1.25 * s["moment"]}, m) - nominal_torque(s, m)
    assert TORQUE["wrong_weight"](s, m, 25.0, 1) == pytest.approx(heavier, abs=1e-9)
    assert np.max(np.abs(nominal_torque(s, m) - unloaded)) > 1.0
    assert not np.any(TORQUE["wrong_weight"](s, m, 25.0, 2))


def test_states_agree_with_the_compiled_ones(view: View) -> None:
    torque = view.torque
    level = 6.0 + 2.0 * np.abs(view.velocity)
    assert lagged(torque, view.time, 0.02) == pytest.approx(
        memory.first_order_lag(torque, view.step, 0.02), abs=1e-9
    )
    assert dahl_friction(view.angle, level, 2e3) == pytest.approx(
        memory.dahl(view.angle, level, 2e3), abs=1e-12
    )
    assert play(view.angle, 0.01) == pytest.approx(memory.play(view.angle, 0.01), abs=1e-12)


def test_a_curve_is_carried_in_its_own_equation_alone(view: View) -> None:
    s = signals_of(view)
    grid = np.linspace(-0.3, 0.3, 7)
    curve = Curve("torque", "angle", "rad", "N m", grid, grid**2)
    missing = carried(curve, "torque", s)
    assert missing == pytest.approx(np.interp(view.angle, grid, grid**2))
    assert not np.any(carried(curve, "voltage", s))
    model = CorrectedModel(NOMINAL, 2.0, {}, curve)
    m = model.numbers(view.recording)
    assert model.torque(s, m) - nominal_torque(s, m) == pytest.approx(missing)
