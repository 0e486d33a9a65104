"""The paper's staged method on synthetic recordings with known parameters."""

import dataclasses

import numpy as np
import pytest

from identification.estimate.paper_method import (
    GENERATIONS,
    POPULATION,
    TorqueMisfit,
    identify_paper,
)
from identification.model.parameters import LOAD_PARAMETERS, SYSTEM_PARAMETERS
from identification.recording import Bench, Dataset, Model, Recording, RecordingError

TRUTH = {
    "Mc": 6.825,
    "Ms": 12.025,
    "omega_sf": 0.0557,
    "sigma_2": 5.3462,
    "J": 0.204,
    "mu_c": 0.052,
    "mu_s": 0.086,
    "omega_sL": 0.0326,
    "mu_2": 0.032,
}
RATE = 100.0
BENCH = Bench(moment_arm=0.095)


def synthetic(
    name: str, stage: str = "unloaded", *, role: str = "fit", frequency: float = 0.2
) -> Recording:
    """A recording of exact channels, written from eq. 15 without the package's own friction."""
    time = (np.arange(int(10 * RATE)) + 0.5) / RATE
    w = 2.0 * np.pi * frequency
    amplitude = np.deg2rad(20.0)
    velocity = amplitude * w * np.cos(w * time)
    acceleration = -amplitude * w * w * np.sin(w * time)
    mass = 30.6 if stage == "loaded" else 0.0
    t = TRUTH
    torque = t["sigma_2"] * velocity + t["J"] * acceleration
    torque += np.sign(velocity) * (
        t["Mc"] + (t["Ms"] - t["Mc"]) * np.exp(-((velocity / t["omega_sf"]) ** 2))
    )
    moment = BENCH.contact_force(mass) * 0.095
    dry = t["mu_c"] + (t["mu_s"] - t["mu_c"]) * np.exp(-((velocity / t["omega_sL"]) ** 2))
    torque += moment * (np.sign(velocity) * dry + t["mu_2"] * velocity)
    channels = {
        "time": time,
        "angle": amplitude * np.sin(w * time),
        "velocity": velocity,
        "torque": torque,
    }
    return Recording(name, channels, BENCH, stage=stage, weight_mass=mass, role=role)  # type: ignore[arg-type]


def worst_error(values: dict[str, float], names: tuple[str, ...]) -> float:
    return max(abs(values[n] / TRUTH[n] - 1.0) for n in names if n != "J")


def fit(dataset: Dataset, seed: int, **more: object):
    return identify_paper(dataset, bandwidth_Hz=0.5 * RATE, rng=np.random.default_rng(seed), **more)  # type: ignore[arg-type]


def test_misfit_is_the_norm_written_out() -> None:
    rng = np.random.default_rng(0)
    n, p = 5000, 7
    velocity, acceleration, torque = (
        rng.normal(0.0, 0.3, n),
        rng.normal(size=n),
        rng.normal(0.0, 9.0, n),
    )
    load = rng.uniform(1.0, 2.0, n)
    c, s, v, inertia = rng.uniform(0.0, 10.0, (4, p))
    w_s = rng.uniform(1e-3, 0.5, p)
    expected = []
    for k in range(p):
        dry = c[k] + (s[k] - c[k]) * np.exp(-(np.abs(velocity / w_s[k]) ** 1.5))
        model = load * (np.sign(velocity) * dry + v[k] * velocity) + inertia[k] * acceleration
        expected.append(np.sqrt(np.sum((torque - model) ** 2)))
    found = TorqueMisfit(torque, velocity, acceleration, load, 1.5).norms(c, s, w_s, v, inertia)
    assert found == pytest.approx(expected, rel=1e-10)


def test_error_level_and_wrong_basins_of_the_first_stage() -> None:
    """The paper prints errors up to 3.62 %; a search in all five at once may also end far off."""
    dataset = Dataset((synthetic("a"),))
    errors = np.array(
        [worst_error(fit(dataset, seed).values(), SYSTEM_PARAMETERS) for seed in range(8)]
    )
    assert np.mean(errors > 0.2) <= 0.4
    assert 0.001 < np.median(errors) < 0.15


