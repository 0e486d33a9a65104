"""Searches for the maximum of the likelihood of the loaded fit, from several starts.

A fit consists of a grid of start points, least squares at raised noise levels, further searches
from neighbours of the best end, and a list of the basins that were found.
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
"""Number of filter runs over the recordings (passes) after which a fit starts no further search and
returns its best end. If the model is right, the unloaded and the loaded fit take some hundred
passes each, and 3000 passes in the worst known case.
"""
STARTS = 3
"""Number of start points from which a search is run; more than one, because the likeliest point of
the grid is not always in the basin of the true values.
"""
_MISSED = 0.8
"""Mean Huber cost of a residual above which a search counts as not converged. The mean cost is 0.26
to 0.55 at true values, and 1.4 or more if a search does not converge.
"""
_WIDE_STEP = 0.3
"""Relative step of a coordinate (a parameter, or its logarithm) for finite differences, used after
searches that failed to converge.
"""
_SEEKS = 3
"""Greatest number of alternations between a fit and a grid search of the breakaway times."""
_LEAST_GAIN = 0.05
"""Decrease of the negative log likelihood in a step, below which a fit ends."""
_LEAST_RESOLVED = 0.05
_BESIDE = (
    ((OMEGA_SL, 2.0), (OMEGA_SL, 0.5), (LOAD_RISE, 0.95), (LOAD_RISE, 1.05)),
    ((OMEGA_SL, 1.08), (OMEGA_SL, 0.92)),
)
"""Neighbours of the best end of the loaded fit, first far neighbours and then near neighbours, each
as index of a parameter and factor on this parameter.
"""
_ROUNDS = 2
"""Greatest number of rounds of searches from neighbours of the best end so far; a second round
follows only if the first round finds a better end.
"""
_APART = 0.1
"""Relative difference of the Stribeck speed, or of the rise, above which two ends are in different
basins.
"""
SAME_END = 1.0
"""Difference in deviance up to which two search ends count as equal; it corresponds to a change of
one parameter by one standard error.
"""
_AS_LIKELY = 4.0
"""Difference in deviance up to which the recordings do not decide between two ends; it corresponds
to a change of one parameter by two standard errors.
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
        """Sort key; the better of two ends has the lower rank."""
        return self.unresolved, self.deviance


@dataclass(frozen=True, eq=False)
class LoadedFit:
    """Result of the loaded fit.

    Attributes:
        point: The likeliest end.
        drop: Deviance of the likeliest end less the deviance of the likeliest start.
        ends: Ends of all searches, in the order of the searches.
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
    """Search the loaded fit from the likeliest start points in turn, or from ``point`` if there are
    no start points.

    If a start point is likelier than every end, because the search at a raised noise level left the
    basin of the start point, one more search runs from this start point at the estimated noise
    level. Ends with a Stribeck speed below the resolution of the samples are used only if there are
    no other ends: below the resolution the rise affects no prediction and fits noise.
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
    """Return the end of the loaded fit, then the best end of each other basin, likeliest first.

    Ends with a Stribeck speed below the samples' resolution are omitted.
    """
    found = [fit.point]
    for end in sorted(fit.ends, key=lambda end: end.rank):
        if not end.unresolved and all(_apart(end.point, other) for other in found):
            found.append(end.point)
    return found[:STARTS]


def _apart(one: Point, other: Point) -> bool:
    """Return whether two ends are in different basins, that is, differ in the Stribeck speed or the
    rise of the load friction.
    """
    places = [OMEGA_SL, LOAD_RISE]
    away = np.abs(one.vector[places] - other.vector[places])
    return bool(np.any(away > _APART * np.abs(other.vector[places])))


def likeliest_together(starts: Sequence[Point]) -> Searched:
    """Return the start point of the joint fit whose search, with fixed inertia, has the likeliest
    end.

    The searches of the loaded fit keep the system parameters fixed. Errors of the system parameters
    can make a wrong basin the likeliest; a search in all parameters corrects such an error. Of
    equally likely ends, an end with a several times larger Stribeck speed is preferred, because the
    likelihood is flat at Stribeck speeds below the resolution of the samples.

    A search ends early if the steps that it may still take, each with the decrease of the last
    step, would not reach the least cost of the earlier searches.

    Args:
        starts: Starts of the joint fit, each from an end of the loaded fit.

    Returns:
        The chosen start point (not the end of its search), and the iterations of all searches.
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
    """Return the cost that a search by likelihood minimises; infinite if the cost is not finite."""
    cost = negative_log_likelihood(*point.predictions(point.origin()), HUBER_THRESHOLD)
    return cost if math.isfinite(cost) else math.inf


def _missed(end: End) -> bool:
    """Return whether the residuals at an end are far greater than the noise of the recordings."""
    residual = end.point.weighted().residuals(end.point.origin())
    return bool(np.mean(huber(residual, HUBER_THRESHOLD)) > _MISSED)


def _smoothed(starts: Sequence[Point], best: End, ends: list[End]) -> End:
    """Search from the start points with finite differences over wide steps, until the residuals at
    an end agree with the noise; return the best end.

    Far from the true values the model in the filter may stick and slip in slow ramps. The
    prediction errors then depend irregularly on the parameters: derivatives over small steps are a
    hundred times as large as derivatives over wide steps, and give no useful search direction.

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
    """Search again from neighbours of an end, with breakaway times computed anew; return the
    likeliest of all ends.

    Parameters and breakaway times are coupled, so that a search may end where neither a change of
    parameters alone nor a change of breakaway times alone lowers the cost.

    Args:
        best: The end whose neighbours are the start points.
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
    """Search from several points of one fit, two at a time; return the ends in the order of the
    points. Points for which the earlier searches left no passes are omitted.
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
    """Return whether the samples resolve the load Stribeck speed, that is, whether this speed
    exceeds a share of the speed that the joint gains within one sample period because load friction
    falls.
    """
    p = point.vector
    moment = float(np.median(np.concatenate([m.breakaway_moment for m in point.motions])))
    period = max(m.recording.period for m in point.motions)
    return bool(p[OMEGA_SL] > _LEAST_RESOLVED * moment * p[LOAD_RISE] * period / p[INERTIA])


def refine(
    point: Point, tempering: Sequence[float] = _TEMPERING, step: float = PARAMETER_STEP
) -> Searched:
    """Search by least squares at decreasing noise levels, then by likelihood at the estimated noise
    level.

    Least squares at noise levels above the estimated level lead the search into the basin of the
    maximum. At the estimated level the likelihood is maximised: the standard deviations depend on
    the parameters, so that least squares with constant weights do not find the maximum.

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
    """Search by least squares with the standard deviations at the start point."""
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
        reach: Cost that another search reached; a search that would not reach this cost ends early.
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
