"""What single stretches may say of a parameter, and what that does to its interval."""

from __future__ import annotations

import numpy as np
import pytest

from identification.estimate.arrow import Arrow
from identification.estimate.leverage import bounded, widening


def test_a_stretch_that_says_far_more_than_the_others_is_believed_as_a_few() -> None:
    stretches = np.array([np.diag([1.0, 4.0]), np.diag([1.0, 4.0]), np.diag([1.0, 4000.0])])
    assert bounded(stretches, 2.0) == pytest.approx(np.diag([2.0 + 2e-3, 8.0 + 8.0]))
    assert bounded(stretches[:2], 2.0) == pytest.approx(np.diag([2.0, 8.0]))


def test_an_interval_that_rests_on_one_stretch_is_wider() -> None:
    stretches = np.array([np.diag([1.0, 1.0])] * 9 + [np.diag([1.0, 9991.0])])
    one = np.zeros(10, dtype=np.int64)
    wide = widening(stretches, one, 3.0)
    share = 3.0 / 9991.0
    assert wide == pytest.approx([np.sqrt(10.0 / (9.0 + share)), np.sqrt(1e4 / 12.0)])
    assert widening(stretches[:9], one[:9], 3.0) == pytest.approx([1.0, 1.0])


def test_recordings_are_judged_each_by_its_own_stretches() -> None:
    """A heavier weight may say more than a lighter one, and what a recording does not hold limits nothing."""
    light, heavy = np.diag([1.0, 1.0, 0.0]), np.diag([1.0, 100.0, 1.0])
    stretches = np.array([light] * 3 + [heavy] * 3)
    assert widening(stretches, np.repeat([0, 1], 3), 3.0) == pytest.approx([1.0, 1.0, 1.0])


def test_what_stretches_tell_is_the_schur_complement_of_their_breakaway_times() -> None:
    rng = np.random.default_rng(0)
    slopes = Arrow(rng.standard_normal((12, 3)), rng.standard_normal(12), np.repeat([0, 1, 2], 4), 3)
    told = slopes.told()
    weight = np.ones(12)
    assert np.sum(told, axis=0) == pytest.approx(slopes.eliminated(weight, weight).matrix)
    own, along = slopes.parameters[4:8], slopes.own[4:8]
    clear = own - np.outer(along, along @ own) / (along @ along)
    assert told[1] == pytest.approx(clear.T @ clear)
