"""The library as its users import it: data in, results out, nothing else loaded or printed."""

import doctest
import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import identification as lr
from identification.effects import prediction
from identification.numerics.spread import Spread, quantile
from identification.simulation.closed_loop import replay
from identification.views import view

from .synthetic import BENCH, LOAD, SYSTEM, TRUTH, sine

RATE = 250.0
DOCS = Path(__file__).parents[2] / "docs"
TIME = np.arange(3000) / 500.0
LOOP = lr.Controller("torque", 4000.0, 100.0)
SWING = lr.Recording(TIME, command=0.3 * np.sin(2.0 * TIME), controller=LOOP, bench=BENCH)


def noisy(seed: int = 0, **given: Any) -> lr.Recording:
    """A recording at a slow rate, which a fit takes a tenth of a second for."""
    rng = np.random.default_rng(seed)
    return sine(rate=RATE, noise=lambda n: 0.05 * rng.normal(size=n), **given)


@pytest.fixture(scope="module")
def found() -> Any:
    return lr.identify([noisy(), noisy(1, weight=30.6)], rng=0)


@pytest.mark.parametrize("module", ["library", "recording", "numerics.spread"])
def test_the_examples_of_the_docstrings_hold(module: str) -> None:
    done = doctest.testmod(import_module(f"identification.{module}"))
    assert done.attempted
    assert not done.failed


def run_page(page: str) -> None:
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    plain = re.sub(r"^```.*$", "", text, flags=re.MULTILINE)
    examples = doctest.DocTestParser().get_doctest(plain, {}, page, page, 0)
    runner = doctest.DocTestRunner()
    runner.run(examples)
    assert runner.tries
    assert not runner.failures


def test_the_guide_is_a_session_that_runs() -> None:
    run_page("guides/library")


@pytest.mark.proof
def test_the_tutorial_goes_from_a_csv_to_a_corrected_model(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_page("tutorials/python")


def test_the_import_is_quick_and_loads_nothing_else() -> None:
    script = (
        "import time; t = time.perf_counter(); import identification as lr; "
        "took = time.perf_counter() - t; lr.identify; lr.catalogue; import sys; "
        "print(took, *{m.partition('.')[0] for m in sys.modules} & "
        "{'rig', 'drivers', 'matplotlib', 'pandas', 'xarray'})"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    seconds, *others = done.stdout.split()
    assert float(seconds) < 0.3
    assert not others


def test_everything_that_is_exported_is_there() -> None:
    assert set(dir(lr)) == {*lr.__all__}
    assert all(getattr(lr, name) is not None for name in lr.__all__)
    with pytest.raises(AttributeError):
        _ = lr.nothing


class Variables:
    """A Dataset as xarray has it: variables are iterated, coordinates are apart."""

    def __init__(self, variables: Mapping[str, Any], coords: Mapping[str, Any]) -> None:
        self.variables, self.coords = variables, coords

    def __iter__(self) -> Iterator[str]:
        return iter(self.variables)

    def __getitem__(self, name: str) -> Any:
        return self.variables[name]


def test_arrays_columns_and_tables_give_the_same_recording() -> None:
    time = np.arange(5) / 100.0
    angle, current = time**2, np.arange(5)
    frame = pd.DataFrame({"angle": angle, "current": current}, index=pd.Index(time, name="time"))
    stamps = pd.Timestamp("2026-01-01") + pd.to_timedelta(time, unit="s")
    for made in (
        lr.Recording(list(time), list(angle), list(current)),
        lr.Recording(frame.index, frame["angle"], frame["current"]),
        lr.Recording(channels=frame),
        lr.Recording(channels=frame.reset_index()),
        lr.Recording(stamps, angle, channels={"current": current}),
        lr.Recording(channels=Variables({"angle": angle, "current": current}, {"time": time})),
    ):
        assert {*made.channels} == {"time", "angle", "current"}
        for name, values in (("time", time), ("angle", angle), ("current", current)):
            assert made.channels[name].dtype == np.float64
            np.testing.assert_allclose(made.channels[name], values, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"angle": ["a", "b"]}, "angle"),
        ({"angle": [0.0, 1.0, 2.0]}, "angle"),
        ({"channels": {"speed": [0.0, 1.0]}}, "speed"),
    ],
)
def test_a_signal_that_is_none_is_an_error(given: dict[str, Any], word: str) -> None:
    with pytest.raises(lr.RecordingError, match=word):
        lr.Recording([0.0, 1.0], **given)


