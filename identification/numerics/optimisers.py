"""General optimisers over the unit cube, all with one interface, for the comparison of methods.

Each optimiser may use :data:`BUDGET` evaluations of the cost, and may stop earlier by its own
criterion. The start points of an optimiser do not depend on the solution. An optimiser uses only
costs or residuals of the problem.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from identification.numerics.arrays import Array

POPULATION, GENERATIONS = 40, 1000
"""Settings of the genetic algorithm (paper, Sec. 4.2); the others are those of the toolbox."""
_ELITE = 2  # number of best individuals that pass to the next generation unchanged
_CROSSED = round(0.8 * (POPULATION - _ELITE))
"""Number of children that crossover makes; mutation makes the remaining children."""


class GeneticAlgorithm:
    """Minimise a cost over a box: ``costs = f(ga.ask()); ga.tell(costs)`` is repeated until
    ``ga.stop``.

    Args:
        low: Lower bounds, shape (d,).
        high: Upper bounds, shape (d,); above ``low``.
        rng: Source of all randomness.
        generations: Number of generations, the first random generation included, after which the
            search stops.
    """

    def __init__(
        self,
        low: ArrayLike,
        high: ArrayLike,
        rng: np.random.Generator,
        generations: int = GENERATIONS,
    ) -> None:
        self.low = np.array(low, dtype=float)
        self.high = np.array(high, dtype=float)
        self.generations = generations
        self.generation = 0
        self.best = np.full(self.low.size, np.nan)
        self.best_cost = np.inf
        self._rng = rng
        self._genes = rng.uniform(self.low, self.high, (POPULATION, self.low.size))

    @property
    def stop(self) -> bool:
        """Whether all generations are done."""
        return self.generation >= self.generations

    def ask(self) -> Array:
        """Return the individuals to be evaluated, shape (population, d)."""
        return self._genes.copy()

    def tell(self, costs: Array) -> None:
        """Accept the costs of the individuals that :meth:`ask` returned last, shape (population,),
        and compute the next generation.
        """
        order = np.argsort(costs, kind="stable")
        if costs[order[0]] < self.best_cost:
            self.best_cost = float(costs[order[0]])
            self.best = self._genes[order[0]].copy()
        self.generation += 1
        self._genes = self._breed(self._genes[order])

    def _breed(self, ranked: Array) -> Array:
        """Return the next generation from the individuals ``ranked``, best first.

        The standard deviation of the mutation falls linearly from the width of the box in the first
        generation to zero in the last.
        """
        mutants = POPULATION - _ELITE - _CROSSED
        parents = ranked[_select(POPULATION, 2 * _CROSSED + mutants, self._rng)]
        mothers, fathers = parents[:_CROSSED], parents[_CROSSED : 2 * _CROSSED]
        inherit = self._rng.random(mothers.shape) < 0.5
        children = np.where(inherit, mothers, fathers)
        deviation = (1.0 - self.generation / self.generations) * (self.high - self.low)
        originals = parents[2 * _CROSSED :]
        mutated = originals + deviation * self._rng.standard_normal(originals.shape)
        return np.vstack([ranked[:_ELITE], children, _reflect(mutated, self.low, self.high)])


def _select(
    count: int, wanted: int, rng: np.random.Generator
) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return ``wanted`` shuffled ranks by stochastic uniform selection on rank-scaled fitness."""
    expectation = 1.0 / np.sqrt(np.arange(1, count + 1))
    line = np.cumsum(expectation) / expectation.sum()
    line[-1] = 1.0
    marks = (rng.random() + np.arange(wanted)) / wanted
    chosen = np.searchsorted(line, marks, side="right").astype(np.intp)
    return rng.permutation(chosen)


def _reflect(genes: Array, low: Array, high: Array) -> Array:
    """Return the genes reflected back into the box, repeatedly if needed."""
    width = high - low
    folded = np.mod(genes - low, 2.0 * width)
    return np.clip(low + np.minimum(folded, 2.0 * width - folded), low, high)


BUDGET = POPULATION * GENERATIONS  # greatest number of evaluations of the cost by an optimiser
STARTS = 20  # number of random starts of the least-squares optimiser
_FIRST_SIGMA = 0.3  # share of the box, as the CMA-ES tutorial advises (Hansen, arXiv:1604.00772)


class BoxProblem(Protocol):
    """A cost over the unit cube."""

    @property
    def size(self) -> int:
        """Number of coordinates, d."""

    def costs(self, x: Array, /) -> Array:
        """Return the cost of every row of ``x``, shape (p, d), as shape (p,)."""

    def residuals(self, x: Array, /) -> Array:
        """Return the residuals at ``x``, shape (d,); the cost is the root of their squares' sum."""


def genetic_algorithm(problem: BoxProblem, rng: np.random.Generator) -> Array:
    """The genetic algorithm of the paper (Sec. 4.2), with the paper's settings."""
    zeros, ones = np.zeros(problem.size), np.ones(problem.size)
    search = GeneticAlgorithm(zeros, ones, rng)
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
    """CMA-ES of the ``cmaes`` library with its default settings, from the centre of the box."""
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
    """Bounded least squares of SciPy from random starts in the box; the best of all."""
    best, least = np.full(problem.size, 0.5), np.inf
    for start in rng.uniform(0.0, 1.0, (STARTS, problem.size)):
        found = optimize.least_squares(problem.residuals, start, bounds=(0.0, 1.0))
        if found.cost < least:
            best, least = found.x, float(found.cost)
    return best
