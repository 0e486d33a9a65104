"""Computes the final estimate: by prediction errors if the acceptance tests pass, else by equation
error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.estimate.equation_error.block_sandwich import block_sandwich
from identification.estimate.likelihood import stages as staged
from identification.estimate.likelihood.acceptance import try_refinements
from identification.estimate.likelihood.replicates import Bias, likelihood_bias
from identification.estimate.likelihood.stages import Refined
from identification.estimate.uncertainty.covariance import covariances, named_covariances
from identification.estimate.uncertainty.parameter_table import typical_error
from identification.estimator_settings import DEFAULT, EstimatorSettings
from identification.filter.breakaway_times import search_breakaway_times
from identification.filter.likelihood import Point
from identification.filter.noise_level import HUBER_THRESHOLD
from identification.filter.segments import motion
from identification.model.ladder import NOMINAL
from identification.model.parameters import STRIBECK_TERMS, pack, unpack
from identification.numerics.arrays import Array
from identification.numerics.progress import Progress, silent
from identification.numerics.spread import Spread
from identification.prepare import Prepared
from identification.recording import Model, Recording
from identification.result import Convergence, MeasuredNoise, Starts

NEEDED = (
    "prediction errors need even sampling, a quantised encoder, a measured torque or current, and "
    "two breakaways from rest"
)


@dataclass(frozen=True)
class Found:
    """The final estimate, with the steps that led to it.

    Attributes:
        values: Name to value.
        spread: Covariance of the fitted parameters.
        floors: Half width of the 90 % interval at the Cramer-Rao bound, by name; empty without an
            accepted refinement.
        taken: The refinement, if it is accepted.
        starts: Search ends of the refinement, whether accepted or not.
        stages: Record of each search.
        warnings: Reason why the refinement was rejected.
    """

    values: dict[str, float]
    spread: Spread
    floors: Mapping[str, float] = field(default_factory=dict)
    taken: Refined | None = None
    starts: tuple[Starts, ...] = ()
    stages: tuple[Convergence, ...] = ()
    warnings: tuple[str, ...] = ()


def refine(
    recordings: Sequence[Recording],
    active: Sequence[Prepared],
    values: dict[str, float],
    names: Sequence[str],
    model: Model,
    bandwidth_Hz: float,
    rng: np.random.Generator,
    settings: EstimatorSettings = DEFAULT,
    progress: Progress = silent,
) -> Found:
    """Refine equation-error values by prediction errors, apply the acceptance tests, and correct
    the bias.

    Args:
        recordings: Recordings to fit.
        active: The same recordings, prepared for the equation error.
        values: Equation-error values of all parameters.
        names: Parameters to fit.
        model: Declared terms and fixed values.
        bandwidth_Hz: Bandwidth of the equation error.
        rng: Random generator for the noise of the simulated replicates.
        settings: Settings of the estimator.
        progress: Called at the start of each fit, and with every pair of replicates.
    """
    plain = Found(values, block_sandwich(active, values, names, model.alpha))
    refined, fault = try_refinements(
        lambda correlated: refine_recordings(
            recordings, values, names, model, correlated, progress
        ),
        lambda v: typical_error(active, v, model.alpha),
        values,
        settings.acceptance,
    )
    stages = () if refined is None else (joint_convergence(refined),)
    if refined is None or fault:
        starts = () if refined is None else refined.starts
        kept = f"values are those of the equation error at {bandwidth_Hz:.3g} Hz: {fault}"
        return replace(plain, starts=starts, stages=stages, warnings=(kept,))
    bias = likelihood_bias(refined.joint, refined.names, rng, settings.replicates, progress)
    found = Found(
        dict(refined.values),
        spread_of(refined),
        floors_of(refined.names, refined.floor),
        refined,
        refined.starts,
        stages,
        partly_used(refined.left_out),
    )
    if bias is None:
        return found
    found = _unbiased(found, bias)
    return _with_instruments(found, refined.joint, bias) if bias.replicates else found


def _unbiased(found: Found, bias: Bias) -> Found:
    """Subtract the bias (M36) and add its variance (M42); a correction that would lead beyond the
    range of its parameter is omitted.
    """
    values = {name: value - bias.shifts.get(name, 0.0) for name, value in found.values.items()}
    rises = all(
        values[static] >= values[coulomb]
        for coulomb, static, _ in STRIBECK_TERMS
        if static in values
    )
    positive = all(values[name] > 0.0 for name in ("omega_sf", "omega_sL") if name in values)
    if not (rises and positive):
        return found
    covariance = found.spread.covariance + _left_open(bias, found.spread.names)
    return replace(found, values=values, spread=replace(found.spread, covariance=covariance))


def _left_open(bias: Bias, names: Sequence[str]) -> Array:
    return np.diag([bias.variances[name] for name in names])


def _with_instruments(found: Found, joint: Point, bias: Bias) -> Found:
    """Solve the estimating equation of the inertia with instruments from matching half cycles and
    from replicates (M32); the other parameters change with the inertia.

    Floors are computed from the replicates.

    The equation is solved at the bias-corrected values of the other parameters, because in a
    replicate the other parameters have the values with which it was simulated. Errors of the other
    parameters have an effect of second order, which is not negligible if these errors are several
    standard deviations.
    """
    names = found.spread.names
    begun = replace(joint, vector=pack(found.values, joint.alpha))
    there = search_breakaway_times(begun, HUBER_THRESHOLD)
    solved = covariances(there, bias.replicates)
    x = there.origin()
    x[: len(solved.step)] += solved.step
    values = {**found.values, **unpack(there.parameters(x), names)}
    achieved, floor = named_covariances(solved, there, names)
    spread = replace(found.spread, covariance=achieved + _left_open(bias, names))
    return replace(found, values=values, spread=spread, floors=floors_of(names, floor))


def refine_recordings(
    recordings: Sequence[Recording],
    values: Mapping[str, float],
    names: Sequence[str],
    model: Model,
    correlated: bool = False,
    progress: Progress = silent,
) -> Refined | str:
    """Return the refined estimate, or a text with the reason why prediction errors do not apply.

    Args:
        recordings: Recordings to fit.
        values: Equation-error values of all parameters.
        names: Parameters to fit.
        model: Declared terms and fixed values.
        correlated: Whether the torque noise has a correlated part.
        progress: Called at the start of each fit.
    """
    if not names:
        return "every parameter is fixed"
    if model.friction != NOMINAL:
        return (
            f"prediction errors support only the friction model {NOMINAL}, but the model "
            f"{model.friction} is declared"
        )
    if not {"Ms", "omega_sf"} <= set(names) | set(model.fixed):
        return "the equation error finds no static friction above Coulomb friction"
    motions = [motion(r) for r in recordings]
    found = [m for m in motions if m is not None]
    left_out = tuple(r.name for r, m in zip(recordings, motions, strict=True) if m is None)
    unloaded = [m for m in found if m.recording.stage == "unloaded"]
    loaded = [m for m in found if m.recording.stage == "loaded"]
    if not values["J"] > 0.0:
        return "the equation error finds no inertia above 0, with which a refinement could start"
    for condition, usable in (("unloaded", unloaded), ("loaded", loaded)):
        unusable = [r.name for r in recordings if r.stage == condition]
        if unusable and not usable:
            return f"{NEEDED}; {', '.join(unusable)} {_lack(unusable)} one of these"
    if not unloaded:
        return "a refinement by prediction errors needs an unloaded recording"
    if loaded and not {"mu_s", "omega_sL"} <= set(names) | set(model.fixed):
        # A static friction above Coulomb friction may be visible in the breakaways even if the
        # equation error, at its bandwidth, does not show it.
        values = {**values, "omega_sL": model.fixed.get("omega_sL", values["omega_sf"])}
    try:
        refined = staged.refine_stages(unloaded, loaded, values, model, correlated, progress)
    except np.linalg.LinAlgError:
        return (
            "the search by prediction errors finds no solution: the recordings do not determine "
            "the parameters, or the machine has physics that the model lacks"
        )
    return replace(refined, left_out=left_out)


def partly_used(left_out: Sequence[str]) -> tuple[str, ...]:
    """Return the warning that prediction errors do not use some recordings; empty if they use
    all.
    """
    if not left_out:
        return ()
    names = ", ".join(left_out)
    return (
        f"{names}: used by the equation error only, for the start values; {NEEDED}, and "
        f"{'this recording' if len(left_out) == 1 else 'each of these recordings'} lacks one of "
        "these",
    )


def _lack(names: Sequence[str]) -> str:
    return "lacks" if len(names) == 1 else "lack"


def spread_of(refined: Refined) -> Spread:
    """Return the covariance and the degrees of freedom of refined values."""
    return Spread(refined.names, refined.covariance, math.inf)


def noise_of(refined: Refined, unit: str) -> MeasuredNoise:
    """Return the measured noise of a refined estimate, with torques in ``unit``."""
    noise, steps = (
        refined.noise,
        [math.sqrt(12.0 * m.angle_variance) for m in refined.joint.motions],
    )
    return MeasuredNoise(
        noise.torque, noise.correlated, noise.correlation_s, noise.angle, max(steps), unit
    )


def floors_of(names: tuple[str, ...], floor: Array) -> dict[str, float]:
    """Return the half width of the 90 % interval of each parameter, by name, at the Cramer-Rao
    bound ``floor``, shape (p, p).
    """
    exact = Spread(names, floor, math.inf)
    return {name: exact.half_width(name) for name in names}


def joint_convergence(refined: Refined) -> Convergence:
    """Return the record of the joint fit."""
    return Convergence(
        stage="joint",
        method="prediction error",
        evaluations=refined.evaluations,
        generations=refined.iterations,
        cost=refined.innovation_rms,
        cost_unit="of the noise",
    )
