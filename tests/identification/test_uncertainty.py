"""Intervals, likelihood profiles, bootstrap and trade-offs."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats

from identification.estimate.default import identify
from identification.estimate.equation_error import block_sandwich
from identification.estimate.parameter_table import least_pinned, tradeoffs
from identification.estimate.refinement import refine_recordings
from identification.estimate.searches import Refined, refine_stages
from identification.estimate.uncertainty import LEVEL, bootstrap, crossings, profiles
from identification.filter.likelihood import HUBER_THRESHOLD
from identification.filter.segments import motion
from identification.model.parameters import INDEX, UNITS_ROTARY
from identification.numerics import least_squares as levenberg
from identification.numerics.spread import Spread, correlation_samples
from identification.prepare import prepare
from identification.recording import Array, Dataset, Model, Recording
from identification.result import Identification

from .practical import beginning
from .synthetic import SYSTEM, TRUTH, sine

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
def test_static_friction_is_withheld_where_its_falling_part_is_not_seen(noise_N_m, seed):
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


UNITS = dict.fromkeys(TRUTH, "1")
DRAWS = 60


def refine(recording: Recording, model: Model) -> Refined:
    moving = motion(recording)
    assert moving is not None
    return refine_stages([moving], [], {n: TRUTH[n] for n in SYSTEM}, model)


@pytest.fixture(scope="module")
def profiled(practical_pair: tuple[Recording, Recording]) -> Identification:
    return identify(Dataset((beginning(practical_pair[0], 10.0),)), profile=True)


def test_every_fitted_parameter_has_one(profiled: Identification) -> None:
    assert sorted(c.name for c in profiled.profiles) == sorted(SYSTEM)
    for curve in profiled.profiles:
        assert np.all(np.diff(curve.values) > 0.0)
        middle = int(np.flatnonzero(curve.deviance == 0.0)[0])
        assert curve.values[middle] == pytest.approx(profiled.fitted[curve.name], rel=1e-5)
        assert np.all(np.diff(curve.deviance[middle:]) > 0.0)
        assert np.all(np.diff(curve.deviance[: middle + 1]) < 0.0)
        assert curve.unit == profiled.parameters[curve.name].unit


def test_where_the_likelihood_is_a_parabola_the_range_is_the_interval(profiled):
    for curve in profiled.profiles:
        p = profiled.parameters[curve.name]
        half = 0.5 * (p.high - p.low)
        assert curve.low == pytest.approx(p.low, abs=0.05 * half), curve.name
        assert curve.high == pytest.approx(p.high, abs=0.05 * half), curve.name


def test_a_profile_is_the_least_cost_with_that_value_held(practical_pair):
    """Against another search over the others, from their values at the estimate."""
    refined = refine(practical_pair[0], Model(fixed={"J": TRUTH["J"]}))
    (curve,) = (c for c in profiles(refined, UNITS) if c.name == "sigma_2")
    joint, held = refined.joint, refined.joint.weighted()
    place = joint.free.index(INDEX["sigma_2"])

    def least(value: float) -> float:
        def whole(x: Array) -> Array:
            return np.insert(x, place, value)

        found = levenberg.minimise(
            lambda x: held.residuals(whole(x)),
            lambda x, here: held.jacobian(whole(x), here).without(place),
            np.delete(joint.origin(), place),
            threshold=HUBER_THRESHOLD,
            tolerance=1e-9,
        )
        return found.cost

    middle = float(curve.values[int(np.argmin(curve.deviance))])
    for k in (0, -1):
        expected = 2.0 * curve.scale * (least(float(curve.values[k])) - least(middle))
        assert curve.deviance[k] == pytest.approx(expected, rel=0.01)


def test_crossings_of_a_parabola_and_of_a_skew_curve() -> None:
    values = np.linspace(-3.0, 3.0, 7)
    assert crossings(values, values**2) == pytest.approx((-(LEVEL**0.5), LEVEL**0.5))
    low, high = crossings(values, np.where(values < 0.0, 4.0 * values**2, values**2))
    assert high == pytest.approx(LEVEL**0.5)
    assert low == pytest.approx(-0.5 * LEVEL**0.5)


@pytest.fixture(scope="module")
def refined(practical_pair: tuple[Recording, Recording]) -> Refined:
    start = {n: TRUTH[n] for n in SYSTEM}
    found = refine_recordings(practical_pair[:1], start, SYSTEM, Model())
    assert isinstance(found, Refined)
    return found


@pytest.mark.proof
def test_draws_lie_about_the_estimate_as_wide_as_its_interval(refined: Refined) -> None:
    begun = refined.joint.vector.copy()
    found = bootstrap(refined, UNITS, DRAWS, np.random.default_rng(1))
    assert [r.name for r in found] == list(refined.names)
    np.testing.assert_array_equal(refined.joint.vector, begun)
    for k, r in enumerate(found):
        assert r.high is not None
        assert r.solved > 0.9 * DRAWS
        assert r.low < refined.values[r.name] < r.high
        # Eight stretches or so: the spread of their draws is itself known to a third or so.
        half = 1.645 * float(np.sqrt(refined.covariance[k, k]))
        assert 0.35 < 0.5 * (r.high - r.low) / half < 1.6


def test_a_breakaway_in_a_wrong_place_is_found_again(refined: Refined) -> None:
    held, (begun,) = refined.joint.weighted(), refined.joint.breakaway_times
    late = begun + np.where(np.arange(len(begun)) == 2, 1.5e-3, 0.0)
    there = replace(held, point=replace(refined.joint, breakaway_times=(late,)))
    found, moved = there.with_best_breakaways()
    assert moved
    np.testing.assert_allclose(found.breakaway_times[0], begun, atol=2.6e-4)
    assert abs(found.breakaway_times[0][2] - begun[2]) < 1e-4


def spread(names: tuple[str, ...], pinned: list[float], tight: float, loose: float) -> Spread:
    """Two parameters of which ``pinned`` @ both has deviation ``tight``, and their other
    combination ``loose``.
    """
    basis = np.array([pinned, [-pinned[1], pinned[0]]])
    turn = np.linalg.inv(basis)
    return Spread(names, turn @ np.diag([tight**2, loose**2]) @ turn.T, math.inf)


@pytest.mark.parametrize(
    ("names", "weight", "told"),
    [
        (
            ("Mc", "sigma_2"),
            0.3,
            "sum at 0.3 rad/s is determined, Mc + 0.3 sigma_2 = 8.4289 +- 0.0016 N m",
        ),
        (
            ("mu_c", "mu_2"),
            0.3,
            "sum at 0.3 rad/s is determined, mu_c + 0.3 mu_2 = 0.0616 +- 0.0016",
        ),
        (("Ms", "mu_s"), 285.0, "sum at a contact moment of 285 N m is determined, Ms + 285 mu_s"),
    ],
)
def test_the_pinned_sum_is_found(names: tuple[str, str], weight: float, told: str) -> None:
    (pair,) = tradeoffs(spread(names, [1.0, weight], 0.001, 10.0 * weight), TRUTH, UNITS_ROTARY)
    assert pair.names == names
    assert pair.correlation < -0.99
    assert told in pair.statement


def test_other_pairs_are_told_as_products_and_ratios() -> None:
    relative = np.array([TRUTH["mu_s"], TRUTH["omega_sL"]])
    for sign, words in (
        (-1.0, "only the product mu_s omega_sL^0.5 is determined"),
        (1.0, "only the ratio mu_s / omega_sL^0.5 "),
    ):
        # mu_s moves by half a percent for each percent of omega_sL, and by 0.01 % on its own.
        moves = np.array([[0.005 * sign, 0.0001], [0.01, 0.0]]) * relative[:, None]
        (pair,) = tradeoffs(
            Spread(("mu_s", "omega_sL"), moves @ moves.T, math.inf), TRUTH, UNITS_ROTARY
        )
        assert words in pair.statement
        assert pair.statement.endswith("to 0.016 %")


def test_what_does_not_trade_off_is_not_told() -> None:
    independent = Spread(("Mc", "J"), np.diag([1e-6, 1e-4]), math.inf)
    assert tradeoffs(independent, TRUTH, UNITS_ROTARY) == ()
    line = least_pinned(independent, TRUTH)
    assert re.search(r"\bJ alone\b.* 4\.9 %", line)
