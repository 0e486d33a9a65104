"""Bootstrap over stretches: around the estimate, about as wide as the interval, from the generator
it is given.
"""

from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.refinement import refine_recordings
from identification.estimate.searches import Refined
from identification.estimate.uncertainty import bootstrap
from identification.filter.likelihood import HUBER_THRESHOLD
from identification.model.parameters import NOMINAL, SYSTEM_PARAMETERS
from identification.recording import Dataset, Model, Recording

from .synthetic import sine

UNITS = dict.fromkeys(SYSTEM_PARAMETERS, "1")
DRAWS = 60


@pytest.fixture(scope="module")
def refined(practical_pair: tuple[Recording, Recording]) -> Refined:
    start = {n: NOMINAL[n] for n in SYSTEM_PARAMETERS}
    found = refine_recordings(practical_pair[:1], start, SYSTEM_PARAMETERS, Model())
    assert isinstance(found, Refined)
    return found


@pytest.mark.proof
def test_draws_lie_about_the_estimate_as_wide_as_its_interval(refined: Refined) -> None:
    begun = refined.joint.vector.copy()
    found = bootstrap(refined, UNITS, DRAWS, np.random.default_rng(1))
    assert [r.name for r in found] == list(refined.names)
    np.testing.assert_array_equal(refined.joint.vector, begun)
    for k, r in enumerate(found):
        assert r.low is not None
        assert r.high is not None
        assert r.solved > 0.9 * DRAWS
        assert r.low < refined.values[r.name] < r.high
        # Eight stretches or so: the spread of their draws is itself known to a third or so.
        half = 1.645 * float(np.sqrt(refined.covariance[k, k]))
        assert 0.35 < 0.5 * (r.high - r.low) / half < 1.6


def test_the_same_generator_gives_the_same_draws(refined: Refined) -> None:
    one, other = (bootstrap(refined, UNITS, 3, np.random.default_rng(7)) for _ in range(2))
    assert one == other


def test_without_prediction_errors_there_is_none_and_it_is_said() -> None:
    result = identify(Dataset((sine(),)), bandwidth_Hz=500.0, draws=20)
    assert result.resampled == ()
    assert any("no bootstrap" in w for w in result.warnings)


def test_a_breakaway_in_a_wrong_place_is_found_again(refined: Refined) -> None:
    held, (begun,) = refined.joint.weighted(), refined.joint.breakaway_times
    late = begun + np.where(np.arange(len(begun)) == 2, 1.5e-3, 0.0)
    there = replace(held, point=replace(refined.joint, breakaway_times=(late,)))
    found, moved = there.with_best_breakaways(HUBER_THRESHOLD)
    assert moved
    np.testing.assert_allclose(found.breakaway_times[0], begun, atol=2.6e-4)
    assert abs(found.breakaway_times[0][2] - begun[2]) < 1e-4
