"""What single stretches may say of a parameter, and their curves laid over one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.estimate import inertia as instrumental
from identification.estimate.inertia import inflation_factors, mean_curve
from identification.filter.likelihood import Point, Searched
from identification.filter.segments import Noise, motion
from identification.model.parameters import MC, pack
from identification.numerics.least_squares import BlockArrow
from identification.recording import Array, Model, Recording
from tests.identification.practical import beginning
from tests.identification.synthetic import TRUTH

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
    """A heavier weight may say more than a lighter one, and what a recording does not hold limits
    nothing.
    """
    light, heavy = np.diag([1.0, 1.0, 1e-15]), np.diag([1.0, 100.0, 1.0])
    stretches = np.array([light] * 2 + [10.0 * light] + [heavy] * 3)
    doubt = inflation_factors(stretches, ALIKE[:6], np.repeat([0, 1], 3), 3.0)
    assert doubt == pytest.approx([1.0, 1.0, np.sqrt(10.0 / 3.0), 1.0, 1.0, 1.0])


def test_strokes_are_not_doubted_beside_more_slips_that_say_little() -> None:
    """Seen on a bench whose load slipped twenty samples far between strokes: every stroke was taken
    for the odd one.
    """
    stretches = np.array([np.diag([100.0]), np.diag([1.0]), np.diag([1.0])] * 3)
    lengths = np.array([2000, 20, 20] * 3)
    recordings = np.zeros(9, dtype=np.int64)
    assert inflation_factors(stretches, lengths, recordings, 3.0) == pytest.approx(np.ones(9))
    stretches[0] *= 12.0
    assert inflation_factors(stretches, lengths, recordings, 3.0) == pytest.approx(
        [2.0] + [1.0] * 8
    )


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


def test_stretches_are_judged_again_where_the_fit_ends(
    practical_pair: tuple[Recording, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = motion(beginning(practical_pair[0], 3.0))
    assert found is not None
    begun = pack(TRUTH, 2.0)
    point = Point.of([found], begun, [MC], Model(), Noise(0.1))

    def fit(p: Point) -> Searched:
        return Searched(replace(p, vector=p.vector + 0.1), 1)

    def segment_inflation(p: Point, _others: Sequence[int]) -> Array:
        return np.full(p.breakaways, 1.0 if p.vector is begun else 2.0)

    monkeypatch.setattr(instrumental, "segment_inflation", segment_inflation)
    ended = instrumental.fit_beside_inertia(point, fit)
    assert ended.point.inflation == pytest.approx(np.full(point.breakaways, 2.0))
    assert np.array_equal(point.inflation, np.ones(point.breakaways))


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


def test_a_shift_of_whole_samples_changes_no_bit() -> None:
    curve = np.random.default_rng(0).normal(size=(9, 3))
    mean, seen = mean_curve([curve], [5.0], 6, 3.0)
    assert np.array_equal(mean, curve[2:8])
    assert np.all(seen == 1.0)
