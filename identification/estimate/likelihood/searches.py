"""Searches for the maximum of the likelihood of the loaded fit, from several starts.

Parts: a grid of start points, least squares at raised noise levels, further searches from the
neighbours of the best end, and a list of the basins found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.filter.experiment import Filter
from identification.filter.likelihood import PARAMETER_STEP, Point, Searched
from identification.filter.noise_level import HUBER_THRESHOLD, deviance
from identification.model.parameters import INERTIA, LOAD_RISE, OMEGA_SL
from identification.numerics import levenberg_marquardt as levenberg
from identification.numerics.levenberg_marquardt import huber, negative_log_likelihood
from identification.numerics.two_threads import each

_TEMPERING = (20.0, 8.0, 4.0, 2.0, 1.0)
"""Torque noise levels of the searches of the loaded fit, relative to the estimated level; with
fewer levels the searches miss the best end.
"""
MOST_PASSES = 4000
"""Passes of the filter over the recordings after which a fit starts no further search and returns
its best end. If the model is right, the unloaded and the loaded fit take some hundred passes each,
and 3000 in the worst known case.
"""
STARTS = 3
"""Number of starts from which a search is run; more than one, because the likeliest point of the
grid is not always in the right basin.
"""
_MISSED = 0.8
"""Mean Huber cost of a residual above which the end of a search counts as outside any basin. The
mean cost is 0.26 to 0.55 at true values, and 1.4 or more where a search fails to converge.
"""
_WIDE_STEP = 0.3
"""Relative step of a coordinate (a parameter, or its logarithm) for finite differences, used after
searches that failed to converge.
"""
_SEEKS = 3
"""Greatest number of alternations between a fit and a grid search of the breakaway times."""
_LEAST_GAIN = 0.05
"""Drop of the negative log likelihood by a step, below which a fit ends."""
_LEAST_RESOLVED = 0.05
_BESIDE = (
    ((OMEGA_SL, 2.0), (OMEGA_SL, 0.5), (LOAD_RISE, 0.95), (LOAD_RISE, 1.05)),
    ((OMEGA_SL, 1.08), (OMEGA_SL, 0.92)),
)
"""Neighbours of the best end of the loaded fit, far neighbours and then near ones, each as index of
the parameter and factor on the parameter.
"""
_ROUNDS = 2
"""Greatest number of rounds of searches from far or near neighbours, each round from the best end
so far; the second round follows only if the first finds a better end.
"""
_APART = 0.1
"""Relative difference of the Stribeck speed, or of the rise, above which two ends are in different
basins.
"""
SAME_END = 1.0
"""Difference in deviance up to which two search ends count as equal: half a standard error of one
parameter.
"""
_AS_LIKELY = 4.0
"""Difference in deviance within which recordings do not decide between two ends: two standard
errors.
"""
_SEVERAL = 2.0


@dataclass(frozen=True, eq=False)
class End:
    """End of a search of the loaded fit.

    Attributes:
        unresolved: Whether the Stribeck speed at the end is below the resolution of the samples.
        deviance: Deviance (M24) at the end; infinite if it is not finite.
        point: End point of the search.
    """

    unresolved: bool
    deviance: float
    point: Point

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key; the better end has the lower rank."""
        return self.unresolved, self.deviance


@dataclass(frozen=True, eq=False)
class LoadedFit:
    """Result of the loaded fit.

    Attributes:
        point: The likeliest end.
        drop: Deviance of the likeliest end less the deviance of the likeliest start.
        ends: Ends of all searches, in order.
    """

    point: Point
    drop: float
    ends: tuple[End, ...]

    @property
    def stopped(self) -> bool:
        """Whether the passes were used up (:data:`MOST_PASSES`)."""
        return spent(self.point)


def spent(point: Point) -> bool:
    """Return whether the passes of a point's fit are used up (:data:`MOST_PASSES`)."""
    return point.filter.evaluations >= MOST_PASSES


