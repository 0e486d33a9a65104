"""Short ramps under a heavy weight: beside the true values a filter sticks and slips, and small
steps lead nowhere.
"""

import math

import numpy as np
import pytest

from identification.design.simulated import PlannedModel, PlannedStage, Sensors, recorded
from identification.estimate import searches
from identification.estimate.searches import breakaway_starts
from identification.filter.likelihood import Point
from identification.filter.segments import Noise, motion
from identification.model.parameters import INDEX, LOAD_RISE, MU_C, OMEGA_SL, pack
from identification.recording import Array, Model

from .synthetic import BENCH

PERIOD, NOISE, WEIGHT = 1e-3, 0.075, 40.0
TRUTH = {
    "Mc": 5.25, "Ms": 13.32, "omega_sf": 0.0513, "sigma_2": 5.92, "J": 0.2433,
    "mu_c": 0.0339, "mu_s": 0.0939, "omega_sL": 0.0415, "mu_2": 0.0282,
}  # fmt: skip
STUCK = 4
"""A noise with which every search over small steps is stuck; on the whole bench it is most of
them.
"""
LOAD = ("mu_c", "mu_s", "omega_sL", "mu_2")


def ramps(travel_deg: float, speed_deg_s: float, times: int) -> Array:
    away = travel_deg / speed_deg_s
    time = PERIOD * np.arange(round(2.0 * away * times / PERIOD)) % (2.0 * away)
    return np.asarray(math.radians(speed_deg_s) * np.minimum(time, 2.0 * away - time))


def sine(amplitude_deg: float, frequency: float, seconds: float) -> Array:
    time = PERIOD * np.arange(round(seconds / PERIOD))
    fade = np.minimum(1.0, np.minimum(time, seconds - time) / 0.6)
    return np.asarray(math.radians(amplitude_deg) * fade * np.sin(2.0 * math.pi * frequency * time))


def searched(seed: int) -> tuple[float, float, float]:
    """Search from what an equation error left; return the errors of mu_c, mu_s and omega_sL."""
    nominal = PlannedModel(TRUTH, BENCH, Sensors(PERIOD, 2.0 * math.pi / 409600.0, NOISE), 90.0)
    commands = (ramps(1.491, 4.521, 8), sine(24.254, 0.6223, 2.41), ramps(2.896, 5.911, 3))
    rng = np.random.default_rng(seed)
    motions = [
        motion(recorded(k, PlannedStage(c, WEIGHT), nominal, rng)) for k, c in enumerate(commands)
    ]
    start = pack(
        {
            **TRUTH,
            "mu_c": 0.989 * 0.0339,
            "mu_s": 0.155,
            "omega_sL": 0.88 * 0.0415,
            "mu_2": 1.01 * 0.0282,
        },
        2.0,
    )
    free = [INDEX[name] for name in LOAD]
    begun = Point.of([m for m in motions if m is not None], start, free, Model(), Noise(NOISE))
    starts = breakaway_starts(begun, MU_C, LOAD_RISE, OMEGA_SL)
    p = searches.refine_from(begun, starts).point.vector
    static = p[MU_C] + p[LOAD_RISE]
    return (
        float(p[MU_C] / TRUTH["mu_c"] - 1.0),
        float(static / TRUTH["mu_s"] - 1.0),
        float(p[OMEGA_SL] / TRUTH["omega_sL"] - 1.0),
    )


@pytest.mark.parametrize("seed", [1, pytest.param(STUCK, marks=pytest.mark.proof)])
def test_wide_steps_lead_to_the_true_values(seed: int) -> None:
    coulomb, static, stribeck = searched(seed)
    assert abs(coulomb) < 0.001
    assert abs(static) < 0.005
    assert abs(stribeck) < 0.01


@pytest.mark.proof
def test_small_steps_alone_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """With that noise; without this the test above would prove nothing."""
    monkeypatch.setattr(searches, "_MISSED", math.inf)
    assert abs(searched(STUCK)[2]) > 0.1
