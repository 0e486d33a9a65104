"""Intervals hold what they promise, and what the data cannot pin is said in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats

from identification.estimate.default import identify
from identification.estimate.equation_error import block_sandwich
from identification.numerics.spread import Spread, correlation_samples
from identification.prepare import prepare
from identification.recording import Dataset

from .synthetic import TRUTH, sine

TRIALS = 120
ROLLING = {**TRUTH, "Ms": TRUTH["Mc"]}
LINEAR = ("Mc", "sigma_2", "J")


def ar1(rng: np.random.Generator, n: int, pole: float) -> np.ndarray:
    """Unit-rms noise whose neighbours correlate by ``pole``."""
    white = rng.normal(size=n + 500) * np.sqrt(1.0 - pole**2)
    return np.asarray(signal.lfilter([1.0], [1.0, -pole], white))[500:]


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_ninety_percent_intervals_cover_at_about_that_rate(pole: float) -> None:
    clean = prepare(sine(ROLLING, frequency=2.0, duration=4.0), 500.0)
    columns = np.column_stack([np.sign(clean.velocity), clean.velocity, clean.acceleration])[
        clean.used
    ]
    rng = np.random.default_rng(11)
    covered = np.zeros(len(LINEAR))
    for _ in range(TRIALS):
        noisy = replace(clean, torque=clean.torque + 0.3 * ar1(rng, len(clean.time), pole))
        found = np.linalg.lstsq(columns, noisy.torque[noisy.used], rcond=None)[0]
        values = {**ROLLING, **dict(zip(LINEAR, map(float, found), strict=True))}
        values["Ms"] = values["Mc"]
        spread = block_sandwich([noisy], values, LINEAR, 2.0)
        widths = [spread.half_width(name) for name in LINEAR]
        covered += np.abs(found - [ROLLING[n] for n in LINEAR]) <= widths
    # 1 in 10 000 either way for a true rate between 0.85 and 0.95.
    low, high = stats.binom.ppf(1e-4, TRIALS, 0.85), stats.binom.ppf(1.0 - 1e-4, TRIALS, 0.95)
    assert np.all((low <= covered) & (covered <= high)), covered / TRIALS


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9])
def test_correlation_time_of_a_first_order_process(pole: float) -> None:
    rng = np.random.default_rng(3)
    times = [correlation_samples(ar1(rng, 20000, pole)) for _ in range(10)]
    assert np.mean(times) == pytest.approx((1.0 + pole) / (1.0 - pole), rel=0.25)


def test_half_width_is_students() -> None:
    spread = Spread(("a",), np.array([[4.0]]), 5.0)
    assert spread.half_width("a") == pytest.approx(2.0 * stats.t.ppf(0.95, 5.0))
    assert replace(spread, freedom=np.inf).half_width("a") == pytest.approx(3.29, abs=0.01)
    assert np.isnan(replace(spread, freedom=np.nan).half_width("a")), (
        "no interval, not the narrowest"
    )


def test_half_width_of_a_difference_counts_what_the_two_share() -> None:
    spread = Spread(("a", "b"), np.array([[4.0, 3.5], [3.5, 4.0]]), 5.0)
    assert spread.half_width_above("b", "a") == pytest.approx(stats.t.ppf(0.95, 5.0))
    assert spread.half_width_above("b", "known") == spread.half_width("b")


def test_inertia_of_a_slow_motion_is_withheld_with_words() -> None:
    rng = np.random.default_rng(4)
    slow = sine(
        frequency=0.02,
        amplitude=3.0,
        duration=50.0,
        rate=200.0,
        noise=lambda n: rng.normal(0.0, 0.5, n),
    )
    found = identify(Dataset((slow,))).parameters
    assert found["J"].value is None
    assert not found["J"].identifiable
    assert "J domega/dt is" in found["J"].reason
    assert "% of the torque" in found["J"].reason
    assert found["Mc"].value == pytest.approx(TRUTH["Mc"], rel=0.02)


def test_static_friction_without_a_rise_is_withheld_with_words() -> None:
    rng = np.random.default_rng(4)
    falling = sine({**TRUTH, "Ms": 0.5 * TRUTH["Mc"]}, noise=lambda n: rng.normal(0.0, 0.05, n))
    found = identify(Dataset((falling,))).parameters
    for name in ("Ms", "omega_sf"):
        assert found[name].value is None
        assert found[name].at_bound
        assert "static friction does not exceed Coulomb friction" in found[name].reason


@pytest.mark.parametrize(("noise_N_m", "seed"), [(0.0, 0), (0.02, 1), (0.2, 2)])
def test_static_friction_is_withheld_where_its_falling_part_is_not_seen(
    noise_N_m: float, seed: int
) -> None:
    """No sample is slower than 8 omega_sf, so nothing says how high friction rises toward rest."""
    rng = np.random.default_rng(seed)
    fast = sine(
        amplitude=0.3, frequency=0.5, drift=1.4, noise=lambda n: rng.normal(0.0, noise_N_m, n)
    )
    found = identify(Dataset((fast,))).parameters
    for name in ("Ms", "omega_sf"):
        assert found[name].value is None, name
        assert found[name].reason
    assert found["J"].value == pytest.approx(TRUTH["J"], rel=0.05)