def test_both_stages() -> None:
    dataset = Dataset(
        (
            synthetic("a"),
            synthetic("b", "loaded"),
            synthetic("c", "loaded", role="validate", frequency=0.15),
        )
    )
    told: list[tuple[str, float]] = []
    result = fit(dataset, 1, progress=lambda stage, share: told.append((stage, share)))
    assert worst_error(result.values(), SYSTEM_PARAMETERS + LOAD_PARAMETERS) < 0.2
    assert [s.stage for s in result.stages] == ["unloaded", "loaded"]
    for stage in result.stages:
        assert stage.evaluations == POPULATION * GENERATIONS
        assert stage.cost_history is not None
        assert np.all(np.diff(stage.cost_history) <= 0.0)
        assert stage.cost_history[-1] == stage.cost
        assert stage.reached is False
        assert all(len(h) == GENERATIONS for h in stage.parameter_history.values())
    assert result.fit.validate_rms is not None
    assert result.fit.validate_rms < 0.3
    assert all(p.low is None and p.high is None for p in result.parameters.values())
    assert told[0] == ("unloaded", 1.0 / GENERATIONS)
    assert told[-1] == ("loaded", 1.0)


def test_fitness_is_the_norm_of_the_torque_error() -> None:
    result = fit(Dataset((synthetic("a"),)), 2, generations=200)
    trace = result.traces[0]
    final = {name: history[-1] for name, history in result.stages[0].parameter_history.items()}
    moving = (trace.used > 0.5) & (trace.velocity != 0.0)
    w = trace.velocity[moving]
    model = np.sign(w) * (
        final["Mc"] + (final["Ms"] - final["Mc"]) * np.exp(-((w / final["omega_sf"]) ** 2))
    )
    error = trace.friction[moving] - model - final["sigma_2"] * w
    assert result.stages[0].cost == pytest.approx(np.linalg.norm(error), rel=1e-6)


def test_inertia_is_given_only_where_its_torque_stands_out_of_the_misfit() -> None:
    slow = fit(Dataset((synthetic("a"),)), 0, generations=3).parameters["J"]
    assert (slow.value, slow.identifiable) == (None, False)
    assert "below the torque error of the fit" in slow.reason
    fast = fit(Dataset((synthetic("a", frequency=2.0),)), 0).parameters["J"]
    assert fast.identifiable
    assert fast.value == pytest.approx(TRUTH["J"], rel=0.2)


def test_rest_is_left_out() -> None:
    moving = synthetic("a")
    rest = np.full(300, moving.channels["angle"][-1])
    time = moving.time[-1] + np.arange(1, 301) / RATE
    more = {"time": time, "angle": rest, "velocity": np.zeros(300), "torque": np.full(300, 3.0)}
    channels = {
        name: np.concatenate([values, more[name]]) for name, values in moving.channels.items()
    }
    result = fit(Dataset((dataclasses.replace(moving, channels=channels),)), 0, generations=5)
    assert not result.traces[0].used[-290:].any()
    assert result.stages[0].method.endswith("samples")


def test_held_parameters_are_kept() -> None:
    dataset = Dataset((synthetic("a"),), Model(fixed={"J": 0.204, "sigma_2": 5.0}))
    result = fit(dataset, 0, generations=20)
    assert result.parameters["J"].value == 0.204
    assert result.parameters["sigma_2"].value == 5.0
    assert set(result.stages[0].parameter_history) == {"Mc", "Ms", "omega_sf"}


def test_everything_held_needs_no_search() -> None:
    dataset = Dataset((synthetic("a"),), Model(fixed={n: TRUTH[n] for n in SYSTEM_PARAMETERS}))
    result = fit(dataset, 0)
    assert result.stages == ()
    assert result.fit.train_rms < 0.02


def test_same_seed_same_result() -> None:
    dataset = Dataset((synthetic("a"), synthetic("b", "loaded")))
    first, second = (fit(dataset, 5, generations=30).parameters for _ in range(2))
    assert first == second


def test_a_declared_term_is_not_silently_dropped() -> None:
    result = fit(Dataset((synthetic("a"),), Model(terms=("offset",))), 0, generations=5)
    assert any("offset" in w for w in result.warnings)


def test_without_a_torque_constant_the_fit_is_in_amperes() -> None:
    torque = synthetic("a")
    channels = {
        ("current" if name == "torque" else name): values
        for name, values in torque.channels.items()
    }
    result = fit(Dataset((dataclasses.replace(torque, channels=channels),)), 0, generations=300)
    assert result.fit.unit == "A"
    assert result.stages[0].cost_unit == "A"
    assert {n: p.unit for n, p in result.parameters.items()} == {
        "Mc": "A",
        "Ms": "A",
        "omega_sf": "rad/s",
        "sigma_2": "A s/rad",
        "J": "A s^2/rad",
    }


def test_loaded_recordings_alone_are_refused() -> None:
    with pytest.raises(RecordingError, match="unloaded"):
        fit(Dataset((synthetic("b", "loaded"),)), 0)


def test_a_load_of_nothing_is_refused() -> None:
    empty = dataclasses.replace(synthetic("b", "loaded"), weight_mass=0.0)
    with pytest.raises(RecordingError, match="weight_mass"):
        fit(Dataset((synthetic("a"), empty)), 0, generations=5)