def refine_from(point: Point, starts: Sequence[Point]) -> LoadedFit:
    """Search the loaded fit from the likeliest starts in turn, or from the point if there are no
    starts.

    If a start is likelier than every end, because the raised noise level led out of its basin, one
    more search runs from this start at the estimated noise level. Ends with a Stribeck speed below
    the resolution of the samples count only if there are no others: at such a speed the rise
    affects no prediction and fits noise.
    """
    starts = list(starts) or [point]
    followed = starts[:STARTS]
    begun = [_deviance(start) for start in followed]
    ends = [_ended(followed[0], _TEMPERING)] if spent(followed[0]) else []
    ends += _ended_each(followed, _TEMPERING)
    left = min(ends, key=lambda end: end.rank).deviance
    likelier = [s for s, there in zip(followed, begun, strict=True) if there < left]
    ends += _ended_each(likelier, (1.0,))
    best = _neighbours(min(ends, key=lambda end: end.rank), ends)
    if _missed(best):
        best = _smoothed(starts, best, ends)
    return LoadedFit(best.point, best.deviance - min(begun), tuple(ends))


def basins(fit: LoadedFit) -> list[Point]:
    """Return the loaded fit's end, then the best ends of other basins, likeliest first.

    Ends with a Stribeck speed below the samples' resolution are omitted.
    """
    found = [fit.point]
    for end in sorted(fit.ends, key=lambda end: end.rank):
        if not end.unresolved and all(_apart(end.point, other) for other in found):
            found.append(end.point)
    return found[:STARTS]


def _apart(one: Point, other: Point) -> bool:
    """Return whether two ends are in different basins, by Stribeck speed and rise of the load
    friction.
    """
    places = [OMEGA_SL, LOAD_RISE]
    away = np.abs(one.vector[places] - other.vector[places])
    return bool(np.any(away > _APART * np.abs(other.vector[places])))


def likeliest_together(starts: Sequence[Point]) -> Searched:
    """Return the start of the joint fit whose search, with the inertia held, has the likeliest end.

    The searches of the loaded fit keep the system parameters fixed. Errors of the system parameters
    can make a wrong basin likelier; a search of all parameters corrects this. Of equally likely
    ends, an end with a several times larger Stribeck speed is preferred, because the likelihood is
    flat where the Stribeck speed is below the resolution of the samples.

    A search ends early if all steps that it may still take, each with the decrease of its last
    step, would not reach the least cost of the searches before it.

    Args:
        starts: Starts of the joint fit, each from an end of the loaded fit.

    Returns:
        The chosen start, not its end, and the iterations of all searches.
    """
    ends, iterations, reached = [], 0, math.inf
    for start in starts:
        found = _likelihood(start.freeing([k for k in start.free if k != INERTIA]), reach=reached)
        iterations += found.iterations
        reached = min(reached, _cost(found.point))
        speed = float(found.point.vector[OMEGA_SL])
        ends.append((not _resolved(found.point), _deviance(found.point), speed))
    unresolved, least, speed = best = min(ends)
    slower = [
        e
        for e in ends
        if e[0] == unresolved and e[1] < least + _AS_LIKELY and e[2] > _SEVERAL * speed
    ]
    taken = ends.index(max(slower, key=lambda e: e[2], default=best))
    return Searched(starts[taken], iterations)


def _cost(point: Point) -> float:
    """Return the cost that a search by likelihood lowers; infinite if it is not finite."""
    cost = negative_log_likelihood(*point.predictions(point.origin()), HUBER_THRESHOLD)
    return cost if math.isfinite(cost) else math.inf


def _missed(end: End) -> bool:
    """Return whether an end explains the recordings far worse than their noise allows."""
    residual = end.point.weighted().residuals(end.point.origin())
    return bool(np.mean(huber(residual, HUBER_THRESHOLD)) > _MISSED)


def _smoothed(starts: Sequence[Point], best: End, ends: list[End]) -> End:
    """Search from the starts with finite differences over wide steps, until an end explains the
    recordings; return the best end.

    Far from the true values the model in the filter may stick and slip in slow ramps. The
    prediction errors then depend irregularly on the parameters: finite differences over small steps
    give slopes a hundred times as large as those over wide steps, and no useful direction.

    Args:
        starts: Starts of the searches.
        best: The best end so far.
        ends: List to which the ends of the searches are appended.
    """
    before = best
    for start in starts:
        if spent(start):
            break
        ends.append(_ended(start, _TEMPERING, _WIDE_STEP))
        best = min(best, ends[-1], key=lambda end: end.rank)
        if not _missed(best):
            break
    return best if best is before else _neighbours(best, ends)


