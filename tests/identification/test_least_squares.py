"""Damped searches, linear problems within bounds, and a Jacobian kept as an arrow."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import optimize

from identification.numerics.least_squares import (
    BlockArrow,
    Box,
    Design,
    Minimum,
    bounded_least_squares,
    minimise,
    minimise_deviance,
)
from identification.recording import Array

from .synthetic import dense

SAMPLES = 400
T = np.linspace(0.0, 3.0, 60)


def drawn(seed: int) -> Array:
    return 3.0 + 0.5 * np.random.default_rng(seed).normal(size=SAMPLES)


def likeliest(data: Array, reach: float = math.inf) -> Minimum:
    """Fit a mean x0 and a deviation exp(x1)."""

    def derivatives(x: Array, _errors: Array, deviations: Array) -> tuple[Array, Array]:
        zeros, ones = np.zeros(len(data)), np.ones(len(data))
        return np.column_stack([1.0 / deviations, zeros]), np.column_stack([zeros, ones])

    return minimise_deviance(
        lambda x: (x[0] - data, np.full(len(data), np.exp(x[1]))),
        derivatives,
        np.array([0.0, 1.0]),
        threshold=1e9,
        tolerance=1e-12,
        reach=reach,
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_likeliest_mean_and_deviation_have_their_closed_form(seed: int) -> None:
    data = drawn(seed)
    found = likeliest(data)
    assert found.x[0] == pytest.approx(np.mean(data), rel=1e-6)
    assert np.exp(found.x[1]) == pytest.approx(np.std(data), rel=1e-5)
    assert found.cost == pytest.approx(SAMPLES * (0.5 + np.log(np.std(data))), rel=1e-9)


def test_a_search_that_would_not_reach_another_ends_early() -> None:
    whole = likeliest(drawn(0))
    reached, missed = (likeliest(drawn(0), whole.cost - less) for less in (0.0, 1e6))
    assert (reached.steps, reached.cost, reached.beaten) == (whole.steps, whole.cost, False)
    assert missed.beaten
    assert missed.steps < whole.steps
    assert missed.cost > whole.cost


def test_a_parameter_of_the_deviation_alone_is_found() -> None:
    """Of samples around zero whose deviation is x, squares hold all information."""
    data = 2.0 * np.random.default_rng(1).normal(size=SAMPLES)
    found = minimise_deviance(
        lambda x: (data, np.full(SAMPLES, x[0])),
        lambda _x, _errors, deviations: (np.zeros((SAMPLES, 1)), 1.0 / deviations[:, None]),
        np.array([1.0]),
        threshold=1e9,
        tolerance=1e-12,
    )
    assert found.x[0] == pytest.approx(np.sqrt(np.mean(data**2)), rel=1e-6)


def test_an_outlier_pulls_no_more_than_its_threshold() -> None:
    def centre(values: Array) -> float:
        found = minimise(
            lambda x: (x[0] - values) / 0.5,
            lambda x, _: np.full((len(values), 1), 2.0),
            np.array([0.0]),
            threshold=4.0,
            tolerance=1e-12,
        )
        return float(found.x[0])

    data = drawn(0)
    pull = centre(np.append(data, 1e6)) - centre(data)
    assert pull == pytest.approx(4.0 * 0.5 / SAMPLES, rel=0.05)


def curve(x: Array) -> Array:
    return np.asarray(x[0] * np.exp(-x[1] * T) + x[2])


def slope(x: Array, _here: Array) -> Array:
    falling = np.exp(-x[1] * T)
    return np.column_stack([falling, -x[0] * T * falling, np.ones(len(T))])


def within(data: Array, low: list[float], threshold: float = np.inf) -> Array:
    return minimise(
        lambda x: curve(x) - data,
        slope,
        np.array([1.0, 0.3, 0.1]),
        threshold=np.full(len(T), threshold),
        tolerance=1e-12,
        most_steps=200,
        box=Box(np.array(low), np.array([9.0, 9.0, 2.0])),
    ).x


@pytest.mark.parametrize(
    ("truth", "low"),
    [([2.0, 1.5, -0.4], [0.0, 0.0, -1.0]), ([2.0, 1.5, 0.4], [0.0, 0.3, 0.1])],
    ids=["inside", "starts at a bound"],
)
def test_within_bounds_the_minimum_is_found(truth: list[float], low: list[float]) -> None:
    assert within(curve(np.array(truth)), low) == pytest.approx(truth)


def test_a_bound_holds_and_the_others_are_optimal_on_it() -> None:
    data = curve(np.array([2.0, 1.5, -0.4]))
    x = within(data, [0.0, 0.0, 0.0])
    assert x[2] == 0.0
    gradient = slope(x, data).T @ (curve(x) - data)
    assert gradient[:2] == pytest.approx([0.0, 0.0], abs=1e-5)
    assert gradient[2] > 0.0


def test_within_bounds_outliers_beyond_the_threshold_pull_little() -> None:
    data = curve(np.array([2.0, 1.5, 0.4]))
    data[::10] += 5.0
    assert abs(within(data, [0.0, 0.0, -1.0])[2] - 0.4) > 0.2
    robust = within(data, [0.0, 0.0, -1.0], 1e-3)
    assert robust == pytest.approx([2.0, 1.5, 0.4], abs=2e-3)


@given(st.integers(0, 10_000))
@settings(max_examples=60)
def test_bounded_least_squares_is_the_constrained_minimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(40, 4)) * 10.0 ** rng.uniform(-3.0, 3.0, 4)
    target = rng.normal(size=40)
    low, high = np.array([0.0, 0.0, 0.0, -np.inf]), np.full(4, np.inf)
    found, cost = bounded_least_squares(Design(columns, target, low, high))
    assert np.all(found >= low)
    assert cost == pytest.approx(float(np.sum((columns @ found - target) ** 2)), rel=1e-9)
    scale = np.linalg.norm(columns, axis=0)
    reference = optimize.lsq_linear(columns / scale, target, (low, high), tol=1e-14)
    assert cost <= 2.0 * reference.cost * (1.0 + 1e-9)


def arrow(seed: int, rows: int, parameters: int, stretches: int) -> BlockArrow:
    rng = np.random.default_rng(seed)
    owners = rng.integers(0, stretches, rows)
    return BlockArrow(rng.normal(size=(rows, parameters)), rng.normal(size=rows), owners, stretches)


@given(st.integers(0, 1000), st.integers(0, 40), st.integers(0, 4), st.integers(1, 6))
def test_products_are_those_of_the_dense_matrix(seed, rows, parameters, stretches):
    one = arrow(seed, rows, parameters, stretches)
    rng = np.random.default_rng(seed + 1)
    other = BlockArrow(
        rng.normal(size=(rows, parameters)), rng.normal(size=rows), one.owners, stretches
    )
    weight, vector = rng.uniform(size=rows), rng.normal(size=rows)
    direction = rng.normal(size=(parameters + stretches, 2))
    here, there = dense(one), dense(other)
    assert one.product() == pytest.approx(here.T @ here)
    assert one.product(weight, other) == pytest.approx(here.T @ (weight[:, None] * there))
    assert one.back(vector) == pytest.approx(here.T @ vector)
    assert one.along(direction) == pytest.approx(here @ direction)
    assert one.along(direction[:, 0]) == pytest.approx(here @ direction[:, 0])
    assert dense(one.mixed(weight, other)) == pytest.approx(
        weight[:, None] * here + (1.0 - weight)[:, None] * there
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
