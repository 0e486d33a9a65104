"""Damped searches: Huber's cost and the likelihood that goes with it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from identification.numerics.least_squares import Minimum, minimise, minimise_deviance
from identification.recording import Array

SAMPLES = 400
NEVER = 1e9


def drawn(seed: int) -> Array:
    return 3.0 + 0.5 * np.random.default_rng(seed).normal(size=SAMPLES)


def predictions_of(data: Array) -> tuple[object, object]:
    """Errors from a mean x0 with deviation exp(x1), and their derivatives."""

    def predictions(x: Array) -> tuple[Array, Array]:
        return x[0] - data, np.full(len(data), np.exp(x[1]))

    def derivatives(x: Array, _errors: Array, deviations: Array) -> tuple[Array, Array]:
        nothing = np.zeros(len(data))
        return np.column_stack([1.0 / deviations, nothing]), np.column_stack(
            [nothing, np.ones(len(data))]
        )

    return predictions, derivatives


@pytest.mark.parametrize("seed", range(5))
def test_the_likeliest_mean_and_deviation_have_their_closed_form(seed: int) -> None:
    data = drawn(seed)
    found = minimise_deviance(
        *predictions_of(data), np.array([0.0, 1.0]), threshold=NEVER, tolerance=1e-12
    )  # type: ignore[arg-type]
    assert found.x[0] == pytest.approx(np.mean(data), rel=1e-6)
    assert np.exp(found.x[1]) == pytest.approx(np.std(data), rel=1e-5)
    assert found.cost == pytest.approx(SAMPLES * (0.5 + np.log(np.std(data))), rel=1e-9)


def test_a_search_that_would_not_reach_another_ends_early() -> None:
    data = drawn(0)

    def search(reach: float) -> Minimum:
        return minimise_deviance(
            *predictions_of(data),
            np.array([0.0, 1.0]),
            threshold=NEVER,
            tolerance=1e-12,
            reach=reach,
        )  # type: ignore[arg-type]

    whole = search(math.inf)
    reached, missed = search(whole.cost), search(whole.cost - 1e6)
    assert (reached.steps, reached.cost, reached.beaten) == (whole.steps, whole.cost, False)
    assert missed.beaten
    assert missed.steps < whole.steps
    assert missed.cost > whole.cost


def test_a_mean_that_its_deviation_tells_better_than_itself_is_found_by_the_deviation() -> None:
    """Of samples around zero whose deviation is x, squares hold all there is to know; held weights
    would hold none.
    """
    data = 2.0 * np.random.default_rng(1).normal(size=SAMPLES)

    def predictions(x: Array) -> tuple[Array, Array]:
        return data, np.full(SAMPLES, x[0])

    def derivatives(x: Array, _errors: Array, deviations: Array) -> tuple[Array, Array]:
        return np.zeros((SAMPLES, 1)), 1.0 / deviations[:, None]

    found = minimise_deviance(
        predictions, derivatives, np.array([1.0]), threshold=NEVER, tolerance=1e-12
    )
    assert found.x[0] == pytest.approx(np.sqrt(np.mean(data**2)), rel=1e-6)


def test_an_outlier_pulls_no_more_than_its_threshold() -> None:
    data = drawn(0)
    spoilt = np.concatenate([data, [1e6]])

    def centre(values: Array) -> float:
        found = minimise(
            lambda x: (x[0] - values) / 0.5,
            lambda x, _: np.full((len(values), 1), 2.0),
            np.array([0.0]),
            threshold=4.0,
            tolerance=1e-12,
        )
        return float(found.x[0])

    assert centre(spoilt) - centre(data) == pytest.approx(4.0 * 0.5 / SAMPLES, rel=0.05)


def test_a_cost_that_is_no_number_ends_the_search() -> None:
    found = minimise(
        lambda x: np.array([math.nan, x[0]]),
        lambda _x, _r: np.array([[0.0], [1.0]]),
        np.ones(1),
        threshold=1.0,
        tolerance=1e-4,
    )
    assert math.isnan(found.cost)
    assert found.x == pytest.approx(np.ones(1))
