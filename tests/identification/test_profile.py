"""Likelihood profiles and bootstrap: points optimised, ranges that agree with the intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.refinement import refine_recordings
from identification.estimate.searches import Refined, refine_stages
from identification.estimate.uncertainty import LEVEL, bootstrap, crossings, profiles
from identification.filter.likelihood import HUBER_THRESHOLD
from identification.filter.segments import motion
from identification.model.parameters import INDEX
from identification.numerics import least_squares as levenberg
from identification.recording import Array, Dataset, Model, Recording
from identification.result import Identification

from .practical import beginning
from .synthetic import SYSTEM, TRUTH

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


def test_where_the_likelihood_is_a_parabola_the_range_is_the_interval(
    profiled: Identification,
) -> None:
    for curve in profiled.profiles:
        p = profiled.parameters[curve.name]
        half = 0.5 * (p.high - p.low)
        assert curve.low == pytest.approx(p.low, abs=0.05 * half), curve.name
        assert curve.high == pytest.approx(p.high, abs=0.05 * half), curve.name


def test_a_profile_is_the_least_cost_with_that_value_held(
    practical_pair: tuple[Recording, Recording],
) -> None:
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
    found, moved = there.with_best_breakaways(HUBER_THRESHOLD)
    assert moved
    np.testing.assert_allclose(found.breakaway_times[0], begun, atol=2.6e-4)
    assert abs(found.breakaway_times[0][2] - begun[2]) < 1e-4
