"""The genetic algorithm, judged on functions whose minimum is known."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.numerics.optimisers import GeneticAlgorithm, GeneticSettings
from identification.recording import Array


def run(ga: GeneticAlgorithm, cost: Callable[[Array], Array]) -> list[float]:
    history = []
    while not ga.stop:
        ga.tell(cost(ga.ask()))
        history.append(ga.best_cost)
    return history


def sphere(x: Array) -> Array:
    return np.sum((x - np.array([1.0, -2.0, 0.5])) ** 2, axis=1)


def rastrigin(x: Array) -> Array:
    return 10.0 * x.shape[1] + np.sum(x**2 - 10.0 * np.cos(2.0 * np.pi * x), axis=1)


def searcher(seed: int, generations: int) -> GeneticAlgorithm:
    """Return a search over a cube of three coordinates."""
    settings_ = GeneticSettings(generations=generations)
    return GeneticAlgorithm([-5.0] * 3, [5.0] * 3, np.random.default_rng(seed), settings_)


@pytest.mark.parametrize("seed", range(5))
def test_finds_the_minimum_of_a_convex_function(seed: int) -> None:
    ga = GeneticAlgorithm(
        [-5.0] * 3, [5.0] * 3, np.random.default_rng(seed), GeneticSettings(generations=400)
    )
    run(ga, sphere)
    assert ga.best == pytest.approx([1.0, -2.0, 0.5], abs=0.3)
    assert ga.best_cost == pytest.approx(float(sphere(ga.best[None])[0]))


def test_finds_the_basin_of_a_multimodal_function() -> None:
    found = 0
    for seed in range(8):
        ga = GeneticAlgorithm(
            [-5.12] * 2, [5.12] * 2, np.random.default_rng(seed), GeneticSettings(generations=300)
        )
        run(ga, rastrigin)
        found += bool(np.all(np.abs(ga.best) < 0.5))
    assert found >= 7


def test_better_than_random_search() -> None:
    rng = np.random.default_rng(1)
    ga = GeneticAlgorithm([-5.0] * 3, [5.0] * 3, rng, GeneticSettings(generations=200))
    run(ga, sphere)
    assert ga.best_cost < 0.5 * float(np.min(sphere(rng.uniform(-5.0, 5.0, (200 * 40, 3)))))


def test_the_best_never_gets_worse_and_survives_unchanged() -> None:
    ga = GeneticAlgorithm(
        [-5.0] * 3, [5.0] * 3, np.random.default_rng(2), GeneticSettings(generations=50)
    )
    last = np.inf
    while not ga.stop:
        genes = ga.ask()
        costs = sphere(genes)
        assert np.min(costs) <= last
        last = float(np.min(costs))
        ga.tell(costs)
        assert ga.best_cost == last


def test_same_seed_same_search() -> None:
    first, second, other = (
        GeneticAlgorithm(
            [-5.0] * 3, [5.0] * 3, np.random.default_rng(s), GeneticSettings(generations=30)
        )
        for s in (3, 3, 4)
    )
    assert run(first, sphere) == run(second, sphere)
    assert run(other, sphere)[-1] != first.best_cost


@settings(max_examples=30, deadline=None)
@given(
    low=st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=4),
    width=st.floats(1e-3, 1e3),
    scale=st.floats(0.0, 20.0),
    seed=st.integers(0, 1000),
)
def test_every_individual_is_inside_the_box(
    low: list[float], width: float, scale: float, seed: int
) -> None:
    high = np.array(low) + width
    ga = GeneticAlgorithm(
        low, high, np.random.default_rng(seed), GeneticSettings(generations=5, mutation_scale=scale)
    )
    while not ga.stop:
        genes = ga.ask()
        assert genes.shape == (40, len(low))
        assert np.all((genes >= low) & (genes <= high))
        ga.tell(np.sum(genes, axis=1))


def test_an_individual_that_cannot_be_judged_is_never_the_best() -> None:
    ga = GeneticAlgorithm([0.0], [1.0], np.random.default_rng(0), GeneticSettings(generations=20))
    run(ga, lambda x: np.where(x[:, 0] < 0.5, np.inf, x[:, 0]))
    assert ga.best[0] >= 0.5


@pytest.mark.parametrize(
    ("low", "high", "settings_"),
    [
        ([0.0], [0.0], {}),
        ([0.0, 1.0], [1.0], {}),
        ([], [], {}),
        ([0.0], [np.inf], {}),
        ([0.0], [1.0], {"elite": 40}),
        ([0.0], [1.0], {"crossover_fraction": 1.1}),
        ([0.0], [1.0], {"generations": 0}),
    ],
)
def test_settings_that_make_no_search_are_refused(
    low: list[float], high: list[float], settings_: dict
) -> None:
    with pytest.raises(ValueError, match=r"bounds|population"):
        GeneticAlgorithm(low, high, np.random.default_rng(0), GeneticSettings(**settings_))


@pytest.mark.parametrize("costs", [np.zeros(39), np.full(40, np.nan)])
def test_costs_that_make_no_sense_are_refused(costs: Array) -> None:
    ga = GeneticAlgorithm([0.0], [1.0], np.random.default_rng(0))
    with pytest.raises(ValueError, match="cost"):
        ga.tell(costs)
