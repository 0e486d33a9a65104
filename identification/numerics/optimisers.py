"""General optimisers over the unit cube, all with one interface, for the comparison of methods.

Each optimiser may use :data:`BUDGET` evaluations of the cost, and may stop earlier by its own
criterion. The start points of an optimiser do not depend on the solution. An optimiser uses only
costs or residuals of the problem.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy import optimize

from identification.numerics.arrays import Array
from identification.numerics.genetic_algorithm import GeneticAlgorithm, GeneticSettings

POPULATION, GENERATIONS = 40, 1000
"""Settings of the genetic algorithm (paper, Sec. 4.2)."""
BUDGET = POPULATION * GENERATIONS
"""Greatest number of evaluations of the cost by an optimiser."""
STARTS = 20
"""Number of random starts of the least-squares optimiser."""
_FIRST_SIGMA = 0.3  # share of the box, as the CMA-ES tutorial advises (Hansen, arXiv:1604.00772)


class BoxProblem(Protocol):
    """A cost over the unit cube."""

    @property
    def size(self) -> int:
        """Number of coordinates, d."""

    def costs(self, x: Array, /) -> Array:
        """Return the cost of every row of ``x``, shape (p, d), as shape (p,)."""

    def residuals(self, x: Array, /) -> Array:
        """Return the residuals at ``x``, shape (d,); the cost is the square root of the sum of
        squares of the residuals.
        """


def genetic_algorithm(problem: BoxProblem, rng: np.random.Generator) -> Array:
    """The genetic algorithm of the paper (Sec. 4.2), with the paper's settings."""
    zeros, ones = np.zeros(problem.size), np.ones(problem.size)
    settings = GeneticSettings(population=POPULATION, generations=GENERATIONS)
    search = GeneticAlgorithm(zeros, ones, rng, settings)
    while not search.stop:
        search.tell(problem.costs(search.ask()))
    return search.best


def differential_evolution(problem: BoxProblem, rng: np.random.Generator) -> Array:
    """Differential evolution of SciPy with SciPy's default settings (best1bin, 15 individuals per
    coordinate, tolerance 0.01), without the final local search ("polish").
    """
    found = optimize.differential_evolution(
        lambda x: problem.costs(x.T),
        optimize.Bounds(np.zeros(problem.size), np.ones(problem.size)),
        vectorized=True,
        updating="deferred",
        polish=False,
        maxiter=BUDGET // (15 * problem.size) - 1,
        rng=rng,
    )
    return np.asarray(found.x)


def cma_es(problem: BoxProblem, rng: np.random.Generator) -> Array:
    """CMA-ES of the ``cmaes`` library with the default settings of the library, from the centre of
    the box.
    """
    bounds = np.column_stack([np.zeros(problem.size), np.ones(problem.size)])
    # Imported late: the library imports scipy.stats, which an identification does not need.
    from cmaes import CMA

    search = CMA(
        np.full(problem.size, 0.5), _FIRST_SIGMA, bounds=bounds, seed=int(rng.integers(1 << 31))
    )
    best, least, spent = np.full(problem.size, 0.5), np.inf, 0
    while not search.should_stop() and spent < BUDGET:
        points = np.array([search.ask() for _ in range(search.population_size)])
        costs = problem.costs(points)
        spent += len(points)
        k = int(np.argmin(costs))
        if costs[k] < least:
            best, least = points[k], float(costs[k])
        search.tell([(point, float(cost)) for point, cost in zip(points, costs, strict=True)])
    return best


def multi_start(problem: BoxProblem, rng: np.random.Generator) -> Array:
    """Bounded trust-region least squares of SciPy from random start points in the box; the result
    is the best of all starts.
    """
    best, least = np.full(problem.size, 0.5), np.inf
    for start in rng.uniform(0.0, 1.0, (STARTS, problem.size)):
        found = optimize.least_squares(problem.residuals, start, bounds=(0.0, 1.0))
        if found.cost < least:
            best, least = found.x, float(found.cost)
    return best
