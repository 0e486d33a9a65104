"""What single stretches may say of a parameter, and their curves laid over one another."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.estimate.inertia import inflation_factors, mean_curve
from identification.numerics.least_squares import BlockArrow

ALIKE = np.full(10, 1000, dtype=np.int64)
"""Samples of stretches of one length."""


def test_the_noise_of_a_stretch_that_says_far_more_is_taken_to_be_larger() -> None:
    stretches = np.array([np.diag([1.0, 1.0])] * 9 + [np.diag([1.0, 9991.0])])
    one = np.zeros(10, dtype=np.int64)
    doubt = inflation_factors(stretches, ALIKE, one, 3.0)
    assert doubt == pytest.approx([1.0] * 9 + [np.sqrt(9991.0 / 3.0)])
    believed = np.sum(stretches / doubt[:, None, None] ** 2, axis=0)
    assert believed == pytest.approx(np.diag([9.0 + 3.0 / 9991.0, 9.0 + 3.0]))
    assert inflation_factors(stretches[:9], ALIKE[:9], one[:9], 3.0) == pytest.approx(np.ones(9))


def test_recordings_are_judged_each_by_its_own_stretches() -> None:
    light, heavy = np.diag([1.0, 1.0, 1e-15]), np.diag([1.0, 100.0, 1.0])
    stretches = np.array([light] * 2 + [10.0 * light] + [heavy] * 3)
    doubt = inflation_factors(stretches, ALIKE[:6], np.repeat([0, 1], 3), 3.0)
    assert doubt == pytest.approx([1.0, 1.0, np.sqrt(10.0 / 3.0), 1.0, 1.0, 1.0])


def test_what_stretches_tell_is_the_schur_complement_of_their_breakaway_times() -> None:
    rng = np.random.default_rng(0)
    slopes = BlockArrow(
        rng.standard_normal((12, 3)), rng.standard_normal(12), np.repeat([0, 1, 2], 4), 3
    )
    told = slopes.information_by_block()
    weight = np.ones(12)
    assert np.sum(told, axis=0) == pytest.approx(slopes.eliminated(weight, weight).matrix)
    own, along = slopes.parameters[4:8], slopes.own[4:8]
    clear = own - np.outer(along, along @ own) / (along @ along)
    assert told[1] == pytest.approx(clear.T @ clear)


ONSETS = st.floats(-20.0, 60.0)


@given(
    lengths=st.lists(st.integers(1, 50), min_size=1, max_size=4),
    length=st.integers(1, 50),
    data=st.data(),
)
def test_straight_lines_from_breakaway_lie_on_one_another_where_there_are_any(
    lengths: list[int], length: int, data: st.DataObject
) -> None:
    onsets = [data.draw(ONSETS) for _ in lengths]
    onset = data.draw(ONSETS)
    lines = [
        np.outer(np.arange(n) - begun, [1.0, -2.0])
        for n, begun in zip(lengths, onsets, strict=True)
    ]
    mean, seen = mean_curve(lines, onsets, length, onset)
    assert mean.shape == (length, 2)
    for k in range(length):
        place = [np.floor(k + begun - onset) for begun in onsets]
        count = sum(0 <= at < n - 1 for at, n in zip(place, lengths, strict=True))
        edge = any(abs(k + begun - onset - round(k + begun - onset)) < 1e-9 for begun in onsets)
        assert edge or seen[k, 0] == count
        assert mean[k] == pytest.approx(
            [k - onset, 2.0 * (onset - k)] if seen[k, 0] else [0.0, 0.0], abs=1e-9
        )
