"""The optimisers of ``rig identify --compare``, each applied to a :class:`StageProblem`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from identification.estimate.equation_error import variable_projection as projection
from identification.estimate.paper_method.stage_problem import StageProblem
from identification.numerics.arrays import Array
from identification.numerics.optimisers import (
    cma_es,
    differential_evolution,
    genetic_algorithm,
    multi_start,
)

Optimiser = Callable[[StageProblem, np.random.Generator], Array]
"""Function of a problem and a random generator that returns the best point in the unit cube."""


def variable_projection(problem: StageProblem, rng: np.random.Generator) -> Array:
    """Search the Stribeck speed alone, as the default method does; linear least squares give the
    other coordinates.
    """
    solution = projection.solve(problem.design, problem.low[2], problem.high[2])
    return problem.unlinear(solution.omega_s, solution.coefficients)


OPTIMISERS: Mapping[str, Optimiser] = {
    "variable projection": variable_projection,
    "genetic algorithm": genetic_algorithm,
    "differential evolution": differential_evolution,
    "CMA-ES": cma_es,
    "multi-start least squares": multi_start,
}
"""The optimisers by name; the default method uses the first of them."""
