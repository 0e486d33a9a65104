"""Compiled sines and sums over blocks against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.diagnosis.rows import in_blocks
from identification.numerics.series import sine_cosine


@given(st.floats(-200.0, 200.0), st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40))
def test_a_wave_is_sine_and_cosine(frequency: float, angles: list[float]) -> None:
    angle = np.array(angles)
    expected = np.stack([np.sin(frequency * angle), np.cos(frequency * angle)])
    assert sine_cosine(frequency, angle) == pytest.approx(expected, abs=1e-15)


def test_a_wave_at_its_zeros_and_turning_points() -> None:
    quarters = np.arange(-40_000, 40_001)
    sine, cosine = sine_cosine(0.5 * np.pi, quarters.astype(np.float64))
    assert sine == pytest.approx(np.array([0.0, 1.0, 0.0, -1.0])[quarters % 4], abs=2e-11)
    assert cosine == pytest.approx(np.array([1.0, 0.0, -1.0, 0.0])[quarters % 4], abs=2e-11)


@pytest.mark.parametrize("width", [1, 2, 5])
def test_sums_over_blocks_are_those_of_each_block_by_itself(width: int) -> None:
    rng = np.random.default_rng(width)
    columns, residual, block = (
        rng.standard_normal((200, width)),
        rng.standard_normal(200),
        rng.integers(0, 7, 200),
    )
    sums, weights = in_blocks(columns, residual, block, 8)
    for k in range(8):
        own = columns[block == k]
        assert sums[k] == pytest.approx(own.T @ residual[block == k], abs=1e-12)
        assert weights[k] == pytest.approx(own.T @ own, abs=1e-12)
