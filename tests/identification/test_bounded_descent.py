"""Levenberg-Marquardt within bounds."""

from __future__ import annotations

import numpy as np
import pytest

from identification.numerics.arrays import Array
from identification.numerics.least_squares import Box, minimise_within

T = np.linspace(0.0, 3.0, 60)


def curve(x: Array) -> Array:
    return np.asarray(x[0] * np.exp(-x[1] * T) + x[2])


def slope(x: Array, _here: Array) -> Array:
    falling = np.exp(-x[1] * T)
    return np.column_stack([falling, -x[0] * T * falling, np.ones(len(T))])


def found(data: Array, low: list[float], high: list[float], threshold: float = np.inf) -> Array:
    box = Box(np.array(low), np.array(high))
    return minimise_within(
        lambda x: curve(x) - data,
        slope,
        np.array([1.0, 0.3, 0.1]),
        box,
        threshold=np.full(len(T), threshold),
        tolerance=1e-12,
        most_steps=200,
    ).x


def test_within_the_bounds_it_finds_the_minimum() -> None:
    data = curve(np.array([2.0, 1.5, -0.4]))
    assert found(data, [0.0, 0.0, -1.0], [9.0, 9.0, 1.0]) == pytest.approx([2.0, 1.5, -0.4])


def test_a_bound_holds_and_the_others_are_optimal_on_it() -> None:
    data = curve(np.array([2.0, 1.5, -0.4]))
    x = found(data, [0.0, 0.0, 0.0], [9.0, 9.0, 1.0])
    assert x[2] == 0.0
    gradient = slope(x, data).T @ (curve(x) - data)
    assert gradient[:2] == pytest.approx([0.0, 0.0], abs=1e-5)
    assert gradient[2] > 0.0


def test_a_start_at_a_bound_leaves_it() -> None:
    data = curve(np.array([2.0, 1.5, 0.4]))
    assert found(data, [0.0, 0.3, 0.1], [9.0, 9.0, 1.0]) == pytest.approx([2.0, 1.5, 0.4])


def test_outliers_beyond_the_threshold_pull_little() -> None:
    data = curve(np.array([2.0, 1.5, 0.4]))
    data[::10] += 5.0
    squares = found(data, [0.0, 0.0, -1.0], [9.0, 9.0, 2.0])
    robust = found(data, [0.0, 0.0, -1.0], [9.0, 9.0, 2.0], threshold=1e-3)
    assert abs(squares[2] - 0.4) > 0.2
    assert robust == pytest.approx([2.0, 1.5, 0.4], abs=2e-3)
