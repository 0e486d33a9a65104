"""Computes the unloaded, loaded and joint fit by prediction errors, starting from the values of the
equation error.

The unknowns are the parameters and the breakaway time of each segment. A breakaway time is bound to
the static limit by the torque that is measured at this time (tie, M22). Least squares with fixed
inertia lead into the basin of the true values: the assumed torque noise is large at first and is
then reduced, because the cost is smoother if the filter gives the encoder more weight. At the
estimated noise level the likelihood is maximised. The inertia follows from its estimating equation,
because least squares and likelihood give a biased inertia
(:mod:`identification.estimate.inertia.estimating_equations`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.inertia.estimating_equations import SOLVED, fit_beside_inertia
from identification.estimate.likelihood.searches import (
    SAME_END,
    LoadedFit,
    basins,
    likeliest_together,
    refine,
    refine_from,
    spent,
)
from identification.estimate.likelihood.starts import breakaway_starts
from identification.estimate.likelihood.unloaded import solve_unloaded
from identification.estimate.uncertainty.covariance import covariances, named_covariances
from identification.filter.likelihood import Point, Searched
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
    MU_C,
    OFFSET,
    OMEGA_SL,
    pack,
    unpack,
)
from identification.numerics.arrays import Array
from identification.numerics.progress import Progress, silent
from identification.recording import Model
from identification.result import Starts


@dataclass(frozen=True)
class Refined:
    """A refined estimate.

    Attributes:
        values: Value of each parameter by name.
        covariance: Covariance of the fitted ``names``, shape (p, p), in the units of the values.
        floor: Cramer-Rao bound of the covariance
            (:mod:`identification.estimate.uncertainty.cramer_rao`), shape (p, p).
        names: Names of the fitted parameters, in the order of the covariance.
        innovation_rms: Rms of normalised innovations with variance inflation; 1 if the noise model
            is right.
        whiteness: Correlation of neighbouring innovations, with variance inflation.
        noise: Noise of torque and angle.
        repeating_share: Share of the correlated noise that repeats in matching half cycles (M26);
            zero without correlated noise.
        torque_scatter: Torque scatter from sample to sample, N m rms.
        evaluations: Runs of the filter over all recordings.
        iterations: Iterations of the joint fit.
        breakaways: Number of segments.
        likelihood_drop: Deviance at the end of the loaded fit less the deviance at its likeliest
            start point; positive if least squares at a raised noise level left the basin of this
            start point.
        equations_chi2: Chi-square of the unloaded fit's estimating equations (M29).
        joint: The estimate in the joint experiment.
        starts: Search ends of each search.
        left_out: Names of recordings to which prediction errors do not apply.
        stopped: Whether the unloaded or the loaded fit reached its greatest number of filter runs.
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
    joint: Point
    starts: tuple[Starts, ...] = ()
    left_out: tuple[str, ...] = ()
    stopped: bool = False


def _sought(model: Model) -> tuple[list[int], list[int], list[int]]:
    """Return the indices of the parameters that are not fixed: of the system load, of the working
    load, and of the inertia.
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


def _first_point(
    unloaded: Sequence[Motion],
    start: Mapping[str, float],
    system: Sequence[int],
    model: Model,
    correlated: bool,
) -> Point:
    """Return the start point of the unloaded fit: the values of the equation error, with the
    likeliest noise at these values.
    """
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
) -> Refined:
    """Fit the unloaded recordings, then the loaded recordings, then all recordings jointly.

    Args:
        unloaded: Unloaded recordings.
        loaded: Loaded recordings, may be empty.
        start: Equation-error values of all parameters.
        model: Declared terms and fixed values.
        correlated: Whether the torque noise has a correlated part.
        progress: Called at the start of each of the three fits.
    """
    system, load, inertia = _sought(model)
    progress(f"unloaded fit, recordings: {len(unloaded)}", 0.0)
    begun = _first_point(unloaded, start, system, model, correlated)
    first, chi2s = solve_unloaded(begun, system, inertia)
    starts = [
        Starts("unloaded", "chi-square of the estimating equations", chi2s, SOLVED, absolute=True)
    ]
    evaluations, likelihood_drop, stopped = begun.filter.evaluations, 0.0, spent(begun)
    free, ends = [*system, *inertia], [first.point]
    if loaded:
        progress(f"loaded fit, recordings: {len(loaded)}", 0.0)
        second, count = _loaded_fit(first.point, loaded, load, model)
        evaluations, likelihood_drop = evaluations + count, second.drop
        stopped |= second.stopped
        starts.append(_loaded_starts(second))
        free, ends = [*system, *load, *inertia], basins(second)
    progress(f"joint fit, recordings: {len(unloaded) + len(loaded)}", 0.0)
    fitted = _joint_fit(first.point, (*unloaded, *loaded), free, ends, model)
    joint = fitted.point
    names = tuple(n for n, k in INDEX.items() if k in free)
    residual = joint.weighted().residuals(joint.origin())
    achieved, floor = named_covariances(covariances(joint), joint, names)
    innovation_rms, whiteness = innovation_statistics(residual, joint.breakaways)
    return Refined(
        values={**start, **unpack(joint.vector, [n for n in INDEX if n in start])},
        covariance=achieved,
        floor=floor,
        names=names,
        innovation_rms=innovation_rms,
        whiteness=whiteness,
        noise=joint.noise,
        repeating_share=repeating_share(joint) if correlated else 0.0,
        torque_scatter=torque_noise(joint.motions),
        evaluations=evaluations + joint.filter.evaluations,
        iterations=fitted.iterations,
        breakaways=joint.breakaways,
        likelihood_drop=likelihood_drop,
        equations_chi2=first.chi2,
        joint=joint,
        starts=tuple(starts),
        stopped=stopped,
    )


def _loaded_fit(
    first: Point, loaded: Sequence[Motion], load: Sequence[int], model: Model
) -> tuple[LoadedFit, int]:
    """Return the fit of the load parameters, with the other parameters fixed at the end of the
    unloaded fit, and the number of filter runs.
    """
    begun = Point.of(loaded, first.vector, load, model, first.noise)
    found = refine_from(begun, breakaway_starts(begun, MU_C, LOAD_RISE, OMEGA_SL))
    return found, begun.filter.evaluations


def _loaded_starts(found: LoadedFit) -> Starts:
    ends = tuple(end.deviance for end in found.ends if math.isfinite(end.deviance))
    return Starts("loaded", "-2 log likelihood", ends, min(ends, default=math.inf) + SAME_END)


def _joint_fit(
    first: Point,
    motions: Sequence[Motion],
    free: Sequence[int],
    ends: Sequence[Point],
    model: Model,
) -> Searched:
    """Fit all recordings jointly; of several ends of the loaded fit, the likeliest is the start
    point.

    Args:
        first: End of the unloaded fit.
        motions: Unloaded recordings, then loaded recordings.
        free: Free parameters.
        ends: Ends of the loaded fit, or the end of the unloaded fit if no recording is loaded.
        model: Declared terms and fixed values.
    """
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
