"""Minima and maxima of intervals hold every sample, whatever the pieces they arrive in."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.runs.decimation import KEPT, Decimation

CYCLE_S = 1e-3


@settings(max_examples=30)
@given(
    pieces=st.lists(st.integers(1, 700), min_size=1, max_size=12),
    gap=st.integers(0, 30_000),
    seed=st.integers(0, 9),
)
def test_every_interval_has_the_extremes_of_its_samples(
    pieces: list[int], gap: int, seed: int
) -> None:
    values = np.random.default_rng(seed).normal(size=(2, sum(pieces)))
    cycles = np.arange(sum(pieces))
    # The recording stands still while the operator hangs a weight.
    cycles[len(cycles) // 2 :] += gap
    decimation, begin = Decimation(2, CYCLE_S), 0
    for size in pieces:
        part = slice(begin, begin + size)
        decimation.add(cycles[part] * CYCLE_S, values[:, part])
        begin += size
    level = 0
    while (found := decimation.since(level, 0)).low.shape[1]:
        numbers = cycles >> level
        assert found.first + found.low.shape[1] == numbers[-1] + 1
        for k in {0, found.low.shape[1] // 2, found.low.shape[1] - 1}:
            inside = values[:, numbers == found.first + k]
            if inside.shape[1]:
                np.testing.assert_array_equal(found.low[:, k], inside.min(axis=1))
                np.testing.assert_array_equal(found.high[:, k], inside.max(axis=1))
            else:
                assert np.isnan(found.low[:, k]).all()
        level += 1
    assert level >= 1


def test_a_single_peak_is_seen_in_an_hour() -> None:
    decimation = Decimation(1, 10 * CYCLE_S)
    for begin in range(0, 360_000, 10_000):
        cycles = begin + np.arange(10_000)
        peak = np.where(cycles == 123_456, 99.0, 0.0)
        decimation.add(cycles * 10 * CYCLE_S, peak[None, :])
    level = decimation.level(3600.0, 390)
    found = decimation.since(level, 0)
    assert found.high.max() == 99.0
    assert decimation.interval_s(level) <= 3600.0 / 390 < 2 * decimation.interval_s(level)
    assert found.low.shape[1] <= KEPT


def test_pixels_and_windows_choose_one_or_two_intervals_per_pixel() -> None:
    decimation = Decimation(1, CYCLE_S)
    assert decimation.level(0.1, 1000) == 0
    assert decimation.level(10.0, 600) == 4
    assert decimation.level(10.0, 10**9) == decimation.level(10.0, KEPT // 2)