def test_a_missing_sample_is_an_error_with_its_place() -> None:
    recording = noisy()
    angle = recording.channels["angle"].copy()
    angle[17] = math.nan
    broken = lr.Recording(recording.time, angle, torque=recording.channels["torque"])
    with pytest.raises(lr.RecordingError, match="sample 17"):
        lr.identify(broken)
    with pytest.raises(lr.RecordingError, match="sample 17"):
        lr.simulate(TRUTH, broken, draws=0)
    command = SWING.channels["command"].copy()
    command[17] = math.nan
    holed = lr.Recording(TIME, command=command, controller=LOOP, bench=BENCH)
    with pytest.raises(lr.RecordingError, match="sample 17"):
        lr.plan(TRUTH, holed, torque_noise=0.05, joint_step=1.5e-5)


@pytest.mark.parametrize(
    "given",
    [
        {"fixed": {"mass": 1.0}},
        {"fixed": {"J": 1.0}, "bounds": {"J": (0.0, 2.0)}},
        {"fixed": {"J": 1.0}, "priors": {"J": (1.0, 0.1)}},
        {"bounds": {"J": (2.0, 1.0)}},
        {"priors": {"J": (2.0, 0.0)}},
        {"friction": "none"},
    ],
)
def test_a_model_that_contradicts_itself_is_an_error(given: dict[str, Any]) -> None:
    with pytest.raises(lr.RecordingError):
        lr.Model(**given)


TABLE = {"time": [0.0, 1.0], "angle": [0.0, 1.0]}


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: lr.Recording(channels=TABLE, role="train"), ("role", "train", "validate")),
        (lambda: lr.Recording(channels=TABLE, stage="heavy"), ("stage", "heavy", "unloaded")),
        (lambda: lr.Controller("amps", 3.0), ("output", "amps", "duty")),
    ],
)
def test_an_argument_that_is_impossible_is_named(make: Any, words: tuple[str, ...]) -> None:
    with pytest.raises((ValueError, TypeError)) as error:
        make()
    assert all(word in str(error.value) for word in words)


def test_recordings_of_two_units_are_not_one_machine() -> None:
    with pytest.raises(lr.RecordingError, match="2 units"):
        lr.identify([replace(noisy(k), unit=unit) for k, unit in enumerate("ab")])


def test_a_model_that_lacks_something_is_said_to(found: Any) -> None:
    plain = noisy()
    torque = plain.channels["torque"] + 20.0 * plain.channels["angle"]
    lacking = lr.identify(lr.Recording(plain.time, plain.channels["angle"], torque=torque), rng=0)
    assert not found.misfit
    assert "above_noise_floor" in lacking.misfit
    assert lacking.misfit_words in lacking.warnings[0]


def test_a_model_says_what_is_free(found: Any) -> None:
    assert {*lr.Model().free} == {*SYSTEM, *LOAD} == {*found.values}
    assert {*lr.Model(fixed={"J": 1.0}, terms=("offset",)).free} == {*SYSTEM, *LOAD, "offset"} - {
        "J"
    }


def test_values_intervals_and_covariance_agree(found: Any) -> None:
    covariance = found.covariance
    assert {*covariance.names} == {*found.intervals} == {*found.values}
    deviation = np.sqrt(np.diag(covariance.matrix))
    for name, sigma in zip(covariance.names, deviation, strict=True):
        low, high = found.intervals[name]
        assert 0.5 * (high - low) == pytest.approx(quantile(covariance.freedom) * sigma)
        assert 0.5 * (high + low) == pytest.approx(found.values[name])
    np.testing.assert_allclose(np.diag(found.correlation), 1.0)
    assert found.values["J"] == pytest.approx(TRUTH["J"], rel=0.2)


def test_a_parameter_without_variance_has_no_correlation() -> None:
    """As one at its bound."""
    spread = Spread(("a", "b"), np.array([[4.0, 0.0], [0.0, 0.0]]), math.inf)
    np.testing.assert_array_equal(spread.correlation, np.eye(2))


def test_residuals_are_what_the_error_is_of(found: Any) -> None:
    left = np.concatenate([r[np.isfinite(r)] for r in found.residuals.values()])
    assert math.sqrt(float(np.mean(left**2))) == pytest.approx(found.fit.train_rms, rel=0.3)


def test_the_result_as_a_dictionary_is_json(found: Any) -> None:
    record = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    np.testing.assert_allclose(record["covariance"]["matrix"], found.covariance.matrix)
    assert record["parameters"]["J"]["value"] == found.values["J"]
    assert record["ranges"]["moment"][1] == pytest.approx(306.0 * 9.80665 * 0.095)


def test_a_seed_repeats_and_recordings_of_one_name_are_told_apart() -> None:
    again = [lr.identify([noisy(), noisy(1)], rng=seed) for seed in (3, np.random.default_rng(3))]
    assert again[0].values == again[1].values
    assert {*again[0].residuals} == {"sine", "sine 2"}


