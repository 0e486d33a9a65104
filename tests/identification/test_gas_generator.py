"""The gas generator of the model: equilibria, closed forms of eq. 8, and an independent
integrator.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from identification.model.gas_generator import (
    GasGenerator,
    ValveGeometry,
    equilibrium_pressure,
    throat_area,
    throat_derivatives,
)

from .synthetic import pressure_history

PAPER = GasGenerator()
TIME = np.arange(0.0, 6.0, 0.005)
SWEEP = np.radians(15.0 - 12.0 * np.cos(2.0 * np.pi * 0.4 * TIME))


def test_equilibria_are_those_of_the_specification() -> None:
    least, full = (float(throat_area(np.array(angle))) for angle in (0.0, math.radians(30.0)))
    assert float(equilibrium_pressure(least, PAPER, exact=False)) == pytest.approx(4.43e6, rel=1e-3)
    assert float(equilibrium_pressure(least, PAPER)) == pytest.approx(4.37e6, rel=1e-3)
    assert float(equilibrium_pressure(full, PAPER)) == pytest.approx(0.60e6, rel=5e-3)
    assert float(equilibrium_pressure(1.01 * least, PAPER, exact=False)) == pytest.approx(
        4.4294e6 * 1.01 ** (-1.0 / 0.47), rel=1e-4
    )


@pytest.mark.parametrize("seed", range(2))
def test_at_equilibrium_the_balance_of_eq_7_closes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    g = GasGenerator(
        a=rng.uniform(3e-3, 9e-3), n=rng.uniform(0.2, 0.8), C_r=rng.uniform(700.0, 1400.0)
    )
    throat = rng.uniform(4e-4, 1.3e-3, 7)
    p = equilibrium_pressure(throat, g)
    r = g.a * (p / 1e6) ** g.n
    assert (g.rho_b - p / g.RT) * g.A_b * r == pytest.approx(p * throat / g.C_r, rel=1e-12)
    p = equilibrium_pressure(throat, g, exact=False)
    r = g.a * (p / 1e6) ** g.n
    assert g.rho_b * g.A_b * r == pytest.approx(p * throat / g.C_r, rel=1e-12)


@pytest.mark.parametrize("exact", [True, False])
def test_a_sweep_is_that_of_an_integrator_with_error_control(exact: bool) -> None:
    g = PAPER
    pressure, web, _ = pressure_history(TIME, SWEEP, g, exact=exact)
    throat = throat_area(SWEEP)

    def slope(t: float, y: np.ndarray) -> list[float]:
        p, volume = y
        r = g.a * (p / 1e6) ** g.n
        density = g.rho_b - (p / g.RT if exact else 0.0)
        return [
            g.RT / volume * (density * g.A_b * r - p * np.interp(t, TIME, throat) / g.C_r),
            g.A_b * r,
        ]

    found = solve_ivp(
        slope,
        (0.0, 2.0),
        [pressure[0], g.V_0],
        "LSODA",
        TIME[TIME <= 2.0],
        rtol=1e-10,
        atol=1e-9,
        max_step=0.005,
    )
    assert pressure[: found.y.shape[1]] == pytest.approx(found.y[0], rel=1e-6)
    assert g.V_0 + g.A_b * web[: found.y.shape[1]] == pytest.approx(found.y[1], rel=1e-7)


def test_a_layer_makes_both_diameters_smaller() -> None:
    h = 3e-4
    bare, first, second = throat_derivatives(SWEEP, ValveGeometry())
    layered = throat_area(SWEEP, ValveGeometry(d=0.025 - 2 * h, D=0.040 - 2 * h))
    assert bare + h * (first + 0.5 * h * second) == pytest.approx(layered, rel=5e-4)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"n": 1.0}, "no stable equilibrium"),
        ({"a": -1.0}, "a = -1"),
        ({"gamma": 0.9}, "must be above 1"),
    ],
)
def test_a_generator_that_cannot_be(wrong: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        GasGenerator(**wrong)
