"""Searches of the likelihood: grid of starts, tempered least squares, neighbours of the best end,
basins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from identification.filter.likelihood import PARAMETER_STEP, Problem, static_limit
from identification.filter.noise_level import HUBER_THRESHOLD, deviance
from identification.model.parameters import INERTIA, LOAD_RISE, MC, OMEGA_SL, SYSTEM_RISE
from identification.numerics import levenberg_marquardt as levenberg
from identification.numerics.arrays import Array
from identification.numerics.levenberg_marquardt import huber

_TEMPERING = (20.0, 8.0, 4.0, 2.0, 1.0)
"""Torque noise of the loaded fit's searches, over its own level; with fewer levels they miss the
best end.
"""
_START_SPEEDS = 6
_START_STATICS = 7
STARTS = 3
"""Starts that are followed to their end: the likeliest of the grid is not always in the right
basin.
"""
_MISSED = 0.8
"""Mean Huber cost of a residual above which an end is in no basin: it is 0.26 to 0.55 at true
values, and 1.4 and more at ends where searches are stuck.
"""
_WIDE_STEP = 0.3
"""Difference of a coordinate (a parameter, or its logarithm) over its size, for slopes of stuck
searches.
"""
_START_CLIP = 10.0
_SEEKS = 3
"""Fits in alternation with a grid search of the breakaway times."""
_LEAST_GAIN = 0.05
"""Gain of the negative log likelihood below which a fit ends."""
_LEAST_RESOLVED = 0.05
_BESIDE = (
    ((OMEGA_SL, 2.0), (OMEGA_SL, 0.5), (LOAD_RISE, 0.95), (LOAD_RISE, 1.05)),
    ((OMEGA_SL, 1.08), (OMEGA_SL, 0.92)),
)
"""Neighbours of the best end of the loaded fit, far ones and then near ones: place and factor."""
_ROUNDS = 2
"""Rounds of neighbours of a kind, each from the best end so far; the second only after a gain."""
_End = tuple[bool, float, Array, list[Array]]
"""End of a search: whether its Stribeck speed is unresolved, deviance, parameters, breakaway
times.
"""
_APART = 0.1
"""Relative difference of the Stribeck speed, or of the rise, above which two ends are in different
basins.
"""
SAME_END = 1.0
"""Deviance within which two searches count as ended alike: half a standard error of one
parameter.
"""
_AS_LIKELY = 4.0
"""Deviance within which recordings do not decide between two ends: two standard errors."""
_SEVERAL = 2.0


def breakaway_starts(
    problem: Problem, coulomb: int, rise: int, speed: int
) -> list[tuple[Array, list[Array]]]:
    """Search a grid of static limits and Stribeck speeds, as far as they are free.

    The static limit is at or below the peak torque before visible motion, because motion takes time
    to show.

    Returns:
        Parameters and breakaway times for every Stribeck speed with its likeliest static limit,
        likeliest first.
    """
    loaded = rise == LOAD_RISE
    fastest = max(
        float(np.max(np.abs(np.gradient(m.angle[::10], m.time[::10])))) for m in problem.motions
    )
    speeds = np.array([problem.start[speed]])
    if speed in problem.free:
        speeds = np.concatenate([speeds, np.geomspace(0.01, 0.35, _START_SPEEDS) * fastest])
    peaks = [m.peak_torque() for m in problem.motions]
    best: dict[float, tuple[float, Array, list[Array]]] = {}
    for share in np.linspace(0.75, 1.0, _START_STATICS) if rise in problem.free else (1.0,):
        p = problem.start.copy()
        if rise in problem.free:
            limits = [
                (share * peak - (p[MC] + p[SYSTEM_RISE] if loaded else 0.0))
                / (float(np.median(m.breakaway_moment)) if loaded else 1.0)
                for m, peak in zip(problem.motions, peaks, strict=True)
            ]
            p[rise] = float(np.median(limits)) - p[coulomb]
        if p[rise] < 0.0:
            continue
        times = [m.static_crossing(static_limit(p, m)) for m in problem.motions]
        for omega_s in speeds:
            p = p.copy()
            p[speed] = omega_s
            errors, deviations = problem.run(p, times, problem.noise)
            cost = deviance(errors, deviations, _START_CLIP)
            if omega_s not in best or cost < best[omega_s][0]:
                best[omega_s] = (cost, p, times)
    ranked = sorted(best.values(), key=lambda start: start[0])
    return [(p, times) for _, p, times in ranked]


def refine_from(problem: Problem, starts: Sequence[tuple[Array, list[Array]]]) -> float:
    """Search the loaded fit from the likeliest starts in turn; leave the problem at the likeliest
    end.

    A start that is likelier than every end, because the raised noise led out of its basin, is
    searched once more at the noise's own level. Ends whose Stribeck speed no sample resolves count
    only where there are no others: there the rise enters no prediction and fits noise.

    Returns:
        Deviance of the end above that of the likeliest start.
    """
    starts, begun = list(starts) or [(problem.start, problem.breakaway_times)], []
    ends: list[_End] = []
    for vector, times in starts[:STARTS]:
        problem.start, problem.breakaway_times = vector, times
        begun.append(_deviance(problem))
        ends.append(_ended(problem, _TEMPERING))
    left = min(ends, key=lambda end: end[:2])[1]
    for (vector, times), deviance_there in zip(starts[:STARTS], begun, strict=True):
        if deviance_there < left:
            problem.start, problem.breakaway_times = vector, times
            ends.append(_ended(problem, (1.0,)))
    best = _neighbours(problem, min(ends, key=lambda end: end[:2]))
    if _missed(problem, best):
        best = _smoothed(problem, starts, best)
    _, reached, problem.start, problem.breakaway_times = best
    return reached - min(begun)


def basins(problem: Problem) -> list[tuple[Array, list[Array]]]:
    """Return the loaded fit's end, then the best ends of other basins, likeliest first: parameters,
    breakaway times.

    Without ends whose Stribeck speed no sample resolves.
    """
    found = [(problem.start, problem.breakaway_times)]
    for unresolved, _, vector, times in sorted(problem.search_ends, key=lambda end: end[:2]):
        if not unresolved and all(_apart(vector, other) for other, _ in found):
            found.append((vector, times))
    return found[:STARTS]


def _apart(one: Array, other: Array) -> bool:
    """Return whether two ends are in different basins, by Stribeck speed and rise of the load
    friction.
    """
    places = [OMEGA_SL, LOAD_RISE]
    return bool(np.any(np.abs(one[places] - other[places]) > _APART * np.abs(other[places])))


def likeliest_together(problem: Problem, starts: Sequence[tuple[Array, list[Array]]]) -> None:
    """Start the joint problem at the loaded end whose joint search, with the inertia held, ends
    likeliest.

    The searches of the loaded fit hold the system parameters. With the errors of these a wrong
    basin may be likelier, which a search of all parameters corrects. Of ends that are as likely,
    one of several times the Stribeck speed is preferred: toward a speed that no sample resolves the
    likelihood is flat, and the search would drift there.
    """
    free, ends = problem.free, []
    problem.free = tuple(k for k in free if k != INERTIA)
    for vector, times in starts:
        problem.start, problem.breakaway_times = vector, times
        refine(problem, (1.0,))
        ends.append((not _resolved(problem), _deviance(problem), float(problem.start[OMEGA_SL])))
    problem.free = free
    unresolved, least, speed = best = min(ends)
    slower = [
        e
        for e in ends
        if e[0] == unresolved and e[1] < least + _AS_LIKELY and e[2] > _SEVERAL * speed
    ]
    problem.start, problem.breakaway_times = starts[
        ends.index(max(slower, key=lambda e: e[2], default=best))
    ]


def _missed(problem: Problem, end: _End) -> bool:
    """Return whether an end explains the recordings far worse than their noise allows."""
    _, _, problem.start, problem.breakaway_times = end
    problem.hold_weights()
    return bool(np.mean(huber(problem.residuals(problem.origin()), HUBER_THRESHOLD)) > _MISSED)


def _smoothed(problem: Problem, starts: Sequence[tuple[Array, list[Array]]], best: _End) -> _End:
    """Search from every start with slopes over wide steps, until an end explains the recordings;
    return the best.

    Away from the true values the filter may stick and slip in slow ramps, and its errors then
    depend on the parameters without order: slopes over small steps are a hundred times those over
    wide ones, and lead nowhere.
    """
    before = best
    for vector, times in starts:
        problem.start, problem.breakaway_times = vector, times
        best = min(best, _ended(problem, _TEMPERING, _WIDE_STEP), key=lambda end: end[:2])
        if not _missed(problem, best):
            break
    return best if best is before else _neighbours(problem, best)


def _neighbours(problem: Problem, best: _End) -> _End:
    """Search again from neighbours of an end, with new breakaway times; return the likeliest end
    found.

    Parameters and breakaway times move together, so that a search may end where no single change is
    a gain.
    """
    for beside in _BESIDE:
        for _ in range(_ROUNDS):
            begun = best
            for place, factor in beside:
                if place in problem.free:
                    best = min(
                        best, _searched(problem, begun, place, factor), key=lambda end: end[:2]
                    )
            if begun[1] - best[1] < SAME_END:
                break
    return best


def _searched(problem: Problem, begun: _End, place: int, factor: float) -> _End:
    """Return the end of a search that starts at another end with one parameter multiplied by a
    factor.
    """
    vector = begun[2].copy()
    vector[place] *= factor
    problem.start = vector
    problem.breakaway_times = [m.static_crossing(static_limit(vector, m)) for m in problem.motions]
    return _ended(problem, (1.0,))


def _ended(problem: Problem, tempering: Sequence[float], step: float = PARAMETER_STEP) -> _End:
    """Search from a problem's start and return the end."""
    refine(problem, tempering, step)
    end = (not _resolved(problem), _deviance(problem), problem.start, problem.breakaway_times)
    problem.search_ends.append(end)
    return end


