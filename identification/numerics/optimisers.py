"""General optimisers over the unit cube, all with one interface, for the comparison of methods.

Each optimiser may use :data:`BUDGET` evaluations of the cost, and may stop earlier by its own
criterion. The start points of an optimiser do not depend on the solution. An optimiser uses only
costs or residuals of the problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from identification.numerics.arrays import Array


@dataclass(frozen=True)
class GeneticSettings:
    """Settings of a search: defaults of the paper (Sec. 4.2), else of the toolbox."""

    population: int = 40  # number of individuals per generation
    # Share of the children, elite individuals excluded, that crossover makes; mutation makes the
    # remaining children.
    crossover_fraction: float = 0.8
    elite: int = 2  # number of best individuals that pass to the next generation unchanged
    # Standard deviation of the first generation's mutation over the width of the box.
    mutation_scale: float = 1.0
    # Share by which the standard deviation of the mutation falls, linearly, up to the last
    # generation.
    mutation_shrink: float = 1.0
    # Number of generations, the first random generation included, after which the search stops.
    generations: int = 1000

    def __post_init__(self) -> None:
        if (
            not 0 <= self.elite < self.population
            or not 0.0 <= self.crossover_fraction <= 1.0
            or self.generations < 1
        ):
            raise ValueError(
                f"population {self.population}, elite {self.elite}, crossover fraction "
                f"{self.crossover_fraction}, generations {self.generations}: need 0 <= elite < "
                f"population, a fraction in 0..1 and at least 1 generation"
            )


class GeneticAlgorithm:
    """Minimise a cost over a box: ``costs = f(ga.ask()); ga.tell(costs)`` is repeated until
    ``ga.stop``.

    Args:
        low: Lower bounds, shape (d,).
        high: Upper bounds, shape (d,); above ``low``.
        rng: Source of all randomness.
        settings: Population, operators and number of generations, or None for the settings of the
            paper.
    """

    def __init__(
        self,
        low: ArrayLike,
        high: ArrayLike,
        rng: np.random.Generator,
        settings: GeneticSettings | None = None,
    ) -> None:
        self.low = np.array(low, dtype=float)
        self.high = np.array(high, dtype=float)
        if self.low.ndim != 1 or self.low.shape != self.high.shape or self.low.size == 0:
            raise ValueError(
                f"bounds have shapes {self.low.shape} and {self.high.shape}; give two arrays of "
                "one shape (d,)"
            )
        if not np.all(np.isfinite(self.low) & np.isfinite(self.high) & (self.low < self.high)):
            raise ValueError(
                f"lower bounds {self.low} must be finite and below the upper bounds {self.high}"
            )
        settings = settings or GeneticSettings()
        bred = settings.population - settings.elite
        self.generations = settings.generations
        self.generation = 0
        self.best = np.full(self.low.size, np.nan)
        self.best_cost = np.inf
        self._elite = settings.elite
        self._crossed = round(settings.crossover_fraction * bred)
        self._mutants = bred - self._crossed
        self._scale = settings.mutation_scale
        self._shrink = settings.mutation_shrink
        self._rng = rng
        self._genes = rng.uniform(self.low, self.high, (settings.population, self.low.size))

    @property
    def stop(self) -> bool:
        """Whether all generations are done."""
        return self.generation >= self.generations

    def ask(self) -> Array:
        """Return the individuals to be evaluated, shape (population, d)."""
        return self._genes.copy()

    def tell(self, costs: ArrayLike) -> None:
        """Accept the costs of the individuals that :meth:`ask` returned last, and compute the next
        generation.

        Args:
            costs: Shape (population,); infinite for an individual that cannot be evaluated.
        """
        judged = np.asarray(costs, dtype=float)
        if judged.shape != (len(self._genes),):
            raise ValueError(f"costs have shape {judged.shape}; expected ({len(self._genes)},)")
        if np.isnan(judged).any():
            raise ValueError("a cost is NaN; give inf for an individual that cannot be evaluated")
        order = np.argsort(judged, kind="stable")
        if judged[order[0]] < self.best_cost:
            self.best_cost = float(judged[order[0]])
            self.best = self._genes[order[0]].copy()
        self.generation += 1
        self._genes = self._breed(self._genes[order])

    def _breed(self, ranked: Array) -> Array:
        """Return the next generation from the individuals ``ranked``, best first."""
        parents = ranked[_select(len(ranked), 2 * self._crossed + self._mutants, self._rng)]
        mothers, fathers = parents[: self._crossed], parents[self._crossed : 2 * self._crossed]
        inherit = self._rng.random(mothers.shape) < 0.5
        children = np.where(inherit, mothers, fathers)
        deviation = (
            self._scale
            * (1.0 - self._shrink * self.generation / self.generations)
            * (self.high - self.low)
        )
        originals = parents[2 * self._crossed :]
        mutants = originals + deviation * self._rng.standard_normal(originals.shape)
        return np.vstack([ranked[: self._elite], children, _reflect(mutants, self.low, self.high)])


def _select(
    count: int, wanted: int, rng: np.random.Generator
) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return ``wanted`` shuffled ranks by stochastic uniform selection on rank-scaled fitness."""
    expectation = 1.0 / np.sqrt(np.arange(1, count + 1))
    line = np.cumsum(expectation) / expectation.sum()
    line[-1] = 1.0
    marks = (rng.random() + np.arange(wanted)) / max(wanted, 1)
    chosen = np.searchsorted(line, marks, side="right").astype(np.intp)
    return rng.permutation(chosen)


def _reflect(genes: Array, low: Array, high: Array) -> Array:
    """Return the genes reflected back into the box, repeatedly if needed."""
    width = high - low
    folded = np.mod(genes - low, 2.0 * width)
    return np.clip(low + np.minimum(folded, 2.0 * width - folded), low, high)


POPULATION, GENERATIONS = 40, 1000
"""Settings of the genetic algorithm (paper, Sec. 4.2)."""
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
