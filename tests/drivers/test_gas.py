"""The gas generator and its valve: books, equilibria, areas, and what it can hide."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from drivers.mock.plant.effects.pack import GAS_KNOWN, KNOWN, effect_vector, problems
from drivers.mock.plant.gas import (
    HEAT_RATIO,
    Burn,
    burn,
    impacted_area,
    steady_pressure,
    throat_area,
)
from drivers.mock.plant.machine import SimulatedMachine, simulate
from drivers.mock.plant.parts.constants import GasGenerator, Machine

Array = NDArray[np.float64]

RHO_B, A_B, N = 1630.0, 0.25 * math.pi * 0.35**2, 0.53
A_BURN = 6.3e-3
A = A_BURN * 1e-6**N
C_R, RT, V_0, P_C0 = 1000.0, 432964.0, 0.01, 0.5e6


def machine(equation: Literal[7, 8] = 7, free_volume_m3: float = V_0) -> Machine:
    return replace(Machine(), gas=GasGenerator(equation=equation, free_volume_m3=free_volume_m3))


def swing(seconds: float, period: float) -> Array:
    """Return valve angles from the closed to the open valve and back, twice, rad."""
    return np.asarray(
        np.deg2rad(15.0 - 15.0 * np.cos(4.0 * np.pi * np.arange(0.0, seconds, period) / seconds))
    )


@pytest.mark.parametrize("period", [1e-3, 0.05])
def test_eq_7_burns_what_flows_out_and_what_is_stored(period: float) -> None:
    b = burn(machine(), swing(10.0, period), period)
    stored = b.pressure_Pa * b.free_volume_m3 / RT
    lost = b.burnt_kg - b.outflow_kg - (stored - stored[0])
    assert b.burnt_kg[-1] > 10.0
    assert np.max(np.abs(lost)) <= 1e-9 * b.burnt_kg[-1]
    np.testing.assert_allclose(
        b.burnt_kg, RHO_B * (b.free_volume_m3 - V_0), atol=1e-9 * b.burnt_kg[-1]
    )


@pytest.mark.parametrize("degrees", [0.0, 10.0, 30.0])
def test_equilibria_are_those_on_paper(degrees: float) -> None:
    angle = np.full(20_000, np.deg2rad(degrees))
    throat = float(throat_area(Machine(), angle[:1])[0])
    simple = (RHO_B * A_B * A * C_R / throat) ** (1.0 / (1.0 - N))
    exact = float(
        brentq(lambda p: (RHO_B - p / RT) * A_B * A * p**N - p * throat / C_R, 1e4, 1e8, xtol=1e-3)
    )
    for equation, wanted in ((8, simple), (7, exact)):
        rig = machine(equation)
        assert steady_pressure(rig, angle[:1])[0] == pytest.approx(wanted, rel=1e-9)
        settled = burn(rig, angle, 1e-3, pressure_Pa=1.3 * wanted).pressure_Pa
        assert settled[-1] == pytest.approx(wanted, rel=1e-6)
    assert simple / exact == pytest.approx(
        (1.0 - exact / RT / RHO_B) ** (-1.0 / (1.0 - N)), rel=1e-9
    )
    if degrees == 0.0:
        assert simple == pytest.approx(4.43e6, abs=5e3)
        assert exact == pytest.approx(4.37e6, abs=5e3)
        assert simple / exact - 1.0 == pytest.approx(0.013, abs=5e-4)


@pytest.mark.parametrize("equation", [7, 8])
def test_a_sweep_follows_the_printed_equation(equation: Literal[7, 8]) -> None:
    """Against eq. 7 and 8 as printed, in pressure, by an integrator of another kind."""
    rig, period = machine(equation), 1e-3
    angle = np.deg2rad(50.0) * np.arange(0.0, 0.6, period)
    fine = np.linspace(angle[0], angle[-1], 200_001)
    areas = throat_area(rig, fine)

    def rates(t: float, state: Array) -> list[float]:
        p, volume = state
        growth = A_B * A * p**N
        density = p / RT if equation == 7 else 0.0
        throat = np.interp(np.deg2rad(50.0) * t, fine, areas)
        return [RT / volume * ((RHO_B - density) * growth - p * throat / C_R), growth]

    start = float(steady_pressure(rig, angle[:1])[0])
    times = np.arange(len(angle)) * period
    wanted = solve_ivp(
        rates, (0.0, times[-1]), [start, V_0], "Radau", times, rtol=1e-9, atol=1e-9, max_step=2e-3
    ).y
    found = burn(rig, angle, period, steps=20)
    np.testing.assert_allclose(found.pressure_Pa, wanted[0], rtol=2e-6)
    np.testing.assert_allclose(found.free_volume_m3, wanted[1], rtol=1e-6)


@pytest.mark.parametrize("free_volume_m3", [1e-9, 1e-5])
def test_a_stiff_chamber_keeps_to_the_steady_pressure(free_volume_m3: float) -> None:
    """At 1e-9 m^3 the gas settles within 10 ns; a step of 1 ms must neither ring nor run away."""
    rig, angle = machine(7, free_volume_m3), np.full(50, np.deg2rad(12.0))
    wanted = float(steady_pressure(rig, angle[:1])[0])
    for start in (1e-3 * wanted, 100.0 * wanted):
        b = burn(rig, angle, 1e-3, pressure_Pa=start)
        assert np.all(b.pressure_Pa > 0.0)
        assert b.pressure_Pa[-1] == pytest.approx(wanted, rel=1e-6)
        assert (
            np.max(np.abs(b.burnt_kg - b.outflow_kg - b.stored_kg + b.stored_kg[0]))
            <= 1e-9 * b.burnt_kg[-1]
        )


def hot_rig(effects: dict[str, dict[str, float]] | None = None) -> SimulatedMachine:
    rig = SimulatedMachine(replace(Machine(), effects=effects or {}), np.random.default_rng(4))
    rig.ignite()
    rig.power(True)
    return rig


def test_pressure_and_area_load_the_valve() -> None:
    rig = hot_rig()
    assert rig.truth().contact_force_N == pytest.approx(3000.0, rel=0.02)
    for _ in range(6):
        rig.follow(rig.truth().angle_rad + np.deg2rad(50.0) * np.arange(1, 2001) / 20e3)
        truth = rig.truth()
        wanted = (truth.pressure_Pa - P_C0) * impacted_area(
            rig.constants, np.array([truth.angle_rad])
        )[0]
        assert truth.contact_force_N == pytest.approx(wanted, abs=2.0)
    assert truth.angle_rad > np.deg2rad(29.65)
    assert truth.contact_force_N == pytest.approx(0.0, abs=1e-9)


def test_exact_channels_hold_pressure_and_contact_force() -> None:
    sweep = simulate(Machine(), lambda t: np.deg2rad(20.0) * t, 1.0, 1e3, burning=True)
    force = (sweep["pressure"] - P_C0) * impacted_area(Machine(), sweep["angle"])
    assert sweep["contact_force"][0] == pytest.approx(2964.5, abs=0.5)
    np.testing.assert_allclose(sweep["contact_force"], force, atol=1.0)
    held = simulate(Machine(), np.zeros_like, 0.01, 1e3, weight_kg=1.0)
    np.testing.assert_allclose(held["contact_force"], 98.0665)
    np.testing.assert_array_equal(held["pressure"], P_C0)


NOMINAL = Machine()
HOLE, OPENING, WIDTH, ARM = 0.025, 0.040, 0.054, 0.095
ANGLES_DEG = (0.0, 4.3, 4.5, 12.0, 19.5, 19.8, 27.0, 29.6, 29.7)


def turned(points: Array, angle: float) -> Array:
    """Turn points, shape (n, 2), about the pivot, which is the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def circle(diameter: float, sides: int = 1500) -> Array:
    """Return a regular polygon of the circle's area, its centre at (L1, 0)."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    radius = 0.5 * diameter * np.sqrt(2.0 * np.pi / sides / np.sin(2.0 * np.pi / sides))
    return np.column_stack((ARM + radius * np.cos(turn), radius * np.sin(turn)))


def area(polygon: Array) -> float:
    """Return the area of a polygon given anticlockwise."""
    x, y = polygon[:, 0] - ARM, polygon[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) if len(polygon) else 0.0


def clipped(polygon: Array, by: Array) -> Array:
    """Return what a convex polygon leaves of another (Sutherland and Hodgman)."""
    for start, end in zip(by, np.roll(by, -1, axis=0), strict=True):
        if not len(polygon):
            break
        edge = end - start
        inside = edge[0] * (polygon[:, 1] - start[1]) - edge[1] * (polygon[:, 0] - start[0])
        if np.all(inside >= 0.0):
            continue
        following, after = np.roll(polygon, -1, axis=0), np.roll(inside, -1)
        crosses = (inside >= 0.0) != (after >= 0.0)
        share = inside / np.where(crosses, inside - after, 1.0)
        cut = polygon + share[:, None] * (following - polygon)
        both = np.stack((polygon, cut), axis=1)
        polygon = both[np.stack((inside >= 0.0, crosses), axis=1)]
    return polygon


def by_polygons(angle: float) -> float:
    """Return the impacted area of a plate cut from polygons and turned about its pivot, m^2."""
    opening = circle(OPENING)
    corners = np.array([(-0.03, -0.5), (0.15, -0.5), (0.15, 0.5), (-0.03, 0.5)]) * (1.0, WIDTH)
    plate = clipped(opening, turned(corners, angle))
    return area(plate) - area(clipped(opening, turned(circle(HOLE), angle)))


@pytest.mark.parametrize("degrees", ANGLES_DEG)
def test_areas_are_those_of_polygons(degrees: float) -> None:
    angle = np.deg2rad(degrees)
    assert impacted_area(NOMINAL, np.array([angle]))[0] == pytest.approx(
        by_polygons(float(angle)), abs=1e-9
    )


def test_the_closed_valve_leaves_its_hole_and_the_open_one_everything() -> None:
    angles = np.deg2rad([0.0, 29.64, 29.66, 30.0])
    covered = impacted_area(NOMINAL, angles)
    assert covered[0] == pytest.approx(7.66e-4, abs=5e-7)
    assert throat_area(NOMINAL, angles)[0] == pytest.approx(0.25 * np.pi * HOLE**2, rel=1e-12)
    assert covered[1] > 0.0
    assert covered[2] == covered[3] == 0.0


def test_both_areas_make_the_opening_and_the_throat_only_grows() -> None:
    angles = np.deg2rad(np.linspace(0.0, 30.0, 3001))
    throat, covered = throat_area(NOMINAL, angles), impacted_area(NOMINAL, angles)
    np.testing.assert_allclose(throat + covered, 0.25 * np.pi * OPENING**2, rtol=1e-15)
    assert np.all(np.diff(throat) >= 0.0)
    np.testing.assert_array_equal(throat_area(NOMINAL, -angles), throat)


Effects = Mapping[str, Mapping[str, float]]
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
    made = hiding({"leakage": {"area_m2": 3e-5}}, 1e-4)
    b = burn(made, STEADY, PERIOD)
    p, throat = b.pressure_Pa[1000], float(throat_area(made, STEADY[:1])[0]) + 3e-5
    balance = (RHO_B - p / RT) * A_B * A_BURN * (p / 1e6) ** N
    assert p * throat / C_R == pytest.approx(balance, rel=1e-4)
    assert p < 0.95 * steady_pressure(made, STEADY[:1])[0]


def test_a_tapered_grain_burns_over_the_square_of_its_diameter() -> None:
    b = burn(hiding({"burning_area_change": {"taper_per_m": 0.5}}), STEADY, PERIOD)
    web = np.concatenate(
        (
            [0.0],
            np.cumsum(
                A_BURN * (0.5 * (b.pressure_Pa[1:] + b.pressure_Pa[:-1]) / 1e6) ** N * PERIOD
            ),
        )
    )
    assert web[-1] > 0.03
    assert rate(b)[100:-100] == pytest.approx(
        (A_B * (1.0 + 0.5 * web) ** 2 * A_BURN * (b.pressure_Pa / 1e6) ** N)[100:-100], rel=1e-4
    )


def test_erosion_grows_with_the_speed_of_the_gas() -> None:
    b = burn(hiding({"erosive_burning": {"coefficient_s_m": 0.03}}), STEADY, PERIOD)
    speed = b.throat_m2 * RT / (C_R * A_B)
    expected = A_B * A_BURN * (b.pressure_Pa / 1e6) ** N * (1.0 + 0.03 * speed)
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
    made = hiding({"heat_loss": {"heat_flow_W": 2e5, "time_s": 0.5}}, 1e-4)
    b = burn(made, STEADY, PERIOD)
    temperature = b.pressure_Pa * b.free_volume_m3 / b.stored_kg / RT
    enthalpy = HEAT_RATIO / (HEAT_RATIO - 1.0) * RT
    flow = RHO_B * rate(b)
    assert temperature[20] == pytest.approx(
        1.0 - 2e5 * math.exp(-0.04) / (flow[20] * enthalpy), abs=0.01
    )
    assert temperature[20] < 0.96
    assert temperature[-1] == pytest.approx(1.0, abs=1e-3)


def test_gas_effects_leave_the_machine_its_nominal_kernel() -> None:
    made = hiding(STRONG)
    np.testing.assert_array_equal(effect_vector(made), effect_vector(Machine()))
    assert list(problems({"leakage": {"area_m2": 1.0}})) == [
        (("leakage", "area_m2"), "must be within 0 to 0.0002")
    ]
