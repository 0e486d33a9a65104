"""Refinement by prediction errors: all stages and all breakaways jointly, from the equation-error start.

Unknown beside the parameters is when each stretch breaks away. Each such time is tied to the static limit by the torque
measured then. Least squares leads into the right basin, with the inertia held: the torque noise is first assumed large
and then lowered, as a filter that trusts the encoder more has a smoother cost. At the noise's own level the likelihood
is searched. Instrumental variables then give the inertia, which both put far off, and the likelihood the rest beside it
(:mod:`identification.estimate.instrumental`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate import innovations as kernel
from identification.estimate import levenberg
from identification.estimate.instrumental import SOLVED, Covariances, beside_inertia, covariances, defect, solve
from identification.estimate.noise import Noise
from identification.estimate.noise_level import CLIP, deviance, likeliest_noise, repeated, torque_noise, with_correlated
from identification.estimate.prediction_problem import INDEX, Problem, pack, static_limit, unpack
from identification.estimate.result import Starts
from identification.estimate.stretches import Motion
from identification.recording import Array, Model

_TEMPERING = (20.0, 8.0, 4.0, 2.0, 1.0)
"""Torque noise of the loaded stage's searches, over its own: with fewer levels they end beside the likeliest."""
_START_SPEEDS = 6
_START_STATICS = 7
_STARTS = 3
"""Starts of the loaded stage that are followed to their end: the likeliest of the grid is not always in the basin."""
_SEED_CLIP = 10.0
_SEEKS = 3
"""Fits in turn with a search of the breakaway times."""
_LEAST_GAIN = 0.05
"""Of the negative log likelihood, for a fit to go on."""
_LEAST_RESOLVED = 0.05
_BESIDE = (
    ((kernel.OMEGA_SL, 2.0), (kernel.OMEGA_SL, 0.5), (kernel.DMU, 0.95), (kernel.DMU, 1.05)),
    ((kernel.OMEGA_SL, 1.08), (kernel.OMEGA_SL, 0.92)),
)
"""Where beside the best end of the loaded stage searches begin, far and then near: parameter and factor."""
_ROUNDS = 2
"""Rounds of searches of a kind, each from the best end so far; the second only where the first found a better one."""
_End = tuple[bool, float, Array, list[Array]]
"""End of a search: whether its Stribeck speed is unresolved, deviance, kernel's vector, breakaway times."""
SAME_END = 1.0
"""-2 log likelihood within which two searches count as ended alike: half a standard error of one parameter."""
_Solved = tuple[float, Array, list[Array], Noise]
"""End of a solution of the unloaded stage: defect, kernel's vector, breakaway times, noise."""
_AGAIN = 2
"""Solutions begun from the best end where none of the starts is solved, as with an inertia that starts far off."""
_INERTIAS = (1.0, 0.8, 0.6, 1.25)
"""Inertias tried, over the equation error's; it errs upward under noise."""


@dataclass(frozen=True)
class Refined:
    """A refined estimate.

    Attributes:
        values: Name to value.
        covariance: Of the fitted ``names``, shape (p, p), in the values' own units.
        floor: The least covariance possible (:mod:`identification.estimate.cramer_rao`), of the same shape.
        names: Fitted names in that order.
        innovation_rms: 1 where the noise model holds.
        whiteness: Correlation of neighbouring innovations.
        noise: Of torque and angle, that the prediction errors ask for.
        repeated: Share of the noise's correlated part that comes again in strokes alike; zero without such a part.
        torque_scatter: The torque's own scatter from sample to sample, N m rms.
        evaluations: Runs of the filter over all recordings.
        iterations: Iterations of the joint fit.
        breakaways: Breakaways that entered.
        strayed: Deviance at the loaded stage's end above that at its likeliest start; positive where the least squares
            at raised noise, whose weights are held, left the basin and the likelihood did not lead back.
        unsolved: Defect of the first stage's estimating equations: of any size where no start solved them.
        joint: The joint problem, at the estimate.
        starts: What each search began from came to.
    """

    values: Mapping[str, float]
    covariance: Array
    floor: Array
    names: tuple[str, ...]
    innovation_rms: float
    whiteness: float
    noise: Noise
    repeated: float
    torque_scatter: float
    evaluations: int
    iterations: int
    breakaways: int
    strayed: float
    unsolved: float
    joint: Problem
    starts: tuple[Starts, ...] = ()


