"""The compiled friction law against the broadcasting one, and what its expectation adds."""

from __future__ import annotations

import numpy as np
import pytest

from identification.model.friction import (
    expected_friction,
    friction,
    law,
    load_coefficient,
    system_friction,
)
from identification.model.parameters import (
    ALPHA,
    INDEX,
    SIZE,
    STRIBECK_TERMS,
    UNITS_LINEAR,
    UNITS_ROTARY,
    pack,
    unpack,
)
from identification.numerics.compiled import compiled

from .synthetic import TRUTH

GEAR = {"mu_gc": 0.03, "mu_gs": 0.05}


@compiled
def expected(speed: float, variance: float, moment: float, p: np.ndarray) -> tuple[float, float]:
    return expected_friction(speed, variance, moment, law(p, p[ALPHA]))


@compiled
def sure(speed: float, moment: float, gear: float, p: np.ndarray) -> tuple[float, float]:
    return friction(speed, moment, gear, p)


@pytest.mark.parametrize("alpha", [0.7, 2.0])
@pytest.mark.parametrize("moment", [0.0, 40.0])
@pytest.mark.parametrize("gear", [0.0, 3.0])
def test_scalar_and_broadcasting_laws_are_the_same(
    alpha: float, moment: float, gear: float
) -> None:
    p = pack({**TRUTH, **GEAR}, alpha)
    speeds = np.geomspace(1e-6, 2.0, 40)
    bracket = {
        **TRUTH,
        "mu_c": GEAR["mu_gc"],
        "mu_s": GEAR["mu_gs"],
        "omega_sL": TRUTH["omega_sf"],
        "mu_2": 0.0,
    }
    expected = system_friction(speeds, TRUTH, alpha) + moment * load_coefficient(
        speeds, TRUTH, alpha
    )
    expected += gear * load_coefficient(speeds, bracket, alpha)
    assert [sure(w, moment, gear, p)[0] for w in speeds] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("alpha", [0.7, 2.0])
def test_slope_is_the_derivative(alpha: float) -> None:
    p = pack({**TRUTH, **GEAR}, alpha)
    for w in np.geomspace(1e-3, 1.0, 20):
        step = 1e-5 * w
        slope = (sure(w + step, 40.0, 3.0, p)[0] - sure(w - step, 40.0, 3.0, p)[0]) / (2.0 * step)
        assert sure(w, 40.0, 3.0, p)[1] == pytest.approx(slope, rel=1e-5, abs=1e-4)


@pytest.mark.parametrize("alpha", [0.7, 1.0, 2.0])
def test_at_rest_it_is_the_static_limit(alpha: float) -> None:
    value, slope = sure(0.0, 40.0, 0.0, pack(TRUTH, alpha))
    assert value == pytest.approx(TRUTH["Ms"] + 40.0 * TRUTH["mu_s"], rel=1e-12)
    assert np.isfinite(slope)


@pytest.mark.parametrize("alpha", [0.7, 2.0])
@pytest.mark.parametrize("moment", [0.0, 40.0])
def test_expectation_over_a_certain_speed_is_the_law(alpha: float, moment: float) -> None:
    p = pack(TRUTH, alpha)
    for w in np.geomspace(1e-6, 2.0, 40):
        assert expected(w, 0.0, moment, p) == pytest.approx(sure(w, moment, 0.0, p), rel=1e-12)


def test_an_absent_rise_needs_no_stribeck_speed() -> None:
    p = pack({"Mc": 2.0, "Ms": 2.0, "omega_sf": 0.0}, 2.0)
    assert sure(0.0, 0.0, 0.0, p) == (2.0, 0.0)
    assert expected(1e-7, 0.0, 0.0, p) == pytest.approx((2.0, 0.0))


def test_expectation_over_an_uncertain_speed_is_that_of_a_quadrature() -> None:
    p, speed, deviation = pack(TRUTH, 2.0), TRUTH["omega_sf"], 0.05 * TRUTH["omega_sf"]
    nodes, weights = np.polynomial.hermite_e.hermegauss(20)
    mean = sum(
        w * sure(speed + deviation * x, 0.0, 0.0, p)[0] for x, w in zip(nodes, weights, strict=True)
    )
    bend = mean / np.sum(weights) - sure(speed, 0.0, 0.0, p)[0]
    assert expected(speed, deviation**2, 0.0, p)[0] - sure(speed, 0.0, 0.0, p)[0] == pytest.approx(
        bend, rel=0.02
    )


def test_every_parameter_has_a_place_of_its_own_and_a_unit() -> None:
    assert len(set(INDEX.values())) == len(INDEX)
    assert max(INDEX.values()) < SIZE
    assert (
        {name for term in STRIBECK_TERMS for name in term} | set(INDEX)
        == set(UNITS_ROTARY)
        == set(UNITS_LINEAR)
    )
    assert unpack(pack(TRUTH, 2.0), tuple(TRUTH)) == pytest.approx(TRUTH)
