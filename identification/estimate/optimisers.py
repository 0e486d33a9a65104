"""The searches a user may expect, each on a :class:`StageProblem`: the start of none depends on the answer.

Every optimiser has the budget of the paper's genetic algorithm, 1000 generations of 40, and stops earlier by its own
rule. None sees anything but costs or residuals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from cmaes import CMA
from scipy import optimize

from identification.estimate import varpro
from identification.estimate.genetic import GeneticAlgorithm
from identification.estimate.paper import GENERATIONS, POPULATION
from identification.estimate.stage_problem import StageProblem
from identification.recording import Array

BUDGET = POPULATION * GENERATIONS
"""Evaluations per stage at most."""
STARTS = 20
"""Random starts of the least squares."""
_FIRST_SIGMA = 0.3  # of the box, as the CMA-ES tutorial advises (Hansen, arXiv:1604.00772)

Optimiser = Callable[[StageProblem, np.random.Generator], Array]
"""Problem and randomness to the best point found, in the unit cube."""


def variable_projection(problem: StageProblem, rng: np.random.Generator) -> Array:
    """The default method's search: one unknown, the Stribeck speed; the rest is linear."""
    solution = varpro.solve(problem.design, problem.low[2], problem.high[2])
    return problem.unlinear(solution.omega_s, solution.coefficients)


def genetic_algorithm(problem: StageProblem, rng: np.random.Generator) -> Array:
    """The paper's genetic algorithm (Sec. 4.2)."""
    zeros, ones = np.zeros(problem.size), np.ones(problem.size)
    search = GeneticAlgorithm(zeros, ones, population=POPULATION, generations=GENERATIONS, rng=rng)
    while not search.stop:
        search.tell(problem.costs(search.ask()))
    return search.best


def differential_evolution(problem: StageProblem, rng: np.random.Generator) -> Array:
    """SciPy's, with its own settings (best1bin, 15 per coordinate, tolerance 0.01) and no polish."""
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


def cma_es(problem: StageProblem, rng: np.random.Generator) -> Array:
    """CMA-ES of the ``cmaes`` library with its own settings, from the centre of the box."""
    bounds = np.column_stack([np.zeros(problem.size), np.ones(problem.size)])
    search = CMA(np.full(problem.size, 0.5), _FIRST_SIGMA, bounds=bounds, seed=int(rng.integers(1 << 31)))
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


def multi_start(problem: StageProblem, rng: np.random.Generator) -> Array:
    """Bounded trust-region least squares of SciPy from random starts in the box; the best of them counts."""
    best, least = np.full(problem.size, 0.5), np.inf
    for start in rng.uniform(0.0, 1.0, (STARTS, problem.size)):
        found = optimize.least_squares(problem.residuals, start, bounds=(0.0, 1.0))
        if found.cost < least:
            best, least = found.x, float(found.cost)
    return best


OPTIMISERS: Mapping[str, Optimiser] = {
    "variable projection": variable_projection,
    "genetic algorithm": genetic_algorithm,
    "differential evolution": differential_evolution,
    "CMA-ES": cma_es,
    "multi-start least squares": multi_start,
}
"""Name to search; the first is the one that the default method uses."""
