"""A Jacobian kept as an arrow against the same as one dense matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from identification.numerics.least_squares import BlockArrow


def arrow(seed: int, rows: int, parameters: int, stretches: int) -> BlockArrow:
    rng = np.random.default_rng(seed)
    owners = rng.integers(0, stretches, rows)
    return BlockArrow(rng.normal(size=(rows, parameters)), rng.normal(size=rows), owners, stretches)


@given(st.integers(0, 1000), st.integers(0, 40), st.integers(0, 4), st.integers(1, 6))
def test_products_are_those_of_the_dense_matrix(
    seed: int, rows: int, parameters: int, stretches: int
) -> None:
    one = arrow(seed, rows, parameters, stretches)
    rng = np.random.default_rng(seed + 1)
    other = BlockArrow(
        rng.normal(size=(rows, parameters)), rng.normal(size=rows), one.owners, stretches
    )
    weight, vector = rng.uniform(size=rows), rng.normal(size=rows)
    direction = rng.normal(size=(parameters + stretches, 2))
    dense, there = one.dense(), other.dense()
    assert one.product() == pytest.approx(dense.T @ dense)
    assert one.product(weight, other) == pytest.approx(dense.T @ (weight[:, None] * there))
    assert one.back(vector) == pytest.approx(dense.T @ vector)
    assert one.along(direction) == pytest.approx(dense @ direction)
    assert one.along(direction[:, 0]) == pytest.approx(dense @ direction[:, 0])
    assert one.mixed(weight, other).dense() == pytest.approx(
        weight[:, None] * dense + (1.0 - weight)[:, None] * there
    )


@given(st.integers(0, 1000), st.integers(5, 40), st.integers(1, 4), st.integers(1, 4))
def test_a_newton_step_without_the_breakaway_times_is_that_of_the_whole(
    seed: int, rows: int, parameters: int, stretches: int
) -> None:
    one = arrow(seed, rows, parameters, stretches)
    rng = np.random.default_rng(seed + 1)
    weight, residual = rng.uniform(0.1, 1.0, rows), rng.normal(size=rows)
    found = one.eliminated(residual, weight)
    silent = np.setdiff1d(np.arange(stretches), one.owners)
    whole, gradient = one.product(weight), one.back(weight * residual)
    whole[parameters + silent, parameters + silent] = 1.0
    inverse = np.linalg.pinv(whole, hermitian=True)
    assume(np.linalg.cond(whole) < 1e8)
    assert np.linalg.inv(found.matrix) == pytest.approx(inverse[:parameters, :parameters])
    step = -np.linalg.solve(found.matrix, found.scores.sum(axis=0))
    assert np.concatenate([step, found.own_step(step)]) == pytest.approx(-inverse @ gradient)
    for k in range(stretches):
        alone = one.eliminated(residual, weight * (one.owners == k))
        assert alone.scores[k] == pytest.approx(found.scores[k])


def test_a_parameter_is_left_out() -> None:
    one = arrow(1, 20, 3, 4)
    assert np.array_equal(one.without(1).dense(), np.delete(one.dense(), 1, axis=1))