def test_a_bound_that_is_not_reached_changes_no_value() -> None:
    free = lr.identify(noisy(), rng=0)
    held = lr.identify(noisy(), lr.Model(bounds={"J": (0.1, 0.3), "Mc": (6.8, 7.0)}), rng=0)
    assert held.values == free.values
    assert held.intervals["Mc"][0] == max(free.intervals["Mc"][0], 6.8)
    assert held.warnings == free.warnings


def test_an_estimate_beyond_its_bound_is_set_to_it() -> None:
    free = lr.identify(noisy(), rng=0)
    low, _ = free.intervals["J"]
    bound = 0.5 * (free.values["J"] + low)
    found = lr.identify(noisy(), lr.Model(bounds={"J": (0.0, bound)}), rng=0)
    assert found.values["J"] == bound
    assert found.parameters["J"].at_bound
    assert found.intervals["J"] == (pytest.approx(low), bound)
    fixed = lr.identify(noisy(), lr.Model(fixed={"J": bound}), rng=0)
    assert found.values["sigma_2"] == fixed.values["sigma_2"]
    # What is left open of the inertia is in the covariance of the others too.
    assert found.covariance.half_width("Ms") > fixed.covariance.half_width("Ms")
    far = lr.identify(noisy(), lr.Model(bounds={"J": (0.0, 0.1)}), rng=0)
    assert far.intervals["J"] == (0.1, 0.1)
    assert any("J is at its bound" in w for w in far.warnings)


def test_another_inertia_takes_another_torque() -> None:
    one, four = (lr.simulate(TRUTH, SWING, values={"J": j}, draws=0) for j in (0.2, 0.8))
    steady = (np.abs(one.velocity) > 0.3) & (TIME > 0.5)
    more = (four.torque - one.torque)[steady]
    assert more == pytest.approx(-0.6 * 4.0 * one.angle[steady], abs=0.1)
    with pytest.raises(lr.RecordingError, match="mass"):
        lr.simulate(TRUTH, SWING, values={"mass": 1.0})


@pytest.mark.parametrize(
    ("effect", "parameters", "torque"),
    [
        (
            "gravity_imbalance",
            {"torque_Nm": 2.0, "zero_rad": 0.3},
            lambda s: 2.0 * np.sin(s.angle - 0.3),
        ),
        ("asymmetric_coulomb", {"torque_Nm": 0.4}, lambda s: 0.4),
        (
            "quadratic_drag",
            {"coefficient_Nms2_rad2": 3.0},
            lambda s: 3.0 * s.velocity * np.abs(s.velocity),
        ),
        ("current_offset", {"current_A": 0.3}, lambda s: 0.9),
    ],
)
def test_effects_act_in_the_loop(effect, parameters, torque):
    given = {f"{effect}.{name}": value for name, value in parameters.items()}
    plain = lr.simulate(TRUTH, SWING, draws=0)
    found = lr.simulate({**TRUTH, **given}, SWING, draws=0)
    assert not found.warnings
    moving = (np.abs(found.velocity) > 0.2) & (TIME > 0.3)
    added = (found.torque - plain.torque)[moving]
    assert added == pytest.approx(np.broadcast_to(torque(found), TIME.shape)[moving], abs=0.05)


def test_an_effect_that_adds_no_torque_is_said_to_be_left_out() -> None:
    found = lr.simulate({**TRUTH, "backlash.gap_rad": 0.004}, SWING, draws=0)
    assert any("backlash" in w for w in found.warnings)


def test_an_effect_of_one_recording_is_not_in_another() -> None:
    wrong = {"wrong_weight.mass_kg": 60.0, "wrong_weight.recording": 1.0}
    motion = sine(weight=30.6)
    plain = lr.simulate(TRUTH, motion, draws=0)
    found = lr.simulate({**TRUTH, **wrong}, motion, draws=0)
    np.testing.assert_array_equal(found.torque, plain.torque)
    assert len(found.warnings) == len(plain.warnings) + 1
    assert "wrong_weight" in found.warnings[-1]