def _neighbours(best: End, ends: list[End]) -> End:
    """Search again from neighbours of an end, with new breakaway times; return the likeliest end
    found.

    Parameters and breakaway times are coupled, so that a search may end where neither a change of
    parameters alone nor a change of breakaway times alone lowers the cost.

    Args:
        best: The end.
        ends: List to which the ends of the searches are appended.
    """
    for beside in _BESIDE:
        for _ in range(_ROUNDS):
            begun = best
            starts = [
                _multiplied(begun.point, place, factor)
                for place, factor in beside
                if place in best.point.free
            ]
            found = _ended_each(starts, (1.0,))
            ends += found
            best = min((best, *found), key=lambda end: end.rank)
            if begun.deviance - best.deviance < SAME_END:
                break
    return best


def _multiplied(begun: Point, place: int, factor: float) -> Point:
    """Return the point with one parameter multiplied by a factor."""
    vector = begun.vector.copy()
    vector[place] *= factor
    return begun.at(vector)


def _ended_each(starts: Sequence[Point], tempering: Sequence[float]) -> list[End]:
    """Search from several points of one fit, two at a time; return the ends in order, without those
    of searches for which no passes are left after the searches before them.
    """

    def alone(start: Point) -> tuple[End, int]:
        own = replace(start, filter=Filter(start.experiment))
        end = _ended(own, tempering)
        return replace(end, point=replace(end.point, filter=start.filter)), own.filter.evaluations

    ends = []
    for start, (end, evaluations) in zip(starts, each(alone, starts), strict=True):
        if not spent(start):
            start.filter.evaluations += evaluations
            ends.append(end)
    return ends


def _ended(start: Point, tempering: Sequence[float], step: float = PARAMETER_STEP) -> End:
    """Search from a point and return the end."""
    point = refine(start, tempering, step).point
    return End(not _resolved(point), _deviance(point), point)


def _deviance(point: Point) -> float:
    """Return the deviance at a point; infinite if it is not finite."""
    found = deviance(*point.run())
    return found if math.isfinite(found) else math.inf


def _resolved(point: Point) -> bool:
    """Return whether the samples resolve the load Stribeck speed, that is, whether this speed is
    above a share of the speed that the joint gains within one period by the fall of load friction.
    """
    p = point.vector
    moment = float(np.median(np.concatenate([m.breakaway_moment for m in point.motions])))
    period = max(m.recording.period for m in point.motions)
    return bool(p[OMEGA_SL] > _LEAST_RESOLVED * moment * p[LOAD_RISE] * period / p[INERTIA])


def refine(
    point: Point, tempering: Sequence[float] = _TEMPERING, step: float = PARAMETER_STEP
) -> Searched:
    """Search by least squares at decreasing noise levels, then by likelihood at the estimated
    level.

    Least squares at noise levels above the estimated level lead the search into the basin of the
    maximum. At the estimated level the likelihood is needed: the standard deviations depend on the
    parameters, and least squares with constant weights miss the maximum of the likelihood.

    Args:
        point: Start of the search.
        tempering: Torque noise level of each search, relative to the estimated level.
        step: Relative step for finite differences at raised noise.
    """
    iterations = 0
    for factor in tempering:
        louder = replace(point, noise=point.noise.louder(factor))
        found = _least_squares(louder, step) if factor > 1.0 else _likelihood(louder)
        point = replace(found.point, noise=point.noise)
        iterations += found.iterations
    return Searched(point, iterations)


def _least_squares(point: Point, step: float) -> Searched:
    """Search by least squares with the standard deviations of the start."""
    held = point.weighted(step)
    found = levenberg.minimise(
        held.residuals,
        held.jacobian,
        point.origin(),
        threshold=HUBER_THRESHOLD,
        tolerance=1e-4,
    )
    return Searched(point.moved(found.x), found.steps)


def _likelihood(point: Point, reach: float = math.inf) -> Searched:
    """Search by likelihood, in alternation with a grid search of the breakaway times.

    Args:
        point: Start.
        reach: Cost that the search should reach.
    """
    iterations = 0
    for _ in range(_SEEKS):
        found = levenberg.minimise_deviance(
            point.predictions,
            point.derivatives,
            point.origin(),
            threshold=HUBER_THRESHOLD,
            tolerance=_LEAST_GAIN,
            reach=reach,
        )
        iterations += found.steps
        there = point.moved(found.x)
        point, moved = there.weighted().with_best_breakaways(HUBER_THRESHOLD)
        if found.beaten or not moved:
            break
    return Searched(point, iterations)
