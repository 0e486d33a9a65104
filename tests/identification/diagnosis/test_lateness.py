"""Channels that are late, and what samples at instants leave unknown."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.rows import Equation
from identification.diagnosis.stack import view_regressors
from identification.effects import MOTION
from identification.effects.effect import Effect
from identification.effects.model import CorrectedModel
from identification.numerics.series import delayed_series
from identification.recording import Bench, Controller, Dataset, Model, Recording
from identification.signals import central_difference, values_at_ends
from identification.views.view import views, voltage_is_computed

from .benches import FEW, campaign, honest, nominal_fit

TIME = np.arange(3000) / 140.0
LATE_S, GAIN, SUPPLY_V = 0.007, 2.0, 6.0
BENCH = Bench(torque_constant=0.5, back_emf_constant=0.5, resistance=4.0)


def _law(command_time: np.ndarray, angle_time: np.ndarray) -> np.ndarray:
    return SUPPLY_V * GAIN * (np.sin(2.0 * command_time) - 0.9 * np.sin(2.0 * angle_time - 0.2))


def _recording() -> Recording:
    seen = TIME - LATE_S
    channels = {
        "angle": 0.9 * np.sin(2.0 * seen - 0.2),
        "command": np.sin(2.0 * TIME),
        "voltage": _law(TIME, seen),
        "supply_voltage": np.full(len(TIME), SUPPLY_V),
    }
    return Recording(TIME, channels=channels, bench=BENCH, controller=Controller("duty", GAIN))


def test_only_the_command_in_a_computed_voltage_is_early() -> None:
    (view,) = views([_recording()], 10.0)
    seen = view.time - LATE_S
    expected = 0.5 / 4.0 * (_law(view.time, seen) - _law(seen, seen))
    off = view.command_delay_error(LATE_S) - expected
    assert np.max(np.abs(off[2:])) < 2e-3 * np.max(np.abs(expected))


def test_a_voltage_is_computed_only_if_the_declared_law_makes_it() -> None:
    recording = _recording()
    assert voltage_is_computed(recording)
    assert not voltage_is_computed(replace(recording, controller=None))
    assert not voltage_is_computed(replace(recording, controller=Controller("duty", 1.01 * GAIN)))
    assert not voltage_is_computed(
        replace(recording, channels={**recording.channels, "current": np.zeros(len(TIME))})
    )
    noisy = recording.channels["voltage"] + np.random.default_rng(0).normal(0.0, 0.05, len(TIME))
    assert not voltage_is_computed(
        replace(recording, channels={**recording.channels, "voltage": noisy})
    )


@pytest.mark.parametrize(
    ("late", "early"), [("angles", 0.004), pytest.param("current", 0.004, marks=pytest.mark.proof)]
)
def test_a_skew_is_found_whichever_channel_is_late(late: str, early: float) -> None:
    """Angles that are late against current and voltage are no lag of the current loop."""
    moved = ("motor_angle", "angle") if late == "angles" else ("current",)

    def skewed(recording: Recording) -> Recording:
        time = recording.time
        channels = {
            name: np.interp(time - early, time, values) if name in moved else values
            for name, values in recording.channels.items()
        }
        return replace(recording, channels=channels)

    found = diagnose(
        Dataset(tuple(skewed(r) for r in campaign({}, 21, 8.0, FEW)), Model()),
        rng=np.random.default_rng(0),
    )
    assert [e.name for e in found.effects] == ["time_skew"]
    expected = -early if late == "angles" else early
    assert found.effects[0].parameters["time_s"].value == pytest.approx(expected, rel=0.05)


BEHIND_S = 0.008
TERM = {t.name: t for t in MOTION}
COGGING = (7.0,)


def with_skew(joint: Joint, ripple: Effect, fraction: tuple[float, float]) -> float:
    """Return the torque's mean square over the noise's with a skew and a ripple fitted."""
    effects = (Added(TERM["time_skew"], (BEHIND_S,), (1.0,)), Added(ripple, (4.0,), fraction))
    found = fit(joint.equations[0].views, "N m", joint.nominal, effects, joint)
    return float(np.mean(found.residual[found.stack.part("torque")] ** 2))


@pytest.mark.parametrize(
    "name", ["cogging", "torque_ripple", "gear_mesh_ripple", "position_dependent_friction"]
)
def test_a_regressor_at_an_angle_is_late_where_the_torque_is(name: str) -> None:
    joint = nominal_fit(honest())
    view, term = joint.equations[0].views[1], TERM[name]
    shape = {"gear_mesh_ripple": (20.0, 1.0), "position_dependent_friction": (0.1, 0.05)}.get(
        name, COGGING
    )
    prompt = view_regressors(term, "torque", joint.nominal, shape)(view)
    late = view_regressors(term, "torque", replace(joint.nominal, late_s=BEHIND_S), shape)(view)
    steady = (
        np.abs(view.velocity) > 0.1
    )  # friction jumps at a reversal, which no interpolation follows
    expected = np.stack([delayed_series(row, view.step, BEHIND_S) for row in prompt])
    assert np.max(np.abs(late - expected)[:, steady]) < 5e-3 * np.max(np.abs(expected))
    assert np.max(np.abs(prompt - expected)[:, steady]) > 0.02 * np.max(np.abs(expected))


def test_the_corrected_model_moves_a_ripple_as_the_fit_does() -> None:
    joint = nominal_fit(honest())
    view, nominal = joint.equations[0].views[1], replace(joint.nominal, late_s=BEHIND_S)
    own = {"torque_Nm": 0.3, "per_motor_turn": 7.0, "phase_rad": 0.4}
    skew = {"time_skew": {"time_s": BEHIND_S}}
    both, alone = (
        CorrectedModel(joint.nominal.values, joint.nominal.alpha, effects)
        for effects in (skew | {"cogging": own}, skew)
    )
    added = both.added_torque(view) - alone.added_torque(view)
    shape, coefficients = TERM["cogging"].at(own, nominal)
    fitted = np.array(coefficients) @ view_regressors(TERM["cogging"], "torque", nominal, shape)(
        view
    )
    assert np.max(np.abs(np.abs(added) - np.abs(fitted))) < 1e-9


def test_a_ripple_beside_a_late_current_leaves_far_less() -> None:
    """Each way its phase is another, where its angle is not late as well."""
    hidden = {
        "time_skew": {"time_s": BEHIND_S},
        "torque_ripple": {"fraction": 0.1, "per_motor_turn": 4.0, "phase_rad": 0.0},
    }
    joint = nominal_fit(campaign(hidden, 3, 6.0))
    ripple = TERM["torque_ripple"]
    prompt = with_skew(joint, ripple.modified(at_angle=False), (0.1, 0.0))
    assert with_skew(joint, ripple, (0.1, 0.0)) < 0.01 * prompt


BOTH = frozenset({"voltage", "current"})
RIPPLE = 0.02
"""Voltage in proportion to the command's acceleration, V s^2/rad."""