def _deviance(problem: Problem) -> float:
    """Return the deviance at a problem's start; infinite where the search ended in no number."""
    found = deviance(*problem.run(problem.start, problem.breakaway_times, problem.noise))
    return found if math.isfinite(found) else math.inf


def _resolved(problem: Problem) -> bool:
    """Return whether load friction falls over more than a share of the speed that its fall adds
    within a period.
    """
    p = problem.start
    moment = float(np.median(np.concatenate([m.breakaway_moment for m in problem.motions])))
    period = max(m.recording.period for m in problem.motions)
    return bool(p[OMEGA_SL] > _LEAST_RESOLVED * moment * p[LOAD_RISE] * period / p[INERTIA])


def refine(
    problem: Problem, tempering: Sequence[float] = _TEMPERING, step: float = PARAMETER_STEP
) -> Array:
    """Search at falling noise, the last by likelihood; make the end the start; return the residuals
    there.

    Above the noise's own level least squares lead into the basin. At its level the deviations count
    as well: they depend on the parameters, and least squares with held weights miss the maximum of
    the likelihood.

    Args:
        problem: At its start.
        tempering: Torque noise of each search, over its own level.
        step: Difference for slopes at raised noise, over the size of a coordinate.
    """
    noise = problem.noise
    for factor in tempering:
        problem.noise = noise.louder(factor)
        problem.step = step if factor > 1.0 else PARAMETER_STEP
        if factor > 1.0:
            problem.hold_weights()
            found = levenberg.minimise(
                problem.residuals,
                problem.jacobian,
                problem.origin(),
                threshold=HUBER_THRESHOLD,
                tolerance=1e-4,
            )
            problem.keep(found.x)
            problem.iterations += found.steps
            continue
        for _ in range(_SEEKS):
            found = levenberg.minimise_deviance(
                problem.predictions,
                problem.derivatives,
                problem.origin(),
                threshold=HUBER_THRESHOLD,
                tolerance=_LEAST_GAIN,
            )
            problem.keep(found.x)
            problem.iterations += found.steps
            problem.hold_weights()
            if not problem.move_breakaways(HUBER_THRESHOLD):
                break
    problem.noise, problem.step = noise, PARAMETER_STEP
    problem.hold_weights()
    return problem.residuals(problem.origin())
