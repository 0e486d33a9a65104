"""Searches of a stage by likelihood: where they begin, how they go, and from where beside the best end they go on."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from identification.filter.likelihood import PARAMETER_STEP, Problem, static_limit
from identification.filter.noise_level import CLIP, deviance
from identification.model.parameters import INERTIA, LOAD_RISE, MC, OMEGA_SL, SYSTEM_RISE
from identification.numerics import levenberg_marquardt as levenberg
from identification.numerics.arrays import Array
from identification.numerics.levenberg_marquardt import huber

_TEMPERING = (20.0, 8.0, 4.0, 2.0, 1.0)
"""Torque noise of the loaded stage's searches, over its own: with fewer levels they end beside the likeliest."""
_START_SPEEDS = 6
_START_STATICS = 7
STARTS = 3
"""Starts that are followed to their end: the likeliest of the grid is not always in the basin."""
_MISSED = 0.8
"""Mean Huber cost of a prediction error at which an end is in no basin: 0.26 to 0.55 at the true values, 1.4 and more
at the ends that searches were stuck in."""
_WIDE_STEP = 0.3
"""Difference of a coordinate (a parameter, or its logarithm) over its size, for slopes that lead out of there."""
_SEED_CLIP = 10.0
_SEEKS = 3
"""Fits in turn with a search of the breakaway times."""
_LEAST_GAIN = 0.05
"""Of the negative log likelihood, for a fit to go on."""
_LEAST_RESOLVED = 0.05
_BESIDE = (
    ((OMEGA_SL, 2.0), (OMEGA_SL, 0.5), (LOAD_RISE, 0.95), (LOAD_RISE, 1.05)),
    ((OMEGA_SL, 1.08), (OMEGA_SL, 0.92)),
)
"""Where beside the best end of the loaded stage searches begin, far and then near: parameter and factor."""
_ROUNDS = 2
"""Rounds of searches of a kind, each from the best end so far; the second only where the first found a better one."""
_End = tuple[bool, float, Array, list[Array]]
"""End of a search: whether its Stribeck speed is unresolved, deviance, kernel's vector, breakaway times."""
_APART = 0.1
"""Difference of the Stribeck speed, or of the rise, over itself, at which two ends are not in one basin."""
SAME_END = 1.0
"""-2 log likelihood within which two searches count as ended alike: half a standard error of one parameter."""
_AS_LIKELY = 4.0
"""The same, within which the recordings do not tell which of two ends is right: two standard errors."""
_SEVERAL = 2.0


def breakaway_starts(problem: Problem, coulomb: int, rise: int, speed: int) -> list[tuple[Array, list[Array]]]:
    """Search a grid of static limits and Stribeck speeds, those that are free.

    The static limit lies at or below the peak torque before visible motion, since breakaway takes time to show.

    Returns:
        Kernel's vector and breakaway times for every Stribeck speed with its likeliest static limit, likeliest first.
    """
    loaded = rise == LOAD_RISE
    fastest = max(float(np.max(np.abs(np.gradient(m.angle[::10], m.time[::10])))) for m in problem.motions)
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
            cost = deviance(errors, deviations, _SEED_CLIP)
            if omega_s not in best or cost < best[omega_s][0]:
                best[omega_s] = (cost, p, times)
    ranked = sorted(best.values(), key=lambda start: start[0])
    return [(p, times) for _, p, times in ranked]


def refine_from(problem: Problem, starts: Sequence[tuple[Array, list[Array]]]) -> float:
    """Refine the loaded stage from the likeliest starts in turn; leave the problem at the likeliest end.

    Returns its deviance above that of the likeliest start. Where the raised noise leads all searches out of the basin,
    so that a start is likelier than every end, they are made again from there at the noise's own level.

    Ends whose Stribeck speed no sample resolves count only where there are no others: there the rise takes no part in
    any prediction and only fits noise, at times better than the truth does.
    """
    starts, begun = list(starts) or [(problem.start, problem.begins)], []
    ends: list[_End] = []
    for vector, times in starts[:STARTS]:
        problem.start, problem.begins = vector, times
        begun.append(_deviance(problem))
        ends.append(_ended(problem, _TEMPERING))
    left = min(ends, key=lambda end: end[:2])[1]
    for (vector, times), deviance_there in zip(starts[:STARTS], begun, strict=True):
        if deviance_there < left:
            problem.start, problem.begins = vector, times
            ends.append(_ended(problem, (1.0,)))
    best = _neighbours(problem, min(ends, key=lambda end: end[:2]))
    if _missed(problem, best):
        best = _smoothed(problem, starts, best)
    _, reached, problem.start, problem.begins = best
    return reached - min(begun)


def basins(problem: Problem) -> list[tuple[Array, list[Array]]]:
    """Return the loaded stage's end, then the best ones of other basins, likeliest first: vectors, breakaway times.

    Not those whose Stribeck speed no sample resolves.
    """
    found = [(problem.start, problem.begins)]
    for unresolved, _, vector, times in sorted(problem.reached, key=lambda end: end[:2]):
        if not unresolved and all(_apart(vector, other) for other, _ in found):
            found.append((vector, times))
    return found[:STARTS]


def _apart(one: Array, other: Array) -> bool:
    """Return whether two ends are not in one basin, by the Stribeck speed and the rise of load friction."""
    places = [OMEGA_SL, LOAD_RISE]
    return bool(np.any(np.abs(one[places] - other[places]) > _APART * np.abs(other[places])))


