"""A Jacobian kept as an arrow against the same as one dense matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.estimate.arrow import Arrow


def arrow(seed: int, rows: int, parameters: int, stretches: int) -> Arrow:
    rng = np.random.default_rng(seed)
    owners = rng.integers(0, stretches, rows)
    return Arrow(rng.normal(size=(rows, parameters)), rng.normal(size=rows), owners, stretches)


@given(st.integers(0, 1000), st.integers(0, 40), st.integers(0, 4), st.integers(1, 6))
def test_products_are_those_of_the_dense_matrix(seed: int, rows: int, parameters: int, stretches: int) -> None:
    one = arrow(seed, rows, parameters, stretches)
    rng = np.random.default_rng(seed + 1)
    other = Arrow(rng.normal(size=(rows, parameters)), rng.normal(size=rows), one.owners, stretches)
    weight, vector = rng.uniform(size=rows), rng.normal(size=rows)
    direction = rng.normal(size=(parameters + stretches, 2))
    dense, there = one.dense(), other.dense()
    assert one.product() == pytest.approx(dense.T @ dense)
    assert one.product(weight, other) == pytest.approx(dense.T @ (weight[:, None] * there))
    assert one.back(vector) == pytest.approx(dense.T @ vector)
    assert one.along(direction) == pytest.approx(dense @ direction)
    assert one.along(direction[:, 0]) == pytest.approx(dense @ direction[:, 0])
    assert one.mixed(weight, other).dense() == pytest.approx(weight[:, None] * dense + (1.0 - weight)[:, None] * there)


def test_a_parameter_is_left_out() -> None:
    one = arrow(1, 20, 3, 4)
    assert np.array_equal(one.without(1).dense(), np.delete(one.dense(), 1, axis=1))
