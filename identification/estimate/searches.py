"""Searches for the maximum of the likelihood of the loaded fit, from several starts.

A fit consists of a grid of start points, least squares at raised noise levels, further searches
from neighbours of the best end, and a list of the basins that were found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.estimate.covariance import covariances, named_covariances
from identification.estimate.inertia import SOLVED, equations_chi2, fit_beside_inertia, solve
from identification.filter.experiment import Filter
from identification.filter.likelihood import (
    HUBER_THRESHOLD,
    PARAMETER_STEP,
    Point,
    Searched,
    deviance,
    first_correlated_noise,
    likeliest_noise,
    repeating_share,
    torque_noise,
)
from identification.filter.segments import Motion, Noise
from identification.model.parameters import (
    INDEX,
    INERTIA,
    LOAD_RISE,
    MC,
    MU_C,
    OFFSET,
    OMEGA_SF,
    OMEGA_SL,
    SYSTEM_RISE,
    pack,
    unpack,
)
from identification.numerics import least_squares as levenberg
from identification.numerics.arrays import Array, Progress, silent
from identification.numerics.compiled import each
from identification.numerics.least_squares import huber, negative_log_likelihood
from identification.recording import Model
from identification.result import Starts

# Limits of the acceptance tests (docs/method.md, section 12).
MOST_WHITENESS = 0.15  # correlation of neighbouring innovations
MOST_NOISE = 2.0  # torque noise over the torque scatter
MOST_REPEATING = 0.25  # repeating share of the correlated noise (M26)
MOST_CHI2 = 10.0  # chi-square of the estimating equations of the unloaded fit (M29)
MOST_DROP = 10.0  # drop of the likelihood of the loaded fit, as deviance (M24)
MOST_ERROR = 1.3
"""Equation error at the refined values over that at the start values; at the true values of
simulated benches the ratio reaches 1.14.
"""
_TEMPERING = (20.0, 8.0, 4.0, 2.0, 1.0)
"""Torque noise levels of the searches, over the estimated level; fewer miss the best end."""
MOST_PASSES = 4000
"""Number of filter runs over the recordings (passes) after which a fit starts no further search and
returns its best end. If the model is right, the unloaded and the loaded fit take some hundred
passes each, and 3000 passes in the worst known case.
"""
STARTS = 3  # start points from which a search is run: the likeliest may be in a wrong basin
_MISSED = 0.8
"""Mean Huber cost of a residual above which a search counts as not converged. The mean cost is 0.26
to 0.55 at true values, and 1.4 or more if a search does not converge.
"""
_WIDE_STEP = 0.3  # relative step of finite differences after searches that failed to converge
_SEEKS = 3  # greatest number of alternations between a fit and a grid search of the breakaway times
_LEAST_GAIN = 0.05  # decrease of the negative log likelihood in a step, below which a fit ends
_LEAST_RESOLVED = 0.05
_BESIDE = (
    ((OMEGA_SL, 2.0), (OMEGA_SL, 0.5), (LOAD_RISE, 0.95), (LOAD_RISE, 1.05)),
    ((OMEGA_SL, 1.08), (OMEGA_SL, 0.92)),
)
"""Far, then near neighbours of the best end, as index of a parameter and factor on it."""
_ROUNDS = 2  # greatest number of rounds of searches from neighbours; the second only after a gain
_APART = 0.1
"""Relative difference of Stribeck speed or rise above which ends are in different basins."""
SAME_END = 1.0
"""Difference in deviance up to which ends are equal: one standard error of a parameter."""
_AS_LIKELY = 4.0  # difference in deviance up to which ends are as likely: two standard errors
_SEVERAL = 2.0


@dataclass(frozen=True, eq=False)
class End:
    """End of a search of the loaded fit."""

    unresolved: bool  # whether the Stribeck speed at the end is below the resolution of the samples
    deviance: float  # deviance (M24) at the end; infinite if it is not finite
    point: Point

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key; the better of two ends has the lower rank."""
        return self.unresolved, self.deviance


@dataclass(frozen=True, eq=False)
class LoadedFit:
    """Result of the loaded fit."""

    point: Point  # the likeliest end
    drop: float  # deviance of the likeliest end less the deviance of the likeliest start
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
    if _missed(best.point):
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
    """Return whether two ends differ in the Stribeck speed or rise of load friction."""
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


