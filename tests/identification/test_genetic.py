"""The genetic algorithm, judged on functions whose minimum is known."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.numerics.optimisers import GeneticAlgorithm
from identification.recording import Array


def search(low: float, high: float, size: int, seed: int, generations: int) -> GeneticAlgorithm:
    return GeneticAlgorithm([low] * size, [high] * size, np.random.default_rng(seed), generations)


def run(ga: GeneticAlgorithm, cost: Callable[[Array], Array]) -> list[float]:
    history = []
    while not ga.stop:
        costs = cost(ga.ask())
        ga.tell(costs)
        history.append(ga.best_cost)
        assert ga.best_cost == min(*history, float(np.min(costs)))
    return history


def sphere(x: Array) -> Array:
    return np.asarray(np.sum((x - np.array([1.0, -2.0, 0.5])) ** 2, axis=1))


@pytest.mark.parametrize("seed", range(2))
def test_finds_the_minimum_of_a_convex_function(seed: int) -> None:
    ga = search(-5.0, 5.0, 3, seed, 400)
    history = run(ga, sphere)
    assert ga.best == pytest.approx([1.0, -2.0, 0.5], abs=0.3)
    assert ga.best_cost == pytest.approx(float(sphere(ga.best[None])[0]))
    assert np.all(np.diff(history) <= 0.0)


@settings(max_examples=30, deadline=None)
@given(
    low=st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=4),
    width=st.floats(1e-3, 1e3),
    seed=st.integers(0, 1000),
)
def test_every_individual_is_inside_the_box(low, width, seed):
    high = np.array(low) + width
    ga = GeneticAlgorithm(low, high, np.random.default_rng(seed), generations=5)
    while not ga.stop:
        genes = ga.ask()
        assert genes.shape == (40, len(low))
        assert np.all((genes >= low) & (genes <= high))
        ga.tell(np.sum(genes, axis=1))
