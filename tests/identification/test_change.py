"""The test for drift and steps over histories of constants: its rate of false alarms and power."""

import numpy as np
import pytest

from identification.numerics.spread import LEAST_RUNS, ChangeTest

CONSTANTS, RUNS = 9, 10
SIGMA = 1.0
WIDTH = 2.0 * 1.6448536 * SIGMA
"""Width of a 90 % interval."""


@pytest.fixture(scope="module")
def judge() -> ChangeTest:
    return ChangeTest(np.full(RUNS, SIGMA), np.random.default_rng(0))


def alarms(judge: ChangeTest, added: np.ndarray, scatter: float = 1.0, seed: int = 1) -> int:
    """Return how many of 100 histories of nine constants raise an alarm at 1 %, with a change of
    one of them.
    """
    rng = np.random.default_rng(seed)
    count = 0
    for _ in range(100):
        values = rng.normal(0.0, scatter * SIGMA, (CONSTANTS, RUNS))
        values[0] += added
        count += min(judge(each).p_value for each in values) * CONSTANTS <= 0.01
    return count


@pytest.mark.parametrize("scatter", [0.5, 1.0, 3.0])
def test_histories_without_change_raise_few_alarms(judge: ChangeTest, scatter: float) -> None:
    assert alarms(judge, np.zeros(RUNS), scatter) <= 5


def test_a_drift_of_three_intervals_over_ten_runs_is_found(judge: ChangeTest) -> None:
    assert alarms(judge, np.linspace(0.0, 3.0 * WIDTH, RUNS)) >= 95


@pytest.mark.parametrize("first", [2, 5, 8])
def test_another_unit_is_found_wherever_it_comes_in(judge: ChangeTest, first: int) -> None:
    assert alarms(judge, 3.0 * WIDTH * (np.arange(RUNS) >= first)) >= 95


def test_kind_place_and_size_are_stated(judge: ChangeTest) -> None:
    quiet = np.random.default_rng(2).normal(0.0, 0.1, RUNS)
    step = judge(quiet + 8.0 * (np.arange(RUNS) >= 4))
    assert step.start == 4
    assert step.size == pytest.approx(8.0, abs=step.half_width)
    drift = judge(quiet - np.linspace(0.0, 12.0, RUNS))
    assert drift.start is None
    assert drift.size == pytest.approx(-12.0, abs=drift.half_width)
    assert drift.half_width == pytest.approx(1.645 / np.sqrt(110.0 / 108.0), rel=1e-3)


def test_an_interval_with_an_estimated_scatter_is_one_of_students_t(judge: ChangeTest) -> None:
    rng, inside, drift = np.random.default_rng(3), 0, np.linspace(0.0, 300.0, RUNS)
    for _ in range(2000):
        found = judge(drift + rng.normal(0.0, 4.0, RUNS))
        inside += abs(found.size - 300.0) <= found.half_width
    # Five standard deviations around 90 %; the quantile of the normal distribution gives 86 %.
    assert inside / 2000 == pytest.approx(0.90, abs=0.034)
    step = 300.0 * (np.arange(RUNS) >= 5)
    residual = np.array([3.0, -3.0] * 2 + [0.0] * 2 + [3.0, -3.0] * 2)
    found = judge(step + residual)
    scatter = np.sqrt(np.sum((step + residual - _fitted_step(step + residual)) ** 2) / 8.0)
    assert found.half_width == pytest.approx(1.8595 * scatter / np.sqrt(2.5), rel=1e-3)


def _fitted_step(values: np.ndarray) -> np.ndarray:
    return np.repeat([values[:5].mean(), values[5:].mean()], 5)


def test_a_poor_value_counts_little() -> None:
    errors = np.full(RUNS, 1.0)
    errors[-1] = 50.0
    judge = ChangeTest(errors, np.random.default_rng(0))
    values = np.zeros(RUNS)
    values[-1] = 60.0
    assert judge(values).p_value > 0.05


def test_too_few_runs_are_refused() -> None:
    with pytest.raises(ValueError, match=f"needs at least {LEAST_RUNS} values"):
        ChangeTest(np.ones(LEAST_RUNS - 1), np.random.default_rng(0))