def breakaway_starts(problem: Problem, coulomb: int, rise: int, speed: int) -> list[tuple[Array, list[Array]]]:
    """Search a grid of static limits and Stribeck speeds, those that are free.

    The static limit lies at or below the peak torque before visible motion, since breakaway takes time to show.

    Returns:
        Kernel's vector and breakaway times for every Stribeck speed with its likeliest static limit, likeliest first;
        at most :data:`_STARTS`.
    """
    loaded = rise == kernel.DMU
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
                (share * peak - (p[kernel.MC] + p[kernel.DM] if loaded else 0.0))
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
    return [(p, times) for _, p, times in ranked[:_STARTS]]


def refine_from(problem: Problem, starts: Sequence[tuple[Array, list[Array]]]) -> float:
    """Refine the loaded stage from each start in turn; leave the problem at the likeliest end.

    Returns its deviance above that of the likeliest start.

    Ends whose Stribeck speed no sample resolves count only where there are no others: there the rise takes no part in
    any prediction and only fits noise, at times better than the truth does.
    """
    ends, begun = [], []
    for vector, times in starts or [(problem.start, problem.begins)]:
        problem.start, problem.begins = vector, times
        begun.append(_deviance(problem))
        refine(problem)
        ends.append((not _resolved(problem), _deviance(problem), problem.start, problem.begins))
        problem.ends.append(ends[-1][1])
    best = _neighbours(problem, min(ends, key=lambda end: end[:2]))
    _, reached, problem.start, problem.begins = best
    return reached - min(begun)


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
    refine(problem, (1.0,))
    end = (not _resolved(problem), _deviance(problem), problem.start, problem.begins)
    problem.ends.append(end[1])
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
    return bool(p[kernel.OMEGA_SL] > _LEAST_RESOLVED * moment * p[kernel.DMU] * period / p[kernel.INERTIA])


def refine(problem: Problem, tempering: Sequence[float] = _TEMPERING) -> Array:
    """Refine at falling noise, the last by likelihood; keeps the result as start; returns the residuals there.

    Above the noise's own level least squares lead into the basin. At its level the deviations count as well: they hang
    on the parameters, most where friction falls, and least squares whose weights are held end beside the likeliest.
    """
    noise = problem.noise
    for factor in tempering:
        problem.noise = noise.louder(factor)
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
    problem.noise = noise
    problem.weigh()
    return problem.residuals(problem.origin())


def solve_first_stage(problem: Problem, system: Sequence[int], inertia: Sequence[int]) -> float:
    """Solve the unloaded stage from one start after the other, until the estimating equations are solved.

    Least squares with the inertia held lead into the basin of the inertia they are given; the equation error's may be
    off by half. Leaves the problem at the best end; returns its defect.

    Raises:
        numpy.linalg.LinAlgError: The instruments pin the parameters from none of the starts.
    """
    vector, begins, noise = problem.start, problem.begins, problem.noise
    problem.free = tuple(system)
    searched = breakaway_starts(problem, kernel.MC, kernel.DM, kernel.OMEGA_SF) if system else []
    starts = [(vector, begins, share) for share in (_INERTIAS if inertia else (1.0,))]
    starts += [(p, times, share) for p, times in searched for share in _INERTIAS[: len(inertia) * 3]]
    best: _Solved | None = None
    again = _AGAIN if system and inertia else 0
    while starts:
        start, times, share = starts.pop(0)
        found = _solved_from(problem, start, times, share, noise, (system, inertia))
        if found is not None and (best is None or found[0] < best[0]):
            best = found
        if best is not None and best[0] < SOLVED:
            break
        if best is not None and not starts and again:
            again -= 1
            starts.append((best[1], best[2], 1.0))
    if best is None:
        raise np.linalg.LinAlgError("no start pins the parameters")
    unsolved, problem.start, problem.begins, problem.noise = best
    return unsolved


def _solved_from(
    problem: Problem,
    start: Array,
    times: Sequence[Array],
    share: float,
    noise: Noise,
    free: tuple[Sequence[int], Sequence[int]],
) -> _Solved | None:
    """Solve the unloaded stage from one start; None where that leads nowhere.

    Args:
        problem: Left at the end.
        start: Kernel's vector.
        times: Breakaway times.
        share: Inertia begun with, over that of the start.
        noise: Begun with.
        free: Parameters that least squares find first, then the inertia.
    """
    system, inertia = free
    problem.start, problem.begins, problem.noise = start.copy(), list(times), noise
    problem.start[kernel.INERTIA] *= share
    problem.free = tuple(system)
    try:
        if system:
            refine(problem, (1.0,))
        problem.free = (*system, *inertia)
        if problem.free:
            solve(problem)
        unsolved = defect(problem) if problem.free else 0.0
    except np.linalg.LinAlgError:
        # From a start without a rise, as the equation error finds it in slips, nothing tells its speed.
        return None
    if not math.isfinite(unsolved):
        return None
    problem.ends.append(unsolved)
    return unsolved, problem.start, problem.begins, problem.noise


