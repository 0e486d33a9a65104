"""Load-dependent friction recovered, the ladder, and a model carried over."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.equation_error import command_period, noise_floor
from identification.estimate.ladder import climb, moved, transfer
from identification.estimate.paper_method import identify_paper
from identification.model.parameters import LADDER
from identification.prepare import prepare
from identification.recording import Array, Dataset, Model, Pendulum, Recording, RecordingError
from identification.result import Parameter

from .synthetic import TRUTH, sine

GEAR = {**TRUTH, "mu_gc": 0.12, "mu_gs": 0.3}


def loaded_gear(mass: float, role: str = "fit", seed: int = 0, duration: float = 5.0) -> Recording:
    """A swinging weight of some N m with friction that grows with its torque, written out from eq.
    13.
    """
    pendulum = Pendulum(mass, 0.5, 0.1)
    made = sine(pendulum=pendulum, role=role, amplitude=0.9, duration=duration, rate=200.0)
    made = replace(made, name=f"{mass:g} kg {seed}")
    angle, velocity = made.channels["angle"], made.channels["velocity"]
    load = np.abs(mass * 9.80665 * 0.5 * np.sin(angle - 0.1))
    falling = np.exp(-((velocity / TRUTH["omega_sf"]) ** 2))
    extra = np.sign(velocity) * load * (GEAR["mu_gc"] + (GEAR["mu_gs"] - GEAR["mu_gc"]) * falling)
    noise = 0.05 * np.random.default_rng(seed).standard_normal(len(velocity))
    return replace(
        made, channels={**made.channels, "torque": made.channels["torque"] + extra + noise}
    )


def dataset(friction: str = "stribeck_load_dependent") -> Dataset:
    heavy = [loaded_gear(12.0, seed=k) for k in range(3)]
    light = [loaded_gear(6.0, "validate", seed=k) for k in range(3)]
    return Dataset((*heavy, *light), Model(friction=friction))


def test_friction_that_grows_with_a_pendulums_torque_is_recovered() -> None:
    found = identify(dataset(), bandwidth_Hz=100.0)
    for name in ("Mc", "Ms", "omega_sf", "sigma_2", "mu_gc", "mu_gs"):
        parameter = found.parameters[name]
        assert parameter.value == pytest.approx(GEAR[name], rel=0.05), name
        assert parameter.high is not None
        assert parameter.low < parameter.high
    assert found.fit.train_rms == pytest.approx(0.05, rel=0.2)
    assert found.friction == "stribeck_load_dependent"


@pytest.mark.parametrize(("friction", "terms"), LADDER.items())
def test_each_rung_has_its_terms_and_no_others(friction: str, terms: tuple[str, ...]) -> None:
    found = identify(dataset(friction), bandwidth_Hz=100.0)
    assert set(found.fitted) == {*terms, "J", *(["omega_sf"] if "Ms" in terms else [])}
    assert set(found.parameters) == set(found.fitted)


def test_the_ladder_ranks_the_rung_that_made_the_data_first_on_another_mass() -> None:
    rungs = {
        r.friction: r for r in climb(dataset(), bandwidth_Hz=100.0, rng=np.random.default_rng(0))
    }
    best = rungs.pop("stribeck_load_dependent")
    assert best.angle is None
    least = best.result.fit.validate_rms
    assert least == pytest.approx(0.05, rel=0.2)
    assert all(r.result.fit.validate_rms > 5.0 * least for r in rungs.values())


def test_rungs_that_bear_a_load_need_one() -> None:
    plain = Dataset((sine(rate=200.0),))
    rungs = climb(plain, bandwidth_Hz=100.0, rng=np.random.default_rng(0))
    assert [r.friction for r in rungs] == ["coulomb_viscous", "stribeck"]
    with pytest.raises(RecordingError, match="declare the pendulum under `gravity`"):
        identify(replace(plain, model=Model(friction="load_dependent")), bandwidth_Hz=100.0)
    with pytest.raises(RecordingError, match="remove all loaded recordings"):
        climb(Dataset((sine(), sine(weight=30.6))), bandwidth_Hz=None, rng=np.random.default_rng(0))
    with pytest.raises(RecordingError, match="supports only the friction model stribeck"):
        identify_paper(dataset(), bandwidth_Hz=100.0, rng=np.random.default_rng(0))


NOISE_NM = 0.2
RATE = 200.0


def noise(seed: int) -> Callable[[int], Array]:
    return lambda count: NOISE_NM * np.random.default_rng(seed).standard_normal(count)


def day(seed: int, duration: float = 20.0, **change: float) -> Recording:
    made = sine(
        {**TRUTH, **change}, name=f"day {seed}", rate=RATE, duration=duration, noise=noise(seed)
    )
    return replace(
        made, channels={**made.channels, "command": made.channels["angle"]}, sha256=f"{seed}"
    )


def test_only_the_parameter_that_changed_has_moved() -> None:
    first, second = Dataset((day(1),)), Dataset((day(2, Mc=8.0, Ms=13.2),))
    found = transfer(identify(first, bandwidth_Hz=100.0), first, second)
    said = {m.name: m.moved for m in found.parameters}
    assert said["Mc"]
    assert said["Ms"]
    assert not said["sigma_2"]
    assert not said["omega_sf"]
    assert found.fit.train_rms == pytest.approx(8.0 - 6.825, rel=0.1)
    assert found.own.train_rms == pytest.approx(NOISE_NM, rel=0.1)


@pytest.mark.parametrize("missing", [{}, {"Mc": 4.0, "sigma_2": 20.0}])
def test_the_floor_is_the_noise_whatever_the_model(missing: dict[str, float]) -> None:
    p = prepare(day(3), 100.0)
    floor = noise_floor([p], {**TRUTH, **missing}, 2.0)
    assert floor.rms == pytest.approx(NOISE_NM, rel=0.05)
    assert (floor.periods, floor.repeats) == (1, 0)


@pytest.mark.parametrize("ramp_s", [0.0, 1.0])
def test_the_period_of_a_command_is_found_through_its_ramps(ramp_s: float) -> None:
    r = day(6)
    envelope = np.clip(np.minimum(r.time, 20.0 - r.time) / max(ramp_s, 1e-9), 0.0, 1.0)
    shaped = replace(r, channels={**r.channels, "command": envelope * r.channels["command"]})
    assert command_period(shaped) == pytest.approx(5.0, abs=0.006)
    line = replace(r, channels={**r.channels, "command": r.time})
    assert command_period(line) is None


def test_intervals_decide_and_what_is_unknown_has_not_moved() -> None:
    first = Parameter("Mc", "N m", 1.0, 0.9, 1.1)
    assert moved(first, Parameter("Mc", "N m", 1.13, 1.03, 1.23)).moved is False
    assert moved(first, Parameter("Mc", "N m", 1.15, 1.05, 1.25)).moved is True
    assert moved(first, Parameter("Mc", "N m", None, identifiable=False)).moved is None


def test_what_was_fitted_is_no_test() -> None:
    data = Dataset((day(7),))
    fitted = identify(data, bandwidth_Hz=100.0)
    with pytest.raises(RecordingError, match="was fitted to this recording"):
        transfer(fitted, data, data)
    with pytest.raises(RecordingError, match="unloaded recordings only"):
        transfer(fitted, data, Dataset((sine(weight=30.6),)))
