"""The torque of a commanded motion, held against numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from identification.model.compensation import RISE_SHARE, damping, feedforward, motion, steepest_fall
from identification.model.nominal import NOMINAL

PERIOD = 1e-3
MOMENT = 285.0


def ramp(speed: float, n: int = 2000) -> np.ndarray:
    """Rest, then a constant speed."""
    return np.concatenate([np.zeros(10), speed * PERIOD * np.arange(1, n)])


@pytest.mark.parametrize("moment", [0.0, MOMENT])
@pytest.mark.parametrize("speed", [0.3, -0.3, 0.02])
def test_at_constant_speed_it_is_the_friction_of_eq_9_and_13(speed: float, moment: float) -> None:
    """All of it unloaded; under 3000 N, where friction falls faster than damping can be added, less of the rise."""
    p, v = NOMINAL, abs(speed)
    rise = RISE_SHARE if moment else 1.0
    system = p["Mc"] + rise * (p["Ms"] - p["Mc"]) * math.exp(-((v / p["omega_sf"]) ** 2)) + p["sigma_2"] * v
    load = p["mu_c"] + rise * (p["mu_s"] - p["mu_c"]) * math.exp(-((v / p["omega_sL"]) ** 2)) + p["mu_2"] * v
    torque = feedforward(ramp(speed), PERIOD, p, 2.0, moment)
    assert torque[1000] == pytest.approx(math.copysign(system + moment * load, speed), rel=1e-12)


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


def test_the_steepest_fall_of_the_stribeck_curve() -> None:
    """d/dv of dM exp(-(v/w)^2) is greatest at v = w/sqrt(2): sqrt(2/e) dM/w, less what is viscous."""
    p = NOMINAL
    fall = math.sqrt(2.0 / math.e) * (p["Ms"] - p["Mc"]) / p["omega_sf"] - p["sigma_2"]
    assert steepest_fall(p, 2.0, 0.0) == pytest.approx(fall, rel=1e-3)
    assert steepest_fall({**p, "Ms": p["Mc"]}, 2.0, 0.0) == 0.0
    # The two shares fall fastest at different speeds, so together by less than the sum.
    load = MOMENT * (math.sqrt(2.0 / math.e) * (p["mu_s"] - p["mu_c"]) / p["omega_sL"] - p["mu_2"])
    assert 0.85 * (fall + load) < steepest_fall(p, 2.0, MOMENT) < fall + load


def test_damping_is_what_friction_takes_as_far_as_the_delay_allows() -> None:
    gentle = {**NOMINAL, "Ms": 8.0}
    assert damping(gentle, 2.0, 0.0, PERIOD) == pytest.approx(1.25 * steepest_fall(gentle, 2.0, 0.0))
    allowed = math.pi / 4 * 0.204 / (2 * PERIOD)
    assert damping(NOMINAL, 2.0, 0.0, PERIOD) == pytest.approx(allowed)
    assert damping(NOMINAL, 2.0, MOMENT, PERIOD) == pytest.approx(allowed)
    assert damping(NOMINAL, 2.0, 0.0, 4 * PERIOD) == pytest.approx(allowed / 4)
    assert damping({**NOMINAL, "Ms": NOMINAL["Mc"]}, 2.0, 0.0, PERIOD) == 0.0


@pytest.mark.parametrize(("share", "settles"), [(1.0, True), (2.2, False)])
def test_an_inertia_with_that_damping_and_delay_settles(share: float, settles: bool) -> None:
    """Speed measured over a cycle, sent with the next SYNC, held for a cycle: more than twice as much oscillates."""
    d = share * damping(NOMINAL, 2.0, MOMENT, PERIOD)
    fine = 20
    theta = np.zeros(600 * fine + 1)
    omega, torque, staged = 0.01, 0.0, 0.0
    for k in range(600 * fine):
        if k % fine == 0:
            torque = staged
            measured = (theta[k] - theta[max(k - fine, 0)]) / PERIOD
            staged = -d * measured
        omega += torque / NOMINAL["J"] * PERIOD / fine
        theta[k + 1] = theta[k] + omega * PERIOD / fine
    assert bool(abs(omega) < 1e-6) is settles