def _missed(point: Point) -> bool:
    """Return whether the residuals at a point are far greater than the noise of the recordings."""
    residual = point.weighted().residuals(point.origin())
    return bool(np.mean(huber(residual, HUBER_THRESHOLD)) > _MISSED)


def _smoothed(starts: Sequence[Point], best: End, ends: list[End]) -> End:
    """Search with wide finite differences until the residuals agree with the noise."""
    # Far from the true values the model in the filter may stick and slip in slow ramps; derivatives
    # over small steps then give no useful direction.
    before = best
    for start in starts:
        if spent(start):
            break
        ends.append(_ended(start, _TEMPERING, _WIDE_STEP))
        best = min(best, ends[-1], key=lambda end: end.rank)
        if not _missed(best.point):
            break
    return best if best is before else _neighbours(best, ends)


def _neighbours(best: End, ends: list[End]) -> End:
    """Search again from neighbours of an end; append to ``ends``, return the likeliest."""
    # Parameters and breakaway times are coupled: a search may end where neither alone lowers the
    # cost.
    for beside in _BESIDE:
        for _ in range(_ROUNDS):
            begun = best
            starts = [
                begun.point.at(_scaled(begun.point, place, factor))
                for place, factor in beside
                if place in best.point.free
            ]
            found = _ended_each(starts, (1.0,))
            ends += found
            best = min((best, *found), key=lambda end: end.rank)
            if begun.deviance - best.deviance < SAME_END:
                break
    return best


def _scaled(point: Point, place: int, factor: float) -> Array:
    """Return the parameters of a point with one of them multiplied by a factor."""
    vector = point.vector.copy()
    vector[place] *= factor
    return vector


def _ended_each(starts: Sequence[Point], tempering: Sequence[float]) -> list[End]:
    """Search from several points, two at a time, while passes are left; return the ends."""

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
    """Return whether samples resolve the load Stribeck speed: gain of speed in a period."""
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

    ``tempering``: torque noise level of each search, relative to the estimated level. ``step``:
    relative step for finite differences at raised noise.
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
        held.residuals, held.jacobian, point.origin(), threshold=HUBER_THRESHOLD, tolerance=1e-4
    )
    return Searched(point.moved(found.x), found.steps)


def _likelihood(point: Point, reach: float = math.inf) -> Searched:
    """Search by likelihood, in turn with a grid search of the breakaway times."""
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
        point, moved = there.weighted().with_best_breakaways()
        if found.beaten or not moved:
            break
    return Searched(point, iterations)


_SPEEDS = 6
_STATICS = 7
_CLIP = 10.0


def breakaway_starts(point: Point, coulomb: int, rise: int, speed: int) -> list[Point]:
    """Return start points from a grid of static limits and Stribeck speeds; a parameter that is not
    free keeps its value.

    The static limits of the grid are at or below the greatest torque before visible motion, because
    motion becomes visible some time after the breakaway.

    Returns:
        A point for every Stribeck speed with its likeliest static limit, likeliest first.
    """
    loaded = rise == LOAD_RISE
    fastest = max(
        float(np.max(np.abs(np.gradient(m.angle[::10], m.time[::10])))) for m in point.motions
    )
    speeds = np.array([point.vector[speed]])
    if speed in point.free:
        speeds = np.concatenate([speeds, np.geomspace(0.01, 0.35, _SPEEDS) * fastest])
    peaks = [m.peak_torque() for m in point.motions]
    best: dict[float, tuple[float, Point]] = {}
    for share in np.linspace(0.75, 1.0, _STATICS) if rise in point.free else (1.0,):
        p = point.vector.copy()
        if rise in point.free:
            limits = [
                (share * peak - (p[MC] + p[SYSTEM_RISE] if loaded else 0.0))
                / (float(np.median(m.breakaway_moment)) if loaded else 1.0)
                for m, peak in zip(point.motions, peaks, strict=True)
            ]
            p[rise] = float(np.median(limits)) - p[coulomb]
        if p[rise] < 0.0:
            continue
        limit = point.at(p)
        for omega_s in speeds:
            p = p.copy()
            p[speed] = omega_s
            start = replace(limit, vector=p)
            cost = deviance(*start.run(), _CLIP)
            if omega_s not in best or cost < best[omega_s][0]:
                best[omega_s] = (cost, start)
    return [start for _, start in sorted(best.values(), key=lambda found: found[0])]