def rippled(
    recordings: Sequence[Recording], averaged: frozenset[str], size: float = RIPPLE
) -> list[Recording]:
    out = []
    for r in recordings:
        speed = central_difference(r.channels["command"], r.period)
        current = r.channels["current"]
        if "current" not in averaged:
            current = values_at_ends(r.time, current, r.period)
        voltage = r.channels["voltage"] + size * central_difference(speed, r.period)
        out.append(
            replace(
                r,
                channels={**r.channels, "voltage": voltage, "current": current},
                averaged=averaged,
            )
        )
    return out


def voltage_equation(recordings: Sequence[Recording]) -> Equation:
    return next(e for e in nominal_fit(recordings).equations if e.name == "voltage")


def left(equation: Equation) -> float:
    """Return the mean square of the whitened rows after the fit of the equation's parameters."""
    found, *_ = np.linalg.lstsq(equation.tangent, equation.residual, rcond=None)
    rest = equation.residual - equation.tangent @ found
    return float(np.mean((rest / equation.sigma) ** 2))


def test_a_ripple_of_the_command_is_a_parameter_where_values_are_samples_at_instants() -> None:
    found = []
    for size in (0.0, RIPPLE):
        equation = voltage_equation(rippled(honest(), frozenset({"voltage"}), size))
        assert equation.names == ("R", "Ke", "ripple")
        fitted, *_ = np.linalg.lstsq(equation.tangent, equation.residual, rcond=None)
        found.append(fitted[2])
        assert left(equation) < 1.2
    assert found[1] - found[0] == pytest.approx(RIPPLE, rel=0.01)


def test_means_have_no_ripple_so_that_it_stays_a_mismatch() -> None:
    equation = voltage_equation(rippled(honest(), BOTH))
    assert equation.names == ("R", "Ke")
    assert left(equation) > 4.0
