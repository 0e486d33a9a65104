"""Eq. 14: right where motion is uniform, and known to be wrong where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from identification.estimate.equation_error import (
    UniformPoint,
    errors_percent,
    fit_uniform,
    uniform_points,
)
from identification.model.friction import load_coefficient, system_friction
from identification.model.parameters import NOMINAL
from identification.recording import Bench, Recording

PERIOD = 1e-3
BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)


def there_and_back(speed: float, jerky: bool = False) -> Recording:
    """A ramp of two seconds each way with the torque of eq. 9; jerky: the joint stands, and catches
    up in jumps.
    """
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
    return Recording(
        f"{speed:g}", {"time": time, "command": command, "angle": angle, "current": current}, BENCH
    )


def test_each_constant_speed_is_a_point() -> None:
    points = uniform_points(there_and_back(0.05))
    assert [round(p.speed, 9) for p in points] == [0.05, -0.05]
    friction = float(system_friction(np.array([0.05]), NOMINAL, 2.0)[0])
    assert [p.friction for p in points] == pytest.approx([friction, friction])
    assert all(p.uniform for p in points)
    assert not any(p.uniform for p in uniform_points(there_and_back(0.05, jerky=True)))


def test_a_sine_has_none() -> None:
    t = PERIOD * np.arange(5000)
    sine = 0.3 * np.sin(0.4 * np.pi * t)
    recording = Recording(
        "s", {"time": t, "command": sine, "angle": sine, "current": 0.0 * t}, BENCH
    )
    assert uniform_points(recording) == []


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
