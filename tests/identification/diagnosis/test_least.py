"""Least squares by normal equations, and by singular values where columns are not apart."""

from __future__ import annotations

import numpy as np
import pytest

from identification.numerics.least_squares import least_squares

ROWS = np.linspace(0.0, 1.0, 400)


@pytest.mark.parametrize("scale", [1.0, 1e8])
def test_columns_that_are_apart_come_out_as_by_singular_values(scale: float) -> None:
    columns = np.stack([np.ones(400), scale * ROWS, np.sin(9.0 * ROWS)], axis=1)
    target = np.cos(5.0 * ROWS)
    expected = np.linalg.lstsq(columns, target, rcond=None)[0]
    assert least_squares(columns, target) == pytest.approx(expected, rel=1e-12)


def test_of_columns_that_are_one_each_gets_its_half() -> None:
    columns = np.stack([ROWS, ROWS], axis=1)
    assert least_squares(columns, 3.0 * ROWS) == pytest.approx([1.5, 1.5])


def test_a_column_of_nothing_gets_nothing() -> None:
    for nothing in (0.0, 2.5e-317):
        columns = np.stack([ROWS, np.full(400, nothing)], axis=1)
        assert least_squares(columns, 3.0 * ROWS) == pytest.approx([3.0, 0.0])
        assert least_squares(columns[:, 1:], 3.0 * ROWS) == pytest.approx([0.0])


def test_no_column_gets_no_coefficient() -> None:
    assert least_squares(np.zeros((400, 0)), ROWS).shape == (0,)


@pytest.mark.parametrize("scale", [1e-170, 1e-120, 1e120])
def test_columns_of_any_size_are_solved_without_overflow(scale: float) -> None:
    """An effect at a hopeless trial shape has next to no column; below 1e-140 it counts as none."""
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((50, 2)) * (1.0, scale)
    found = least_squares(columns, columns @ (2.0, 3.0 / scale))
    assert np.all(np.isfinite(found))
    if scale != 1e-170:
        assert found * (1.0, scale) == pytest.approx([2.0, 3.0], rel=1e-9)


def test_what_is_no_number_is_not_passed_over() -> None:
    columns = np.stack([ROWS, np.full(400, np.nan)], axis=1)
    with pytest.raises(np.linalg.LinAlgError):
        least_squares(columns, ROWS)
