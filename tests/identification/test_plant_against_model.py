"""The one test where the simulated machine and the fitted model meet: they agree on the nominal
case.

And, with more room, on what the gas generator may hide.
"""

from dataclasses import replace

import numpy as np
import pytest

from drivers.mock.plant.gas import burn, throat_area
from drivers.mock.plant.machine import friction_vector
from drivers.mock.plant.parts.constants import Joint, Machine
from drivers.mock.plant.parts.friction import friction
from identification.model import gas_generator as kernel
from identification.model.friction import load_coefficient, system_friction
from identification.model.gas_generator import GasGenerator, constants, throat_derivatives
from identification.model.gas_generator import throat_area as believed_throat

from .synthetic import TRUTH, pressure_history


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


TIME = np.arange(0.0, 8.0, 0.005)
SWING = np.radians(15.0 - 13.0 * np.cos(2.0 * np.pi * 0.4 * TIME))


@pytest.mark.parametrize("equation", [7, 8])
def test_a_burn_under_a_swinging_valve(equation: int) -> None:
    g = GasGenerator()
    plant = Machine()
    plant = replace(plant, gas=replace(plant.gas, energy_J_kg=g.RT, equation=equation))
    true = burn(plant, SWING, 0.005, steps=20)
    pressure, web, _ = pressure_history(TIME, SWING, g, exact=equation == 7)
    assert pressure == pytest.approx(true.pressure_Pa, rel=2e-4)
    assert g.V_0 + g.A_b * web == pytest.approx(true.free_volume_m3, rel=1e-5)
    assert believed_throat(SWING) == pytest.approx(throat_area(plant, SWING), rel=1e-10)


@pytest.mark.parametrize(
    ("name", "sizes", "within"),
    [
        ("throat_deposition", {"rate_m_s": (kernel.LAYER_RATE, 3e-5)}, 2e-4),
        ("burning_area_change", {"taper_per_m": (kernel.TAPER, -0.4)}, 2e-4),
        ("erosive_burning", {"coefficient_s_m": (kernel.EROSION, 0.03)}, 4e-4),
        (
            "heat_loss",
            {"heat_flow_W": (kernel.HEAT_FLOW, 1e5), "time_s": (kernel.HEAT_TIME, 5.0)},
            2e-3,
        ),
        ("leakage", {"area_m2": (kernel.LEAK, 2e-5)}, 2e-4),
    ],
)
def test_what_the_gas_generator_hides(name, sizes, within):
    g = GasGenerator()
    plant = Machine(effects={name: {key: size for key, (_, size) in sizes.items()}})
    true = burn(replace(plant, gas=replace(plant.gas, energy_J_kg=g.RT)), SWING, 0.005, steps=20)
    missing = np.zeros(kernel.MISSING_SIZE)
    for slot, size in sizes.values():
        missing[slot] = size
    out = np.empty((3, len(TIME)))
    start = constants(g, {}, float(true.pressure_Pa[0]), g.V_0)
    kernel.march(TIME, throat_derivatives(SWING, g.valve), start, missing, out)
    assert out[0] == pytest.approx(true.pressure_Pa, rel=within)
    plain = burn(
        replace(plant, gas=replace(plant.gas, energy_J_kg=g.RT), effects={}), SWING, 0.005, steps=20
    )
    assert np.max(np.abs(plain.pressure_Pa / true.pressure_Pa - 1.0)) > 10.0 * within
