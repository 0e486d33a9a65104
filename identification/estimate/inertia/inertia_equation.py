"""The inertia's own estimating equation, all else eliminated.

An instrument of the inertia less what those of all else can say of it: to first order the solution is untouched by what
the others are off by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.inertia.half_cycles import Rehearsal
from identification.estimate.inertia.instruments import instruments, rehearsed_instruments
from identification.filter.likelihood import Problem
from identification.filter.noise_level import CLIP
from identification.model.parameters import INERTIA
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.levenberg_marquardt import huber_weight


@dataclass(frozen=True)
class Equation:
    """What the equation makes of each residual.

    Attributes:
        influence: What a unit of each residual takes off the logarithm of the inertia, shape (r,).
        parts: What each residual takes off it, by itself and by its part in others' instruments, shape (r,).
    """

    influence: Array
    parts: Array


def influence_on_inertia(problem: Problem, z: BlockArrow, jacobian: BlockArrow, residual: Array) -> Array:
    """Return what a unit of each residual takes off the logarithm of the inertia, shape (r,)."""
    return z.along(_mixture(problem, z, jacobian, residual))


def _mixture(problem: Problem, z: BlockArrow, jacobian: BlockArrow, residual: Array) -> Array:
    """Return the mixture of instruments that only the inertia moves, by one with its logarithm, shape (p + m,)."""
    j = problem.free.index(INERTIA)
    power = z.product()
    others = np.delete(power, j, axis=0)
    taken = np.linalg.pinv(np.delete(others, j, axis=1), hermitian=True) @ others[:, j]
    alone = np.insert(-taken, j, 1.0)
    return alone / float(z.along(alone) @ (jacobian.parameters[:, j] * huber_weight(residual, CLIP)))


def equation(problem: Problem, z: BlockArrow, jacobian: BlockArrow, residual: Array) -> Equation:
    """Return the inertia's equation by instruments that nothing of the residuals is in."""
    influence = influence_on_inertia(problem, z, jacobian, residual)
    return Equation(influence, influence * residual * huber_weight(residual, CLIP))


def equation_of_strokes(problem: Problem, z: BlockArrow, jacobian: BlockArrow, residual: Array) -> Equation:
    """Return the inertia's equation by instruments of strokes alike, whose sum is one over pairs of stretches.

    A stretch enters twice: by its residuals, and by its sensitivities, which are in the others' instruments (Hoeffding,
    Ann. Math. Statist. 19 (1948) 293).
    """
    j = problem.free.index(INERTIA)
    first = equation(problem, z, jacobian, residual)
    weighted = residual * huber_weight(residual, CLIP)
    columns = np.zeros_like(jacobian.parameters)
    columns[:, j] = weighted
    carrier = replace(jacobian, parameters=columns, own=np.zeros_like(weighted))
    mixed = _mixture(problem, z, jacobian, residual)
    second = jacobian.along(mixed) * instruments(problem, carrier).parameters[:, j]
    second[len(second) - problem.breakaways :] = 0.0
    return replace(first, parts=first.parts + second)


def best(one: Equation, other: Equation) -> Equation:
    """Return the mean of two equations for one unknown that has the least variance, neither counted against."""
    a, b = one.influence, other.influence
    away = a - b
    share = float(np.clip(-(b @ away) / max(float(away @ away), 1e-300), 0.0, 1.0))
    return Equation(b + share * away, other.parts + share * (one.parts - other.parts))


def with_rehearsals(
    problem: Problem, z: BlockArrow, jacobian: BlockArrow, residual: Array, rehearsals: Sequence[Rehearsal]
) -> Equation:
    """Return the mean of the equations by strokes alike and by rehearsals that has the least variance.

    Args:
        problem: At its start.
        z: Its instruments by strokes alike.
        jacobian: d residuals / d x there.
        residual: There.
        rehearsals: None for the strokes' alone.
    """
    strokes = equation_of_strokes(problem, z, jacobian, residual)
    if not rehearsals:
        return strokes
    other = rehearsed_instruments(problem, z, rehearsals)
    return best(strokes, equation(problem, other, jacobian, residual))
