"""The unloaded fit of the likelihood: tries start values of the inertia until one succeeds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.inertia.estimating_equations import SOLVED, equations_chi2, solve
from identification.estimate.likelihood.searches import STARTS, refine, spent
from identification.estimate.likelihood.starts import breakaway_starts
from identification.filter.likelihood import Point
from identification.model.parameters import INERTIA, MC, OMEGA_SF, SYSTEM_RISE

_Free = tuple[Sequence[int], Sequence[int]]
"""Indices of the free parameters in two parts: the parameters that least squares estimate, and the
inertia; the second part is empty if the inertia is fixed.
"""
_AGAIN = 2
"""Greatest number of further attempts that start from the best end if no start point leads to a
solution; no attempt follows one that brings no improvement.
"""
_INERTIAS = (1.0, 0.8, 0.6, 1.25)
"""Start values of the inertia, relative to the inertia of the equation error, which noise biases
upward.
"""
_FAR = (3.0, 10.0, 30.0, 100.0, 0.3, 0.1)
"""Further start values of the inertia, relative to the inertia of the equation error, which are
tried if no other start point leads to a solution. In short, fast slips the equation error may give
a fiftieth of the true inertia.
"""


@dataclass(frozen=True, eq=False)
class Solved:
    """End point of one attempt to solve the unloaded fit.

    Attributes:
        chi2: Chi-square of the estimating equations (M29).
        point: Point at which the attempt ended.
    """

    chi2: float
    point: Point


def solve_unloaded(
    begun: Point, system: Sequence[int], inertia: Sequence[int]
) -> tuple[Solved, tuple[float, ...]]:
    """Solve the unloaded fit from one start point after another, until the estimating equations are
    solved.

    Several start values of the inertia are needed: least squares with fixed inertia lead into the
    basin that belongs to this inertia, and the inertia of the equation error may be wrong by half
    or more.

    Args:
        begun: Point at the equation error's values.
        system: Indices of the free parameters except the inertia.
        inertia: Index of the inertia, if it is free.

    Returns:
        The best end, and the chi-square of every solution.

    Raises:
        numpy.linalg.LinAlgError: The instruments do not determine the parameters from any start.
    """
    free = system, inertia
    both = bool(system) and bool(inertia)
    at_system = begun.freeing(system)

    def starts() -> Iterator[Point]:
        yield from (_heavier(begun, share) for share in (_INERTIAS if inertia else (1.0,)))
        searched = breakaway_starts(at_system, MC, SYSTEM_RISE, OMEGA_SF) if system else []
        for start in searched[:STARTS]:
            yield from (_heavier(start, share) for share in _INERTIAS[: len(inertia) * 3])

    found: list[float] = []
    best = _best_of(starts(), free, None, found)
    last: Solved | None = None
    for _ in range(_AGAIN if both else 0):
        if best is None or best is last or best.chi2 < SOLVED or spent(begun):
            break
        last = best
        again = replace(best.point, noise=begun.noise)
        best = _best_of([again], free, best, found)
    if both and (best is None or not best.chi2 < SOLVED) and not spent(begun):
        best = _best_of(_far(at_system), free, best, found)
    if best is None:
        raise np.linalg.LinAlgError("no start of the search leads to a solution")
    return best, tuple(found)


def _heavier(point: Point, share: float) -> Point:
    """Return the point with the inertia multiplied by the factor ``share``."""
    vector = point.vector.copy()
    vector[INERTIA] *= share
    return replace(point, vector=vector)


def _far(point: Point) -> Iterator[Point]:
    """Yield start points at inertias far from that of the equation error, each with the likeliest
    breakaway times.
    """
    for share in _FAR:
        yield from breakaway_starts(_heavier(point, share), MC, SYSTEM_RISE, OMEGA_SF)[:1]


def _best_of(
    starts: Iterable[Point], free: _Free, best: Solved | None, found: list[float]
) -> Solved | None:
    """Try one start point after another until the estimating equations are solved; return the best
    end, which may be ``best``.

    Args:
        starts: Start points, tried in turn.
        free: Free parameters.
        best: The best end so far.
        found: List to which the chi-square of every attempt is appended.
    """
    for number, start in enumerate(starts):
        if (best is not None and best.chi2 < SOLVED) or (spent(start) and (best or number)):
            break
        solved = _solved_from(start, free)
        if solved is not None:
            found.append(solved.chi2)
            if best is None or solved.chi2 < best.chi2:
                best = solved
    return best


def _solved_from(start: Point, free: _Free) -> Solved | None:
    """Return the solution of the unloaded fit from one start, or None if the solution fails."""
    system, inertia = free
    point = start.freeing(system)
    try:
        if system:
            point = refine(point, (1.0,)).point
        point = point.freeing((*system, *inertia))
        if point.free:
            point = solve(point)
        chi2 = equations_chi2(point) if point.free else 0.0
    except np.linalg.LinAlgError:
        # If static and Coulomb friction are equal, the Stribeck speed is undetermined; from slips
        # alone the equation error may find such values.
        return None
    return Solved(chi2, point) if math.isfinite(chi2) else None
