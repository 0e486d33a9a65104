"""The friction law and eq. 14: right where motion is uniform, known to be wrong elsewhere."""

import numpy as np
import pytest

from identification.estimate.equation_error import (
    UniformPoint,
    errors_percent,
    fit_uniform,
    uniform_points,
)
from identification.model.friction import (
    expected_friction,
    friction,
    law,
    load_coefficient,
    system_friction,
)
from identification.model.parameters import ALPHA, NOMINAL, pack
from identification.numerics.compiled import compiled
from identification.recording import Bench, Recording

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
def test_scalar_and_broadcasting_laws_are_the_same(alpha, moment, gear):
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


PERIOD = 1e-3
BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)


def there_and_back(speed: float, jerky: bool = False) -> Recording:
    """A ramp of two seconds each way with the torque of eq."""
    leg = speed * PERIOD * np.arange(2000)
    command = np.concatenate(
        [np.zeros(300), leg, np.full(300, leg[-1]), leg[-1] - leg, np.zeros(300)]
    )
    angle = command.copy()
    if jerky:
        angle = np.floor(command / (0.2 * speed)) * 0.2 * speed
    velocity = np.gradient(command, PERIOD)
    current = system_friction(velocity, NOMINAL, 2.0) / 3.0
    time = PERIOD * np.arange(len(command))
    return Recording(time, angle, current, command=command, name=f"{speed:g}", bench=BENCH)


def test_each_constant_speed_is_a_point() -> None:
    points = uniform_points(there_and_back(0.05))
    assert [round(p.speed, 9) for p in points] == [0.05, -0.05]
    friction = float(system_friction(np.array([0.05]), NOMINAL, 2.0)[0])
    assert [p.friction for p in points] == pytest.approx([friction, friction])
    assert all(p.uniform for p in points)
    assert not any(p.uniform for p in uniform_points(there_and_back(0.05, jerky=True)))


def exact(speed: float, moment: float) -> UniformPoint:
    v = np.array([speed])
    friction = system_friction(v, NOMINAL, 2.0) + moment * load_coefficient(v, NOMINAL, 2.0)
    return UniformPoint("r", speed, float(friction[0]), 0.0, moment)


def test_exact_points_give_the_exact_curve() -> None:
    speeds = np.geomspace(0.01, 0.4, 9)
    found = fit_uniform([exact(float(v), moment) for v in speeds for moment in (0.0, 285.0)])
    truth = {name: NOMINAL[name] for name in found}
    assert set(found) == {"Mc", "Ms", "omega_sf", "sigma_2", "mu_c", "mu_s", "omega_sL", "mu_2"}
    assert errors_percent(found, truth) == pytest.approx(dict.fromkeys(found, 0.0), abs=1e-3)


def test_too_few_speeds_give_no_parameters() -> None:
    assert fit_uniform([exact(v, 0.0) for v in (0.1, 0.2, 0.3)]) == {}
    assert fit_uniform([exact(v, 0.0) for v in (0.1, 0.2, 0.3, 0.1, 0.2, 0.3)]) == {}
    points = [exact(v, 0.0) for v in (0.02, 0.05, 0.1, 0.2)] + [exact(0.1, 285.0)]
    assert set(fit_uniform(points)) == {"Mc", "Ms", "omega_sf", "sigma_2"}
