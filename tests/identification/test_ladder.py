"""Load-dependent friction recovered from data that have it, and the ladder's scores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.ladder import climb
from identification.estimate.paper_method import identify_paper
from identification.model.parameters import LADDER
from identification.recording import Dataset, Model, Pendulum, Recording, RecordingError

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
        r.friction: r
        for r in climb(dataset(), bandwidth_Hz=100.0, rng=np.random.default_rng(0), replicates=8)
    }
    best = rungs["stribeck_load_dependent"]
    assert best.best == 1.0
    assert best.scored.value == pytest.approx(0.05, rel=0.2)
    assert best.scored.low <= best.scored.value <= best.scored.high
    assert sum(r.best for r in rungs.values()) == pytest.approx(1.0)
    assert best.angle is None
    assert all(
        r.scored is not None and r.scored.value > 5.0 * best.scored.value
        for n, r in rungs.items()
        if r is not best
    )


def test_rungs_that_bear_a_load_need_one() -> None:
    plain = Dataset((sine(rate=200.0),))
    rungs = climb(plain, bandwidth_Hz=100.0, rng=np.random.default_rng(0), replicates=2)
    assert [r.friction for r in rungs] == ["coulomb_viscous", "stribeck"]
    with pytest.raises(RecordingError, match="declare the pendulum under `gravity`"):
        identify(replace(plain, model=Model(friction="load_dependent")), bandwidth_Hz=100.0)
    with pytest.raises(RecordingError, match="remove all loaded recordings"):
        climb(Dataset((sine(), sine(weight=30.6))), bandwidth_Hz=None, rng=np.random.default_rng(0))
    with pytest.raises(RecordingError, match="supports only the friction model stribeck"):
        identify_paper(dataset(), bandwidth_Hz=100.0, rng=np.random.default_rng(0))
