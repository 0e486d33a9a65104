"""The unloaded, loaded and joint fit of the prediction errors, from the start values of the
equation error.

Unknown beside the parameters is the breakaway time of each segment, which is tied to the static
limit by the torque measured then (M22). Least squares with the inertia held lead into the right
basin: the torque noise is first taken large and then lowered, because a filter that trusts the
encoder more has a smoother cost. At the noise's own level the likelihood is searched. The inertia
follows from its estimating equation, because least squares and likelihood are biased in it
(:mod:`identification.estimate.inertia.estimating_equations`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.inertia.estimating_equations import (
    SOLVED,
    equations_chi2,
    fit_beside_inertia,
    solve,
)
from identification.estimate.likelihood.searches import (
    SAME_END,
    STARTS,
    basins,
    breakaway_starts,
    likeliest_together,
    refine,
    refine_from,
)
from identification.estimate.uncertainty.covariance import covariances, named_covariances
from identification.filter.likelihood import Problem, static_limit
from identification.filter.noise import Noise
from identification.filter.noise_level import (
    HUBER_THRESHOLD,
    first_correlated_noise,
    likeliest_noise,
    repeating_share,
    torque_noise,
)
from identification.filter.segments import Motion
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
from identification.numerics.arrays import Array
from identification.recording import Model
from identification.result import Starts

_Start = tuple[Array, Sequence[Array], float]
"""Start of a solution of the unloaded fit: parameters, breakaway times, inertia over that of the
parameters.
"""
_Solved = tuple[float, Array, list[Array], Noise]
"""End of a solution of the unloaded fit: chi-square (M29), parameters, breakaway times, noise."""
_AGAIN = 2
"""Solutions started from the best end where no start is solved; the first without a gain is the
last.
"""
_INERTIAS = (1.0, 0.8, 0.6, 1.25)
"""Inertias tried, over that of the equation error, which errs upward under noise."""
_FAR = (3.0, 10.0, 30.0, 100.0, 0.3, 0.1)
"""Inertias tried where none of these is solved: for short, fast slips the equation error may find a
fiftieth.
"""


@dataclass(frozen=True)
class Refined:
    """A refined estimate.

    Attributes:
        values: Name to value.
        covariance: Of the fitted ``names``, shape (p, p), in the units of the values.
        floor: Its Cramer-Rao bound (:mod:`identification.estimate.uncertainty.cramer_rao`), shape
        (p, p).
        names: Fitted names in that order.
        innovation_rms: Of innovations with variance inflation; 1 where the noise model holds.
        whiteness: Correlation of neighbouring innovations, likewise.
        noise: Noise of torque and angle.
        repeating_share: Share of the correlated noise that repeats (M26); zero without correlated
        noise.
        torque_scatter: Torque scatter from sample to sample, N m rms.
        evaluations: Runs of the filter over all recordings.
        iterations: Iterations of the joint fit.
        breakaways: Number of segments.
        likelihood_drop: Deviance at the end of the loaded fit above that at its likeliest start;
            positive where the least squares at raised noise left the basin and the likelihood did
            not return to it.
        equations_chi2: Chi-square of the unloaded fit's estimating equations (M29).
        joint: The joint problem, at the estimate.
        starts: Ends of the searches by start.
    """

    values: Mapping[str, float]
    covariance: Array
    floor: Array
    names: tuple[str, ...]
    innovation_rms: float
    whiteness: float
    noise: Noise
    repeating_share: float
    torque_scatter: float
    evaluations: int
    iterations: int
    breakaways: int
    likelihood_drop: float
    equations_chi2: float
    joint: Problem
    starts: tuple[Starts, ...] = ()


def solve_unloaded(problem: Problem, system: Sequence[int], inertia: Sequence[int]) -> float:
    """Solve the unloaded fit from one start after another, until the estimating equations are
    solved.

    Least squares with the inertia held lead into the basin of that inertia; the equation error's
    may be off by half and more. Leaves the problem at the best end; returns its chi-square (M29).

    Raises:
        numpy.linalg.LinAlgError: The instruments determine the parameters from none of the starts.
    """
    vector, begins, noise = problem.start, problem.breakaway_times, problem.noise
    free = system, inertia
    both = bool(system) and bool(inertia)
    problem.free = tuple(system)
    searched = breakaway_starts(problem, MC, SYSTEM_RISE, OMEGA_SF) if system else []
    starts = [(vector, begins, share) for share in (_INERTIAS if inertia else (1.0,))]
    starts += [
        (p, times, share)
        for p, times in searched[:STARTS]
        for share in _INERTIAS[: len(inertia) * 3]
    ]
    best = _best_of(problem, starts, noise, free, None)
    last: _Solved | None = None
    for _ in range(_AGAIN if both else 0):
        if best is None or best is last or best[0] < SOLVED:
            break
        last = best
        best = _best_of(problem, [(best[1], best[2], 1.0)], noise, free, best)
    if both and (best is None or not best[0] < SOLVED):
        best = _best_of(problem, _far(problem, vector, noise, system), noise, free, best)
    if best is None:
        raise np.linalg.LinAlgError("no start pins the parameters")
    chi2, problem.start, problem.breakaway_times, problem.noise = best
    return chi2


def _far(problem: Problem, vector: Array, noise: Noise, system: Sequence[int]) -> Iterator[_Start]:
    """Yield starts at inertias far from the equation error's, each with its likeliest breakaway
    times.
    """
    for share in _FAR:
        problem.start, problem.noise, problem.free = vector.copy(), noise, tuple(system)
        problem.start[INERTIA] *= share
        for p, times in breakaway_starts(problem, MC, SYSTEM_RISE, OMEGA_SF)[:1]:
            yield p, times, 1.0


def _best_of(
    problem: Problem,
    starts: Iterable[_Start],
    noise: Noise,
    free: tuple[Sequence[int], Sequence[int]],
    best: _Solved | None,
) -> _Solved | None:
    """Solve from one start after another until the equations are solved; return the best end,
    including ``best``.
    """
    for start, times, share in starts:
        found = _solved_from(problem, start, times, share, noise, free)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
        if best is not None and best[0] < SOLVED:
            break
    return best


def _solved_from(
    problem: Problem,
    start: Array,
    times: Sequence[Array],
    share: float,
    noise: Noise,
    free: tuple[Sequence[int], Sequence[int]],
) -> _Solved | None:
    """Solve the unloaded fit from one start; None where that fails.

    Args:
        problem: Left at the end.
        start: Parameter vector.
        times: Breakaway times.
        share: Inertia at first, over that of the start.
        noise: Noise at first.
        free: Parameters that least squares find first, then the inertia.
    """
    system, inertia = free
    problem.start, problem.breakaway_times, problem.noise = start.copy(), list(times), noise
    problem.start[INERTIA] *= share
    problem.free = tuple(system)
    try:
        if system:
            refine(problem, (1.0,))
        problem.free = (*system, *inertia)
        if problem.free:
            solve(problem)
        chi2 = equations_chi2(problem) if problem.free else 0.0
    except np.linalg.LinAlgError:
        # From a start without a rise, as the equation error finds it in slips, the Stribeck speed
        # is undetermined.
        return None
    if not math.isfinite(chi2):
        return None
    problem.solution_chi2.append(chi2)
    return chi2, problem.start, problem.breakaway_times, problem.noise


def _sought(model: Model) -> tuple[list[int], list[int], list[int]]:
    """Return the places of the parameters that are not fixed: of the system, of the load, and of
    the inertia.
    """
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


def _first_problem(
    unloaded: Sequence[Motion],
    start: Mapping[str, float],
    system: Sequence[int],
    model: Model,
    correlated: bool,
) -> Problem:
    """Return the problem of the unloaded fit at the equation error's values, with the likeliest
    noise there.
    """
    first = Problem(
        unloaded, pack(start, model.alpha), system, model, Noise(torque_noise(unloaded))
    )
    # Without load the equation error is a good start already; with it, friction falls too steeply
    # to be filtered.
    first.breakaway_times = [m.static_crossing(static_limit(first.start, m)) for m in unloaded]
    if correlated:
        first.noise = first_correlated_noise(first)
    first.noise = likeliest_noise(first)
    return first


def refine_stages(
    unloaded: Sequence[Motion],
    loaded: Sequence[Motion],
    start: Mapping[str, float],
    model: Model,
    correlated: bool = False,
) -> Refined:
    """Fit unloaded recordings, then loaded ones, then all jointly.

    Args:
        unloaded: Unloaded recordings.
        loaded: Loaded recordings, may be empty.
        start: Equation-error values of all parameters.
        model: Declared terms and fixed values.
        correlated: Whether the torque noise has a correlated part.
    """
    system, load, inertia = _sought(model)
    first = _first_problem(unloaded, start, system, model, correlated)
    chi2 = solve_unloaded(first, system, inertia)
    starts = [
        Starts(
            "unloaded",
            "defect of the estimating equations",
            tuple(first.solution_chi2),
            SOLVED,
            absolute=True,
        )
    ]
    evaluations = first.evaluations
    motions, begins, noise = tuple(unloaded), list(first.breakaway_times), first.noise
    free, likelihood_drop = system, 0.0
    vector, others = first.start, []
    if loaded:
        second = Problem(loaded, vector, load, model, noise)
        likelihood_drop = refine_from(second, breakaway_starts(second, MU_C, LOAD_RISE, OMEGA_SL))
        evaluations += second.evaluations
        ends = tuple(end for _, end, *_ in second.search_ends if math.isfinite(end))
        starts.append(
            Starts("loaded", "-2 log likelihood", ends, min(ends, default=math.inf) + SAME_END)
        )
        motions, begins, free = (*motions, *loaded), begins + second.breakaway_times, system + load
        vector = second.start
        others = [(p, first.breakaway_times + times) for p, times in basins(second)]
    free = [*free, *inertia]
    joint = Problem(motions, vector, free, model, noise)
    joint.breakaway_times = begins
    if len(others) > 1:
        likeliest_together(joint, others)
    residual = fit_beside_inertia(joint, refine)
    names = tuple(n for n, k in INDEX.items() if k in free)
    achieved, floor = named_covariances(covariances(joint), joint, names)
    # A slip of twenty samples that the filter loses is one segment of many; missing physics is in
    # most of them.
    inside = np.clip(
        residual[: len(residual) - joint.breakaways], -HUBER_THRESHOLD, HUBER_THRESHOLD
    )
    return Refined(
        values={**start, **unpack(joint.start, [n for n in INDEX if n in start])},
        covariance=achieved,
        floor=floor,
        names=names,
        innovation_rms=float(np.sqrt(np.mean(inside**2))),
        whiteness=float(np.mean(inside[1:] * inside[:-1]) / np.mean(inside**2)),
        noise=joint.noise,
        repeating_share=repeating_share(joint) if correlated else 0.0,
        torque_scatter=torque_noise(motions),
        evaluations=evaluations + joint.evaluations,
        iterations=joint.iterations,
        breakaways=joint.breakaways,
        likelihood_drop=likelihood_drop,
        equations_chi2=chi2,
        joint=joint,
        starts=tuple(starts),
    )
