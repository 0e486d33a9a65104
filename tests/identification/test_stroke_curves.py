"""Curves laid over one another by the time since breakaway."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.estimate.inertia import mean_curve

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
