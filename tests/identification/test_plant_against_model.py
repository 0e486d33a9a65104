"""The one test where the simulated machine and the fitted model meet: they agree on the nominal case."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.mock.plant.constants import Joint
from drivers.mock.plant.friction import friction
from drivers.mock.plant.machine import friction_vector
from identification.estimate import innovations
from identification.model.friction import load_coefficient, system_friction

from .synthetic import TRUTH


@pytest.mark.parametrize("alpha", [1.0, 1.7, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_friction_at_random_speeds_and_loads(seed: int, alpha: float) -> None:
    rng = np.random.default_rng(seed)
    joint = Joint(alpha=alpha)
    for force in (0.0, *rng.uniform(0.0, 5000.0, 5)):
        speeds = 10.0 ** rng.uniform(-6.0, 1.0, 50)
        plant = np.array([friction(v, friction_vector(joint, force))[0] for v in speeds])
        for side in (1.0, -1.0):
            believed = system_friction(side * speeds, TRUTH, alpha)
            believed = believed + force * 0.095 * load_coefficient(side * speeds, TRUTH, alpha)
            assert believed == pytest.approx(side * plant, rel=1e-12)


@pytest.mark.parametrize("force", [0.0, 3000.0])
def test_the_filters_compiled_friction_is_the_same(force: float) -> None:
    p = np.zeros(innovations.PARAMETERS)
    t = TRUTH
    p[[innovations.MC, innovations.DM, innovations.OMEGA_SF, innovations.SIGMA_2]] = (
        t["Mc"], t["Ms"] - t["Mc"], t["omega_sf"], t["sigma_2"],
    )  # fmt: skip
    p[[innovations.MU_C, innovations.DMU, innovations.OMEGA_SL, innovations.MU_2]] = (
        t["mu_c"], t["mu_s"] - t["mu_c"], t["omega_sL"], t["mu_2"],
    )  # fmt: skip
    for speed in np.geomspace(1e-5, 2.0, 40):
        value, slope = innovations._friction(speed, force * 0.095, 2.0, 0.0, p)
        assert (value, slope) == pytest.approx(friction(speed, friction_vector(Joint(), force)), rel=1e-12)