def test_what_is_given_decides_what_is_predicted(found: Any) -> None:
    looped = lr.simulate(found, SWING, rng=0)
    made = lr.Recording(TIME, looped.angle, torque=looped.torque, bench=BENCH)
    required = lr.simulate(found, made, rng=0)
    assert (looped.given, required.given) == ("command", "motion")
    moving = np.isfinite(required.torque)
    assert required.torque[moving] == pytest.approx(required.measured[moving], abs=0.05)
    push = lr.Recording(TIME, torque=looped.torque, bench=BENCH)
    driven = lr.simulate(found, push, rng=0)
    assert driven.given == "torque"
    # After a reversal a torque alone does not reproduce a motion with stick and slip.
    before = TIME < 0.7
    assert driven.angle[before] == pytest.approx(looped.angle[before], abs=1e-3)
    forced = lr.simulate(found, made, given="torque", rng=0)
    assert forced.angle == pytest.approx(driven.angle, abs=1e-9)
    with pytest.raises(lr.RecordingError, match="controller"):
        lr.simulate(found, made, given="command")


def test_bands_hold_what_is_measured_and_grow_with_the_uncertainty(found: Any) -> None:
    inside = []
    for seed in range(5, 11):
        other = noisy(seed, frequency=0.15, amplitude=0.3, weight=30.6 * (seed % 2))
        made = lr.simulate(found, other, rng=seed)
        assert not np.any(made.outside)
        moving = np.isfinite(made.torque)
        low, high = (ends["torque"][moving] for ends in (made.low, made.high))
        inside.append(np.mean((low <= made.measured[moving]) & (made.measured[moving] <= high)))
    assert 0.85 <= float(np.mean(inside)) <= 0.97
    less = lr.simulate(found, other, values=dict(found.values), rng=0)
    moving = np.isfinite(less.torque)
    width = [np.mean((s.high["torque"] - s.low["torque"])[moving]) for s in (less, made)]
    assert width[0] == pytest.approx(2.0 * 1.645 * found.fit.train_rms, rel=1e-3)
    assert width[1] > width[0]


def test_a_simulation_keeps_nothing_and_draws_only_from_a_covariance(
    found: Any, monkeypatch: Any
) -> None:
    runs = []
    monkeypatch.setattr(
        prediction, "replay", lambda *a, **more: runs.append(1) or replay(*a, **more)
    )
    lr.simulate(TRUTH, SWING)
    assert len(runs) == 1
    most = []
    model = prediction.CorrectedModel.torque

    def counted(*given: Any) -> Any:
        most.append(kept())
        return model(*given)

    monkeypatch.setattr(prediction.CorrectedModel, "torque", counted)
    lr.simulate(found, noisy(weight=30.6), draws=20)
    assert len(most) == 21
    assert max(most) < 10
    assert kept() == 0


def kept() -> int:
    return sum(c.cache_info().currsize for c in view._CACHES)


def test_what_was_not_recorded_is_marked(found: Any) -> None:
    fast = lr.simulate(found, noisy(3, frequency=0.4), rng=0)
    most = found.ranges["velocity"][1]
    assert np.any(fast.outside)
    np.testing.assert_array_equal(fast.outside, np.abs(fast.velocity) > 1.001 * most)
    assert any(w.startswith("velocity") for w in fast.warnings)
    heavy = lr.simulate(found, noisy(3, weight=60.0), rng=0)
    assert np.all(heavy.outside)


def test_a_plan_says_what_an_experiment_pins() -> None:
    time = np.arange(0.0, 10.0, 0.001)
    short, long = (
        lr.plan(
            TRUTH,
            lr.Recording(time[:n], command=0.35 * np.sin(1.3 * time[:n]), bench=BENCH),
            torque_noise=0.05,
            joint_step=1.5e-5,
        )
        for n in (5000, 10000)
    )
    assert {*long.half_widths} == {*SYSTEM}
    assert long.half_widths["Mc"] < short.half_widths["Mc"] < 0.05
    with pytest.raises(lr.RecordingError, match="torque_noise"):
        lr.plan(TRUTH, SWING)
    coarse = lr.Recording(time[::2], command=np.sin(time[::2]), bench=BENCH, name="coarse")
    fine = lr.Recording(time, command=np.sin(time), bench=BENCH)
    with pytest.raises(lr.RecordingError, match="coarse"):
        lr.plan(TRUTH, [fine, coarse], torque_noise=0.05, joint_step=1.5e-5)


def test_a_measured_force_is_a_load() -> None:
    time = np.arange(0.0, 2.0, 0.001)
    angle, force = np.sin(time), np.full(len(time), 100.0)
    bench = lr.Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.1)
    pressed = lr.Recording(time, angle, angle, load_force=force, bench=bench)
    assert (pressed.stage, lr.Recording(time, angle, angle).stage) == ("loaded", "unloaded")
    free = lr.Recording(time, angle, angle, load_force=0.0 * force, bench=bench, stage="loaded")
    with pytest.raises(lr.RecordingError, match="contact force is zero"):
        lr.identify([lr.Recording(time, angle, angle, bench=bench), free])
