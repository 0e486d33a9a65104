"""Refinement by prediction errors: all stages and all breakaways jointly, from the equation-error start.

Unknown beside the parameters is when each stretch breaks away. Each such time is tied to the static limit by the torque
measured then. Least squares leads into the right basin, with the inertia held: the torque noise is first assumed large
and then lowered, as a filter that trusts the encoder more has a smoother cost. At the noise's own level the likelihood
is searched. Instrumental variables then give the inertia, which both put far off, and the likelihood the rest beside it
(:mod:`identification.estimate.inertia.estimating_equations`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.inertia.estimating_equations import SOLVED, beside_inertia, defect, solve
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
    CLIP,
    likeliest_noise,
    repeated,
    torque_noise,
    with_correlated,
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
"""Begin of a solution of the unloaded stage: kernel's vector, breakaway times, inertia over the vector's."""
_Solved = tuple[float, Array, list[Array], Noise]
"""End of a solution of the unloaded stage: defect, kernel's vector, breakaway times, noise."""
_AGAIN = 2
"""Solutions begun from the best end where none of the starts is solved, as with an inertia that starts far off; one
that leads to nothing better is the last."""
_INERTIAS = (1.0, 0.8, 0.6, 1.25)
"""Inertias tried, over the equation error's; it errs upward under noise."""
_FAR = (3.0, 10.0, 30.0, 100.0, 0.3, 0.1)
"""Those tried where none of these leads anywhere: of a shaft that slips through the fall of friction, short and fast,
the equation error may leave a fiftieth."""


@dataclass(frozen=True)
class Refined:
    """A refined estimate.

    Attributes:
        values: Name to value.
        covariance: Of the fitted ``names``, shape (p, p), in the values' own units.
        floor: The least covariance possible (:mod:`identification.estimate.uncertainty.cramer_rao`), of the same shape.
        names: Fitted names in that order.
        innovation_rms: 1 where the noise model holds; of innovations as far as they are believed.
        whiteness: Correlation of neighbouring innovations, the same.
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


def solve_first_stage(problem: Problem, system: Sequence[int], inertia: Sequence[int]) -> float:
    """Solve the unloaded stage from one start after the other, until the estimating equations are solved.

    Least squares with the inertia held lead into the basin of the inertia they are given; the equation error's may be
    off by half, and at times by far more. Leaves the problem at the best end; returns its defect.

    Raises:
        numpy.linalg.LinAlgError: The instruments pin the parameters from none of the starts.
    """
    vector, begins, noise = problem.start, problem.begins, problem.noise
    free = system, inertia
    both = bool(system) and bool(inertia)
    problem.free = tuple(system)
    searched = breakaway_starts(problem, MC, SYSTEM_RISE, OMEGA_SF) if system else []
    starts = [(vector, begins, share) for share in (_INERTIAS if inertia else (1.0,))]
    starts += [(p, times, share) for p, times in searched[:STARTS] for share in _INERTIAS[: len(inertia) * 3]]
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
    unsolved, problem.start, problem.begins, problem.noise = best
    return unsolved


def _far(problem: Problem, vector: Array, noise: Noise, system: Sequence[int]) -> Iterator[_Start]:
    """Yield starts at inertias far from the equation error's, each with the breakaways that are likeliest with it."""
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
    """Solve from one start after the other until the equations are solved; return the best end, ``best`` among them."""
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
    problem.start[INERTIA] *= share
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


def _sought(model: Model) -> tuple[list[int], list[int], list[int]]:
    """Return the places of what is not fixed: of the system's parameters, of the load's, and the inertia's."""
    fixed = {INDEX[n] for n in model.fixed if n in INDEX}
    system = [k for n, k in INDEX.items() if n in ("Mc", "Ms", "omega_sf", "sigma_2") and k not in fixed]
    if "offset" in model.terms and OFFSET not in fixed:
        system.append(OFFSET)
    load = [k for n, k in INDEX.items() if n in ("mu_c", "mu_s", "omega_sL", "mu_2") and k not in fixed]
    return system, load, [] if INERTIA in fixed else [INERTIA]


def _first_problem(
    unloaded: Sequence[Motion], start: Mapping[str, float], system: Sequence[int], model: Model, correlated: bool
) -> Problem:
    """Return the first stage's problem at the equation error's values, with the noise that is likeliest there."""
    first = Problem(unloaded, pack(start, model.alpha), system, model, Noise(torque_noise(unloaded)))
    # Without load the equation error is a good start already; with it, friction falls too steeply to be filtered.
    first.begins = [m.static_crossing(static_limit(first.start, m)) for m in unloaded]
    if correlated:
        first.noise = with_correlated(first)
    first.noise = likeliest_noise(first)
    return first


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
    system, load, inertia = _sought(model)
    first = _first_problem(unloaded, start, system, model, correlated)
    unsolved = solve_first_stage(first, system, inertia)
    starts = [Starts("unloaded", "defect of the estimating equations", tuple(first.ends), SOLVED, absolute=True)]
    evaluations = first.evaluations
    motions, begins, noise, free, strayed = tuple(unloaded), list(first.begins), first.noise, system, 0.0
    vector, others = first.start, []
    if loaded:
        second = Problem(loaded, vector, load, model, noise)
        strayed = refine_from(second, breakaway_starts(second, MU_C, LOAD_RISE, OMEGA_SL))
        evaluations += second.evaluations
        ends = tuple(end for _, end, *_ in second.reached if math.isfinite(end))
        starts.append(Starts("loaded", "-2 log likelihood", ends, min(ends, default=math.inf) + SAME_END))
        motions, begins, free = (*motions, *loaded), begins + second.begins, system + load
        vector = second.start
        others = [(p, first.begins + times) for p, times in basins(second)]
    free = [*free, *inertia]
    joint = Problem(motions, vector, free, model, noise)
    joint.begins = begins
    if len(others) > 1:
        likeliest_together(joint, others)
    residual = beside_inertia(joint, refine)
    names = tuple(n for n, k in INDEX.items() if k in free)
    achieved, floor = named_covariances(covariances(joint), joint, names)
    # A slip of twenty samples that the filter loses is one of many strokes, and physics that is missing is in most.
    inside = np.clip(residual[: len(residual) - joint.breakaways], -CLIP, CLIP)
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