def likeliest_together(problem: Problem, starts: Sequence[tuple[Array, list[Array]]]) -> None:
    """Begin the joint problem where its search, with the inertia held, comes to the likeliest end.

    The loaded stage's searches hold what the first stage found. With its errors a wrong basin may be likelier by
    hundreds, and with all parameters free the right one is by thousands. An end as likely, of several times the
    Stribeck speed, is taken before the likeliest: toward a speed that no sample resolves the likelihood is flat, and
    with another inertia the search would slide there.
    """
    free, ends = problem.free, []
    problem.free = tuple(k for k in free if k != INERTIA)
    for vector, times in starts:
        problem.start, problem.begins = vector, times
        refine(problem, (1.0,))
        ends.append((not _resolved(problem), _deviance(problem), float(problem.start[OMEGA_SL])))
    problem.free = free
    unresolved, least, speed = best = min(ends)
    slower = [e for e in ends if e[0] == unresolved and e[1] < least + _AS_LIKELY and e[2] > _SEVERAL * speed]
    problem.start, problem.begins = starts[ends.index(max(slower, key=lambda e: e[2], default=best))]


def _missed(problem: Problem, end: _End) -> bool:
    """Return whether an end explains the recordings far worse than their noise allows."""
    _, _, problem.start, problem.begins = end
    problem.weigh()
    return bool(np.mean(huber(problem.residuals(problem.origin()), CLIP)) > _MISSED)


def _smoothed(problem: Problem, starts: Sequence[tuple[Array, list[Array]]], best: _End) -> _End:
    """Search from every start with slopes over wide steps, until an end explains the recordings; return the best.

    Beside the true values the filter has slow ramps stick and slip, and its errors then hang on the parameters without
    order: slopes over small steps are a hundred times those over wide ones, and no step of theirs gains anything.
    """
    before = best
    for vector, times in starts:
        problem.start, problem.begins = vector, times
        best = min(best, _ended(problem, _TEMPERING, _WIDE_STEP), key=lambda end: end[:2])
        if not _missed(problem, best):
            break
    return best if best is before else _neighbours(problem, best)


def _neighbours(problem: Problem, best: _End) -> _End:
    """Search again from beside an end, with every breakaway sought anew; return the likeliest that is found.

    Parameters and breakaway times move together, so that a search ends where no single one of them is better.
    """
    for beside in _BESIDE:
        for _ in range(_ROUNDS):
            begun = best
            for place, factor in beside:
                if place in problem.free:
                    best = min(best, _searched(problem, begun, place, factor), key=lambda end: end[:2])
            if begun[1] - best[1] < SAME_END:
                break
    return best


def _searched(problem: Problem, begun: _End, place: int, factor: float) -> _End:
    """Return where a search ends that begins at an end with one parameter multiplied by a factor."""
    vector = begun[2].copy()
    vector[place] *= factor
    problem.start = vector
    problem.begins = [m.static_crossing(static_limit(vector, m)) for m in problem.motions]
    return _ended(problem, (1.0,))


def _ended(problem: Problem, tempering: Sequence[float], step: float = PARAMETER_STEP) -> _End:
    """Search from a problem's start and return where that ends."""
    refine(problem, tempering, step)
    end = (not _resolved(problem), _deviance(problem), problem.start, problem.begins)
    problem.reached.append(end)
    return end


def _deviance(problem: Problem) -> float:
    """Return the deviance at a problem's start; infinite where a search ran off to what is no number."""
    found = deviance(*problem.run(problem.start, problem.begins, problem.noise))
    return found if math.isfinite(found) else math.inf


def _resolved(problem: Problem) -> bool:
    """Return whether load friction falls over more than a share of the speed that its fall adds within a period."""
    p = problem.start
    moment = float(np.median(np.concatenate([m.breakaway_moment for m in problem.motions])))
    period = max(m.recording.period for m in problem.motions)
    return bool(p[OMEGA_SL] > _LEAST_RESOLVED * moment * p[LOAD_RISE] * period / p[INERTIA])


def refine(problem: Problem, tempering: Sequence[float] = _TEMPERING, step: float = PARAMETER_STEP) -> Array:
    """Refine at falling noise, the last by likelihood; keeps the result as start; returns the residuals there.

    ``step`` is that of the slopes at raised noise.

    Above the noise's own level least squares lead into the basin. At its level the deviations count as well: they hang
    on the parameters, most where friction falls, and least squares whose weights are held end beside the likeliest.
    """
    noise = problem.noise
    for factor in tempering:
        problem.noise = noise.louder(factor)
        problem.step = step if factor > 1.0 else PARAMETER_STEP
        if factor > 1.0:
            problem.weigh()
            found = levenberg.minimise(
                problem.residuals, problem.jacobian, problem.origin(), threshold=CLIP, tolerance=1e-4
            )
            problem.keep(found.x)
            problem.iterations += found.steps
            continue
        for _ in range(_SEEKS):
            found = levenberg.minimise_deviance(
                problem.predictions, problem.derivatives, problem.origin(), threshold=CLIP, tolerance=_LEAST_GAIN
            )
            problem.keep(found.x)
            problem.iterations += found.steps
            problem.weigh()
            if not problem.seek_breakaways(CLIP):
                break
    problem.noise, problem.step = noise, PARAMETER_STEP
    problem.weigh()
    return problem.residuals(problem.origin())
