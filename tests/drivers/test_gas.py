"""The gas generator: its books balance, its equilibria are those on paper, and it loads the valve
it feeds.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from drivers.mock.plant.gas import burn, impacted_area, steady_pressure, throat_area
from drivers.mock.plant.machine import SimulatedMachine, simulate
from drivers.mock.plant.parts.constants import GasGenerator, Machine
from drivers.mock.without_bus import record

Array = NDArray[np.float64]

RHO_B, A_B, N = 1630.0, 0.25 * math.pi * 0.35**2, 0.53
A = 6.3e-3 * 1e-6**N
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


def test_a_machine_that_hides_nothing_burns_as_the_nominal_one() -> None:
    command = swing(2.0, 1e-3)
    plain = record(hot_rig(), command)
    hiding = record(hot_rig({"asymmetric_coulomb": {"torque_Nm": 0.0}}), command)
    for channel, other in zip(plain, hiding, strict=True):
        np.testing.assert_array_equal(channel, other)


def test_exact_channels_hold_pressure_and_contact_force() -> None:
    sweep = simulate(Machine(), lambda t: np.deg2rad(20.0) * t, 1.0, 1e3, burning=True)
    force = (sweep["pressure"] - P_C0) * impacted_area(Machine(), sweep["angle"])
    assert sweep["contact_force"][0] == pytest.approx(2964.5, abs=0.5)
    np.testing.assert_allclose(sweep["contact_force"], force, atol=1.0)
    held = simulate(Machine(), np.zeros_like, 0.01, 1e3, weight_kg=1.0)
    np.testing.assert_allclose(held["contact_force"], 98.0665)
    np.testing.assert_array_equal(held["pressure"], P_C0)
