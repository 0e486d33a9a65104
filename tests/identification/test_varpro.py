"""Both stages by variable projection, on noise-free data with known parameters."""

from collections.abc import Mapping

import numpy as np
import pytest

from identification.estimate.default import solve_stages
from identification.prepare import prepare
from identification.recording import Model, Recording

from .synthetic import TRUTH, sine

EXACT_HZ = 500.0
WEIGHT_KG = 30.6


def estimate(model: Model, *recordings: Recording) -> dict[str, float]:
    prepared = [prepare(r, EXACT_HZ) for r in recordings]
    unloaded = [p for p in prepared if p.recording.stage == "unloaded"]
    loaded = [p for p in prepared if p.recording.stage == "loaded"]
    return solve_stages(unloaded, loaded, model, lambda _stage, _share: None)[0]


def random_truth(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    truth = {name: value * rng.uniform(0.6, 1.4) for name, value in TRUTH.items()}
    truth["Ms"] = truth["Mc"] * rng.uniform(1.2, 2.5)
    truth["mu_s"] = truth["mu_c"] * rng.uniform(1.2, 2.5)
    return truth


def assert_close(found: Mapping[str, float], truth: Mapping[str, float], rel: float) -> None:
    for name, value in truth.items():
        assert found[name] == pytest.approx(value, rel=rel), name


@pytest.mark.parametrize("seed", range(3))
def test_all_nine_come_back_on_noise_free_data(seed: int) -> None:
    truth = random_truth(seed)
    found = estimate(Model(), sine(truth), sine(truth, weight=WEIGHT_KG))
    assert_close(found, truth, 1e-6)


@pytest.mark.parametrize("alpha", [1.0, 1.5])
def test_other_stribeck_exponents(alpha: float) -> None:
    recordings = sine(alpha=alpha), sine(weight=WEIGHT_KG, alpha=alpha)
    assert_close(estimate(Model(alpha=alpha), *recordings), TRUTH, 1e-6)


@pytest.mark.parametrize("names", [("Ms",), ("omega_sf", "J"), ("mu_s", "omega_sL")], ids="+".join)
def test_the_others_come_back_where_the_fixed_ones_are_right(names: tuple[str, ...]) -> None:
    found = estimate(Model(fixed={n: TRUTH[n] for n in names}), sine(), sine(weight=WEIGHT_KG))
    assert_close(found, TRUTH, 1e-6)


@pytest.mark.parametrize("offset", [-0.8, 0.4])
def test_declared_offset_comes_back_with_its_sign(offset: float) -> None:
    found = estimate(
        Model(terms=("offset",)), sine(offset=offset), sine(offset=offset, weight=WEIGHT_KG)
    )
    assert_close(found, {**TRUTH, "offset": offset}, 1e-6)


def test_friction_that_falls_toward_rest_ends_on_the_bound() -> None:
    """Ms below Mc is outside the model: the rise stays at 0, exactly."""
    found = estimate(Model(), sine({**TRUTH, "Ms": 0.7 * TRUTH["Mc"]}))
    assert found["Ms"] == found["Mc"]


@pytest.mark.parametrize(
    "fixed",
    [{"Mc": 7.0, "Ms": 11.5}, {"omega_sL": 0.03, "mu_c": 0.05}],
    ids=lambda fixed: "+".join(fixed),
)
def test_fixed_parameters_are_held_at_their_value(fixed: dict[str, float]) -> None:
    found = estimate(Model(fixed=fixed), sine(), sine(weight=WEIGHT_KG))
    assert {name: found[name] for name in fixed} == pytest.approx(fixed, rel=1e-12)
