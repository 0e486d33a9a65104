"""The torque of a commanded motion against numbers worked out by hand; gains over a bus."""

import cmath
import math

import numpy as np
import pytest
from scipy.optimize import brentq

from identification.model.feedforward import (
    DELAY_CYCLES,
    RISE_SHARE,
    Gains,
    falls_until,
    feedforward,
    gains,
    motion,
    pulses,
)
from identification.model.parameters import NOMINAL

PERIOD = 1e-3
MOMENT = 285.0


def ramp(speed: float, n: int = 2000) -> np.ndarray:
    """Rest, then a constant speed."""
    return np.concatenate([np.zeros(10), speed * PERIOD * np.arange(1, n)])


@pytest.mark.parametrize("moment", [0.0, MOMENT])
@pytest.mark.parametrize("speed", [0.3, -0.3, 0.02])
def test_at_constant_speed_it_is_the_friction_of_eq_9_and_13(speed: float, moment: float) -> None:
    """All of it unloaded."""
    p, v = NOMINAL, abs(speed)
    rise = RISE_SHARE if moment else 1.0
    system = (
        p["Mc"]
        + rise * (p["Ms"] - p["Mc"]) * math.exp(-((v / p["omega_sf"]) ** 2))
        + p["sigma_2"] * v
    )
    load = (
        p["mu_c"]
        + rise * (p["mu_s"] - p["mu_c"]) * math.exp(-((v / p["omega_sL"]) ** 2))
        + p["mu_2"] * v
    )
    torque = feedforward(ramp(speed), PERIOD, p, 2.0, moment)
    assert np.mean(torque[1000:1003]) == pytest.approx(
        math.copysign(system + moment * load, speed), rel=1e-12
    )
    assert np.ptp(torque[1000:1003]) < 1e-9 or (moment and v < 0.1)


def test_a_motion_starts_with_the_static_friction() -> None:
    slow = feedforward(ramp(0.004), PERIOD, NOMINAL, 2.0, 0.0)
    first = int(np.flatnonzero(slow)[0])
    inertia = NOMINAL["J"] * 0.004 / (2 * PERIOD)
    assert slow[first - 1] == 0.0
    assert slow[first + 2] == pytest.approx(NOMINAL["Ms"], rel=0.02)
    assert first == 9  # the acceleration straddles the first moving cycle
    assert slow[first] == pytest.approx(inertia, rel=1e-9)


def test_acceleration_takes_inertia() -> None:
    t = PERIOD * np.arange(4000)
    smooth = {**NOMINAL, "Mc": 0.0, "Ms": 0.0, "sigma_2": 0.0}
    torque = feedforward(0.35 * np.sin(2 * np.pi * t), PERIOD, smooth, 2.0, 0.0)
    wanted = -0.204 * 0.35 * (2 * np.pi) ** 2 * np.sin(2 * np.pi * (t - 0.5 * PERIOD))
    np.testing.assert_allclose(torque[10:-10], wanted[10:-10], atol=2e-3)


def test_it_is_odd_and_nothing_at_rest() -> None:
    path = ramp(0.05)
    there, back = (feedforward(sign * path, PERIOD, NOMINAL, 2.0, MOMENT) for sign in (1.0, -1.0))
    np.testing.assert_array_equal(there, -back)
    assert not np.any(feedforward(np.full(50, 0.2), PERIOD, NOMINAL, 2.0, MOMENT))
    assert not np.any(motion(np.full(50, 0.2), PERIOD))


def test_where_the_falling_branch_ends() -> None:
    """At d/dv of dM exp(-(v/w)^2) + sigma_2 v = -D, beyond the steepest place v = w/sqrt(2)."""
    p = NOMINAL
    rise, w = p["Ms"] - p["Mc"], p["omega_sf"]
    v = falls_until(p, 2.0, 0.0, 40.0)
    assert v > w / math.sqrt(2.0)
    assert rise * 2.0 * v / w**2 * math.exp(-((v / w) ** 2)) - p["sigma_2"] == pytest.approx(
        40.0, rel=5e-3
    )
    steepest = math.sqrt(2.0 / math.e) * rise / w - p["sigma_2"]
    assert falls_until(p, 2.0, 0.0, 1.001 * steepest) == 0.0
    assert falls_until(p, 2.0, 0.0, 0.999 * steepest) == pytest.approx(w / math.sqrt(2.0), rel=0.05)
    assert falls_until(p, 2.0, MOMENT, 40.0) > v


def test_pulses_add_no_torque_in_the_mean_and_never_turn_it_round() -> None:
    for speed in (0.02, -0.02):
        path = ramp(speed)
        beats = pulses(path, PERIOD, NOMINAL, 2.0, MOMENT)
        torque = feedforward(path, PERIOD, NOMINAL, 2.0, MOMENT)
        assert np.sum(beats[1000:1300]) == pytest.approx(0.0, abs=1e-9)
        whole = np.sign(speed) * torque[1000:1300]
        static = NOMINAL["Ms"] + MOMENT * NOMINAL["mu_s"]
        kinetic = NOMINAL["Mc"] + MOMENT * NOMINAL["mu_c"]
        assert whole.max() > static
        assert 0.0 < whole.min() < kinetic


def test_no_pulses_where_damping_outweighs_the_fall_or_nothing_moves_or_faster() -> None:
    assert not np.any(pulses(ramp(0.02), PERIOD, NOMINAL, 2.0, 0.0))
    assert not np.any(pulses(np.full(50, 0.2), PERIOD, NOMINAL, 2.0, MOMENT))
    assert np.max(np.abs(pulses(ramp(0.3), PERIOD, NOMINAL, 2.0, MOMENT)[20:])) < 1e-6
    flat = {**NOMINAL, "Ms": NOMINAL["Mc"], "mu_s": NOMINAL["mu_c"]}
    assert not np.any(pulses(ramp(0.02), PERIOD, flat, 2.0, MOMENT))


def loop(found: Gains, inertia: float, period: float, omega: float) -> complex:
    """L(j omega) of the module's docstring."""
    s = 1j * omega
    return (
        (found.stiffness + found.damping * s)
        * cmath.exp(-DELAY_CYCLES * period * s)
        / (inertia * s * s)
    )


@pytest.mark.parametrize(
    ("inertia", "period"), [(0.204, 1e-3), (0.03, 1e-3), (2.0, 5e-4), (0.204, 4e-3)]
)
def test_thirty_five_degrees_and_five_decibels_are_left(inertia: float, period: float) -> None:
    found = gains(inertia, period)
    crossover = brentq(
        lambda w: abs(loop(found, inertia, period, w)) - 1.0,
        1e-2 / period,
        2.0 / period,
        xtol=1e-12,
    )
    margin = math.pi + cmath.phase(loop(found, inertia, period, crossover))
    assert math.degrees(margin) == pytest.approx(35.0, abs=1e-6)
    assert crossover * period == pytest.approx(math.pi / 8.0)
    turned = brentq(lambda w: loop(found, inertia, period, w).imag, crossover, 3.0 * crossover)
    assert -20.0 * math.log10(abs(loop(found, inertia, period, turned))) == pytest.approx(
        5.58, abs=0.01
    )
