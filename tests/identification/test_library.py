"""The library as its users import it: data in, results out, nothing else loaded or printed."""

from __future__ import annotations

import doctest
import json
import math
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import numpy as np
import pandas as pd
import pytest

import identification as lr
from identification.numerics.spread import quantile

from .synthetic import LOAD, SYSTEM, TRUTH, sine

RATE = 250.0


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