_Free = tuple[Sequence[int], Sequence[int]]
"""Indices of the free parameters in two parts: the parameters that least squares estimate, and the
inertia; the second part is empty if the inertia is fixed.
"""
_AGAIN = 2
"""Greatest number of further attempts that start from the best end if no start point leads to a
solution; no attempt follows one that brings no improvement.
"""
_INERTIAS = (1.0, 0.8, 0.6, 1.25)
"""Start values of the inertia, relative to that of the equation error, which is biased up."""
_FAR = (3.0, 10.0, 30.0, 100.0, 0.3, 0.1)
"""Further start values of the inertia, relative to the inertia of the equation error, which are
tried if no other start point leads to a solution. In short, fast slips the equation error may give
a fiftieth of the true inertia.
"""
_TRIED = 2
"""Number of starts after which the search ends if the equation error shows missing physics and
acceptance rejects the noise at every end; without any end, all inertias near that of the equation
error are tried.
"""
_CLEARLY = 2.0
"""Ratio of a statistic of the solved unloaded fit to its limit of acceptance, above which the
refinement is rejected without a loaded and a joint fit. The limits apply to the statistics of all
recordings, which are means over the unloaded and the loaded ones.
"""


@dataclass(frozen=True, eq=False)
class Solved:
    """End point of one attempt to solve the unloaded fit."""

    chi2: float  # chi-square of the estimating equations (M29)
    point: Point  # point at which the attempt ended