def refine_stages(
    unloaded: Sequence[Motion],
    loaded: Sequence[Motion],
    start: Mapping[str, float],
    model: Model,
    correlated: bool = False,
) -> Refined:
    """Refine stage by stage, then jointly.

    Args:
        unloaded: Recordings of the first stage.
        loaded: Recordings of the second stage, may be empty.
        start: Equation-error values of all parameters.
        model: Declared terms and fixed values.
        correlated: Whether the torque's noise is given a correlated part.
    """
    fixed = {INDEX[n] for n in model.fixed if n in INDEX}
    system = [k for n, k in INDEX.items() if n in ("Mc", "Ms", "omega_sf", "sigma_2") and k not in fixed]
    if "offset" in model.terms and kernel.OFFSET not in fixed:
        system.append(kernel.OFFSET)
    load = [k for n, k in INDEX.items() if n in ("mu_c", "mu_s", "omega_sL", "mu_2") and k not in fixed]
    evaluations = 0
    first = Problem(unloaded, pack(start), system, model, Noise(torque_noise(unloaded)))
    # Without load the equation error is a good start already; with it, friction falls too steeply to be filtered.
    first.begins = [m.static_crossing(static_limit(first.start, m)) for m in unloaded]
    if correlated:
        first.noise = with_correlated(first)
    first.noise = likeliest_noise(first)
    inertia = [] if kernel.INERTIA in fixed else [kernel.INERTIA]
    unsolved = solve_first_stage(first, system, inertia)
    starts = [Starts("unloaded", "defect of the estimating equations", tuple(first.ends), SOLVED, absolute=True)]
    evaluations += first.evaluations
    motions, begins, noise, free, strayed = tuple(unloaded), list(first.begins), first.noise, system, 0.0
    vector = first.start
    if loaded:
        second = Problem(loaded, vector, load, model, noise)
        strayed = refine_from(second, breakaway_starts(second, kernel.MU_C, kernel.DMU, kernel.OMEGA_SL))
        evaluations += second.evaluations
        ends = tuple(end for end in second.ends if math.isfinite(end))
        starts.append(Starts("loaded", "-2 log likelihood", ends, min(ends, default=math.inf) + SAME_END))
        motions, begins, free = (*motions, *loaded), begins + second.begins, system + load
        vector = second.start
    free = [*free, *inertia]
    joint = Problem(motions, vector, free, model, noise)
    joint.begins = begins
    residual = beside_inertia(joint, refine)
    names = tuple(n for n, k in INDEX.items() if k in free)
    achieved, floor = named_covariances(covariances(joint), joint, names)
    inside = residual[: len(residual) - joint.breakaways]
    return Refined(
        values={**start, **unpack(joint.start, [n for n in INDEX if n in start])},
        covariance=achieved,
        floor=floor,
        names=names,
        innovation_rms=float(np.sqrt(np.mean(inside**2))),
        whiteness=float(np.mean(inside[1:] * inside[:-1]) / np.mean(inside**2)),
        noise=joint.noise,
        repeated=repeated(joint) if correlated else 0.0,
        torque_scatter=torque_noise(motions),
        evaluations=evaluations + joint.evaluations,
        iterations=joint.iterations,
        breakaways=joint.breakaways,
        strayed=strayed,
        unsolved=unsolved,
        joint=joint,
        starts=tuple(starts),
    )


def named_covariances(found: Covariances, joint: Problem, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the covariance achieved and the least possible in the order of ``names``, by static limits, (p, p)."""
    order = [joint.free.index(INDEX[n]) for n in names]
    turn = rise_to_static(names)
    achieved, floor = (turn @ c[np.ix_(order, order)] @ turn.T for c in (found.achieved, found.floor))
    return achieved, floor


def rise_to_static(names: Sequence[str]) -> Array:
    """Return the map from (Coulomb level, rise) to (Coulomb level, static limit)."""
    turn = np.eye(len(names))
    for coulomb, static in (("Mc", "Ms"), ("mu_c", "mu_s")):
        if coulomb in names and static in names:
            turn[names.index(static), names.index(coulomb)] = 1.0
    return turn
