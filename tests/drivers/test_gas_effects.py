"""What the gas generator hides: the books still balance, and each effect settles where its formula
says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock.plant.effects.pack import GAS_KNOWN, KNOWN, effect_vector, problems
from drivers.mock.plant.gas import HEAT_RATIO, Burn, burn, steady_pressure, throat_area
from drivers.mock.plant.parts.constants import GasGenerator, Machine

Effects = Mapping[str, Mapping[str, float]]
RHO_B, A_B, A, N, C_R, RT = 1630.0, 0.25 * math.pi * 0.35**2, 6.3e-3, 0.53, 1000.0, 432964.0
STEADY = np.full(4001, 0.2)
PERIOD = 1e-3
STRONG: Effects = {
    "throat_deposition": {"rate_m_s": 5e-5},
    "burning_area_change": {"taper_per_m": 0.5},
    "erosive_burning": {"coefficient_s_m": 0.03},
    "heat_loss": {"heat_flow_W": 2e5, "time_s": 8.0},
    "leakage": {"area_m2": 3e-5},
    "x_propellant_bands": {"share": 0.05, "length_m": 0.02},
    "x_burning_wave": {"share": 0.05, "frequency_Hz": 3.0},
    "x_throat_wear": {"rate_m_s": 5e-5},
    "x_slag_puffs": {"share": 0.1, "period_s": 1.0, "length_s": 0.2},
}


def hiding(effects: Effects, free_volume_m3: float = 0.01) -> Machine:
    return Machine(gas=GasGenerator(free_volume_m3=free_volume_m3), effects=effects)


def rate(b: Burn) -> NDArray[np.float64]:
    """Burning rate times area over the propellant's density, m^3/s."""
    return np.asarray(np.gradient(b.free_volume_m3, PERIOD))


def test_every_effect_of_the_plant_is_tried_here() -> None:
    assert STRONG.keys() == GAS_KNOWN.keys()
    assert not GAS_KNOWN.keys() & KNOWN.keys()
    slots = [p.slot for parameters in GAS_KNOWN.values() for p in parameters.values()]
    assert sorted(slots) == sorted(set(slots))


@pytest.mark.parametrize("name", STRONG)
def test_the_books_balance_whatever_is_hidden(name: str) -> None:
    b = burn(hiding({name: STRONG[name]}), STEADY, PERIOD, steps=2)
    lost = b.burnt_kg - b.outflow_kg - (b.stored_kg - b.stored_kg[0])
    assert np.max(np.abs(lost)) <= 1e-9 * b.burnt_kg[-1]
    plain = burn(hiding({}), STEADY, PERIOD, steps=2)
    assert np.max(np.abs(b.pressure_Pa / plain.pressure_Pa - 1.0)) > 0.01


@pytest.mark.parametrize("name", STRONG)
def test_an_effect_of_no_size_changes_no_bit(name: str) -> None:
    sizes = {"share", "rate_m_s", "taper_per_m", "coefficient_s_m", "heat_flow_W", "area_m2"}
    none = {key: 0.0 if key in sizes else value for key, value in STRONG[name].items()}
    plain, hidden = burn(hiding({}), STEADY, PERIOD), burn(hiding({name: none}), STEADY, PERIOD)
    assert np.array_equal(plain.pressure_Pa, hidden.pressure_Pa)


def test_a_leak_is_more_throat() -> None:
    machine = hiding({"leakage": {"area_m2": 3e-5}}, 1e-4)
    b = burn(machine, STEADY, PERIOD)
    p, throat = b.pressure_Pa[1000], float(throat_area(machine, STEADY[:1])[0]) + 3e-5
    balance = (RHO_B - p / RT) * A_B * A * (p / 1e6) ** N
    assert p * throat / C_R == pytest.approx(balance, rel=1e-4)
    assert p < 0.95 * steady_pressure(machine, STEADY[:1])[0]


def test_a_tapered_grain_burns_over_the_square_of_its_diameter() -> None:
    b = burn(hiding({"burning_area_change": {"taper_per_m": 0.5}}), STEADY, PERIOD)
    web = np.concatenate(
        ([0.0], np.cumsum(A * (0.5 * (b.pressure_Pa[1:] + b.pressure_Pa[:-1]) / 1e6) ** N * PERIOD))
    )
    assert web[-1] > 0.03
    assert rate(b)[100:-100] == pytest.approx(
        (A_B * (1.0 + 0.5 * web) ** 2 * A * (b.pressure_Pa / 1e6) ** N)[100:-100], rel=1e-4
    )


def test_erosion_grows_with_the_speed_of_the_gas() -> None:
    b = burn(hiding({"erosive_burning": {"coefficient_s_m": 0.03}}), STEADY, PERIOD)
    speed = b.throat_m2 * RT / (C_R * A_B)
    expected = A_B * A * (b.pressure_Pa / 1e6) ** N * (1.0 + 0.03 * speed)
    assert rate(b)[100:-100] == pytest.approx(expected[100:-100], rel=1e-4)


def test_a_layer_narrows_hole_and_opening() -> None:
    b = burn(hiding({"throat_deposition": {"rate_m_s": 5e-5}}), STEADY, PERIOD)
    thick = 5e-5 * 4.0
    narrow = Machine()
    valve = replace(
        narrow.gas.valve,
        hole_diameter_m=narrow.gas.valve.hole_diameter_m - 2.0 * thick,
        opening_diameter_m=narrow.gas.valve.opening_diameter_m - 2.0 * thick,
    )
    narrow = replace(narrow, gas=replace(narrow.gas, valve=valve))
    assert b.throat_m2[-1] == pytest.approx(throat_area(narrow, STEADY[:1])[0], rel=1e-9)


def test_cold_walls_take_heat_until_they_are_warm() -> None:
    machine = hiding({"heat_loss": {"heat_flow_W": 2e5, "time_s": 0.5}}, 1e-4)
    b = burn(machine, STEADY, PERIOD)
    temperature = b.pressure_Pa * b.free_volume_m3 / b.stored_kg / RT
    enthalpy = HEAT_RATIO / (HEAT_RATIO - 1.0) * RT
    flow = RHO_B * rate(b)
    assert temperature[20] == pytest.approx(
        1.0 - 2e5 * math.exp(-0.04) / (flow[20] * enthalpy), abs=0.01
    )
    assert temperature[20] < 0.96
    assert temperature[-1] == pytest.approx(1.0, abs=1e-3)


def test_gas_effects_leave_the_machine_its_nominal_kernel() -> None:
    machine = hiding(STRONG)
    np.testing.assert_array_equal(effect_vector(machine), effect_vector(Machine()))
    assert list(problems({"leakage": {"area_m2": 1.0}})) == [
        (("leakage", "area_m2"), "must be within 0 to 0.0002")
    ]