def solve_unloaded(
    begun: Point,
    system: Sequence[int],
    inertia: Sequence[int],
    rejects: Callable[[Point], bool] | None = None,
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
        rejects: Function that returns whether acceptance rejects the noise at a point, if the
            equation error shows that the recordings have physics that the model lacks; then few
            starts without an accepted noise are followed at most by the likeliest start with an
            inertia far off.

    Returns:
        The best end, and the chi-square of every solution.
    """
    free = system, inertia
    both = bool(system) and bool(inertia)
    at_system = begun.freeing(system)
    ends: list[Solved] = []

    def hopeless(tried: int) -> bool:
        enough = _TRIED if ends else len(_INERTIAS)
        return rejects is not None and tried >= enough and all(rejects(e.point) for e in ends)

    def grid(point: Point) -> list[Point]:
        return breakaway_starts(point, MC, SYSTEM_RISE, OMEGA_SF)

    def starts() -> Iterator[Point]:
        yield from (_heavier(begun, share) for share in (_INERTIAS if inertia else (1.0,)))
        for start in (grid(at_system) if system else [])[:STARTS]:
            yield from (_heavier(start, share) for share in _INERTIAS[: len(inertia) * 3])

    _try_each(starts(), free, ends, hopeless)
    last: Solved | None = None
    for _ in range(_AGAIN if both else 0):
        best = _best(ends)
        if (
            best is None
            or best is last
            or best.chi2 < SOLVED
            or spent(begun)
            or hopeless(len(_INERTIAS))
        ):
            break
        last = best
        _try_each([replace(best.point, noise=begun.noise)], free, ends)
    best = _best(ends)
    if both and (best is None or not best.chi2 < SOLVED) and not spent(begun):
        heavier = (_heavier(at_system, share) for share in _FAR)
        far = (start for p in heavier for start in grid(p)[:1])
        if hopeless(len(_INERTIAS)):
            here = min(map(_deviance, (begun, *grid(at_system)[:1])))
            likeliest = min(far, key=_deviance, default=begun)
            far = (p for p in [likeliest] if _deviance(p) < here)
        _try_each(far, free, ends)
        best = _best(ends)
    if best is None:
        raise np.linalg.LinAlgError("no start of the search leads to a solution")
    return best, tuple(end.chi2 for end in ends)


def _best(ends: Sequence[Solved]) -> Solved | None:
    """Return the first end of least chi-square, or None without ends."""
    return min(ends, key=lambda end: end.chi2, default=None)


def _heavier(point: Point, share: float) -> Point:
    """Return the point with the inertia multiplied by the factor ``share``."""
    return replace(point, vector=_scaled(point, INERTIA, share))


def _try_each(
    starts: Iterable[Point],
    free: _Free,
    ends: list[Solved],
    hopeless: Callable[[int], bool] = lambda _tried: False,
) -> None:
    """Try starts until the equations are solved, or ``hopeless`` are tried; append the ends."""
    for number, start in enumerate(starts):
        solved = bool(ends) and min(end.chi2 for end in ends) < SOLVED
        if solved or (spent(start) and (ends or number)) or hopeless(number):
            break
        found = _solved_from(start, free)
        if found is not None:
            ends.append(found)


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


@dataclass(frozen=True)
class Refined:
    """A refined estimate."""

    values: Mapping[str, float]
    covariance: Array  # covariance of the fitted `names`, shape (p, p), in the units of the values
    floor: Array  # Cramer-Rao bound of the covariance, shape (p, p)
    names: tuple[str, ...]  # names of the fitted parameters, in the order of the covariance
    # Rms of normalised innovations with variance inflation; 1 if the noise model is right.
    innovation_rms: float
    whiteness: float  # correlation of neighbouring innovations, with variance inflation
    noise: Noise
    # Share of the correlated noise that repeats in matching half cycles (M26); zero without
    # correlated noise.
    repeating_share: float
    torque_scatter: float  # torque scatter from sample to sample, N m rms
    evaluations: int  # runs of the filter over all recordings
    iterations: int
    breakaways: int  # number of segments
    # Deviance at the end of the loaded fit less the deviance at its likeliest start point; positive
    # if least squares at a raised noise level left the basin of this start point.
    likelihood_drop: float
    equations_chi2: float  # chi-square of the unloaded fit's estimating equations (M29)
    joint: Point  # the estimate in the joint experiment
    starts: tuple[Starts, ...] = ()
    # Name to what is lacking, of recordings to which prediction errors do not apply.
    left_out: Mapping[str, str] = field(default_factory=dict)
    # Whether the unloaded or the loaded fit reached its greatest number of filter runs.
    stopped: bool = False
    # Whether the fit ended without the joint fit, because acceptance rejects the end of the
    # unloaded or the loaded fit; statistics and `joint` are those of this end then, and covariances
    # are not computed.
    partial: bool = False


def _sought(model: Model) -> tuple[list[int], list[int], list[int]]:
    """Return the indices of free parameters: of system load, working load, inertia."""
    fixed = {INDEX[n] for n in model.fixed if n in INDEX}
    system = [
        k for n, k in INDEX.items() if n in ("Mc", "Ms", "omega_sf", "sigma_2") and k not in fixed
    ]
    if "offset" in model.terms and OFFSET not in fixed:
        system.append(OFFSET)
    load = [
        k for n, k in INDEX.items() if n in ("mu_c", "mu_s", "omega_sL", "mu_2") and k not in fixed
    ]
    return system, load, [] if INERTIA in fixed else [INERTIA]


def _first_point(
    unloaded: Sequence[Motion],
    start: Mapping[str, float],
    system: Sequence[int],
    model: Model,
    correlated: bool,
) -> Point:
    """Return the start of the unloaded fit: equation error values, likeliest noise."""
    # Without load the equation error gives good start values. Under load the start values of the
    # grid are used, because load friction falls too steeply with speed to be resolved after
    # filtering.
    first = Point.of(
        unloaded, pack(start, model.alpha), system, model, Noise(torque_noise(unloaded))
    )
    if correlated:
        first = replace(first, noise=first_correlated_noise(first))
    return replace(first, noise=likeliest_noise(first))


def refine_stages(
    unloaded: Sequence[Motion],
    loaded: Sequence[Motion],
    start: Mapping[str, float],
    model: Model,
    correlated: bool = False,
    progress: Progress = silent,
    equation_noise: float = 0.0,
) -> Refined:
    """Fit the unloaded recordings, then the loaded recordings, then all recordings jointly.

    The fit ends after the unloaded or the loaded recordings if acceptance rejects their fit.

    ``equation_noise``: white torque noise that would explain the unloaded equation error, N m. The
    minimum of the equation error is global: if this noise is above the limit, the model lacks
    physics, or the motion is too fast for the bandwidth of the equation error.
    """
    system, load, inertia = _sought(model)
    progress(f"unloaded fit, recordings: {len(unloaded)}", 0.0)
    begun = _first_point(unloaded, start, system, model, correlated)
    loudest = MOST_NOISE * torque_noise(unloaded)

    def rejects(point: Point) -> bool:
        return point.noise.torque > loudest or (
            correlated and repeating_share(point) > _CLEARLY * MOST_REPEATING
        )

    # Correlated noise enters the equation error as missing physics does, and at the end of a search
    # from a bad start it may repeat as physics does.
    misfit = equation_noise > loudest and not correlated
    first, chi2s = solve_unloaded(begun, system, inertia, rejects if misfit else None)
    starts = [
        Starts("unloaded", "chi-square of the estimating equations", chi2s, SOLVED, absolute=True)
    ]
    evaluations, likelihood_drop, stopped = begun.filter.evaluations, 0.0, spent(begun)
    free, ends = [*system, *inertia], [first.point]
    shared = repeating_share(first.point) if correlated else 0.0
    reached, rejected = (
        first.point,
        (
            first.chi2 > MOST_CHI2
            or (first.chi2 >= SOLVED and rejects(first.point))
            or first.point.noise.torque > _CLEARLY * loudest
            or shared > _CLEARLY * MOST_REPEATING
        ),
    )
    if loaded and not rejected:
        progress(f"loaded fit, recordings: {len(loaded)}", 0.0)
        at_load = Point.of(loaded, first.point.vector, load, model, first.point.noise)
        second = refine_from(at_load, breakaway_starts(at_load, MU_C, LOAD_RISE, OMEGA_SL))
        evaluations, likelihood_drop = evaluations + at_load.filter.evaluations, second.drop
        stopped |= second.stopped
        finite = tuple(end.deviance for end in second.ends if math.isfinite(end.deviance))
        least = min(finite, default=math.inf) + SAME_END
        starts.append(Starts("loaded", "-2 log likelihood", finite, least))
        free, ends = [*system, *load, *inertia], basins(second)
        if _missed(second.point):
            reached = replace(second.point, noise=likeliest_noise(second.point))
            rejected = reached.noise.torque > _CLEARLY * MOST_NOISE * torque_noise(loaded)
    names = tuple(n for n, k in INDEX.items() if k in free)
    if rejected:
        joint, iterations = reached, 0
        achieved = floor = np.full((len(names), len(names)), math.nan)
    else:
        progress(f"joint fit, recordings: {len(unloaded) + len(loaded)}", 0.0)
        joint, iterations = _joint_fit(first.point, (*unloaded, *loaded), free, ends, model)
        achieved, floor = named_covariances(covariances(joint), joint, names)
        shared = repeating_share(joint) if correlated else 0.0
    residual = joint.weighted().residuals(joint.origin())
    innovation_rms, whiteness = innovation_statistics(residual, joint.breakaways)
    return Refined(
        values={**start, **unpack(joint.vector, [n for n in INDEX if n in start])},
        covariance=achieved,
        floor=floor,
        names=names,
        innovation_rms=innovation_rms,
        whiteness=whiteness,
        noise=joint.noise,
        repeating_share=shared,
        torque_scatter=torque_noise(joint.motions),
        evaluations=evaluations + (0 if rejected else joint.filter.evaluations),
        iterations=iterations,
        breakaways=joint.breakaways,
        likelihood_drop=likelihood_drop,
        equations_chi2=first.chi2,
        joint=joint,
        starts=tuple(starts),
        stopped=stopped,
        partial=rejected,
    )


def _joint_fit(
    first: Point,
    motions: Sequence[Motion],
    free: Sequence[int],
    ends: Sequence[Point],
    model: Model,
) -> Searched:
    """Fit all recordings jointly, from the likeliest of the ends of the loaded fit."""
    joint = Point.of(motions, first.vector, free, model, first.noise)
    starts = [
        replace(
            joint,
            vector=end.vector,
            breakaway_times=(
                first.breakaway_times
                if end is first
                else (*first.breakaway_times, *end.breakaway_times)
            ),
        )
        for end in ends
    ]
    begun = likeliest_together(starts) if len(starts) > 1 else Searched(starts[0], 0)
    found = fit_beside_inertia(begun.point, lambda point: refine(point, (1.0,)))
    return Searched(found.point, begun.iterations + found.iterations)


def innovation_statistics(residual: Array, breakaways: int) -> tuple[float, float]:
    """Return the rms of the innovations and the correlation of neighbouring innovations, with
    outliers clipped.

    Clipping limits the effect of a few short segments on which the filter diverges. Unmodelled
    physics affects most segments; therefore clipping does not hide unmodelled physics.

    Args:
        residual: Innovations over their standard deviations, then ties, shape (r,).
        breakaways: Number of ties.
    """
    inside = np.clip(residual[: len(residual) - breakaways], -HUBER_THRESHOLD, HUBER_THRESHOLD)
    power = np.mean(inside**2)
    return float(np.sqrt(power)), float(np.mean(inside[1:] * inside[:-1]) / power)
