"""What the recordings are taken to say: the equation error's values, refined by prediction errors where those apply."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from identification.estimate.equation_error.block_sandwich import block_sandwich
from identification.estimate.likelihood import stages as staged
from identification.estimate.likelihood.acceptance import try_refinements
from identification.estimate.likelihood.replicates import Bias, likelihood_bias
from identification.estimate.likelihood.stages import Refined
from identification.estimate.uncertainty.covariance import covariances, named_covariances
from identification.estimate.uncertainty.parameter_table import typical_error
from identification.filter.breakaway_times import settle_anywhere
from identification.filter.likelihood import Problem
from identification.filter.noise_level import CLIP
from identification.filter.segments import motion
from identification.model.ladder import NOMINAL
from identification.model.parameters import STRIBECK_TERMS, pack, unpack
from identification.numerics.arrays import Array
from identification.numerics.spread import Spread
from identification.prepare import Prepared
from identification.recording import Model, Recording
from identification.result import Convergence, MeasuredNoise, Starts


@dataclass(frozen=True)
class Found:
    """What the recordings are taken to say: refined where that applies, else by the equation error.

    Attributes:
        values: Name to value.
        spread: Of those that were fitted.
        floors: Name to the least half width; empty without refinement.
        taken: The refinement, where its values are taken.
        starts: Of its searches, taken or not.
        stages: How it went.
        warnings: Why it was not taken.
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
) -> Found:
    """Refine equation-error values by prediction errors, and judge whether the refined ones are to be taken."""
    plain = Found(values, block_sandwich(active, values, names, model.alpha))
    refined, fault = try_refinements(
        lambda correlated: refine_recordings(recordings, values, names, model, correlated),
        lambda v: typical_error(active, v, model.alpha),
        values,
    )
    stages = () if refined is None else (joint_convergence(refined),)
    if refined is None or fault:
        starts = () if refined is None else refined.starts
        kept = f"values are those of the equation error at {bandwidth_Hz:.3g} Hz: {fault}"
        return replace(plain, starts=starts, stages=stages, warnings=(kept,))
    bias = likelihood_bias(refined.joint, refined.names)
    found = Found(
        dict(refined.values),
        spread_of(refined),
        floors_of(refined.names, refined.floor),
        refined,
        refined.starts,
        stages,
    )
    if bias is None:
        return found
    found = _unbiased(found, bias)
    return _with_instruments(found, refined.joint, bias) if bias.rehearsals else found


def _unbiased(found: Found, bias: Bias) -> Found:
    """Take the likelihood's bias off; what so few rehearsals leave open of it is in the covariance."""
    values = {name: value - bias.shifts.get(name, 0.0) for name, value in found.values.items()}
    rises = all(values[static] >= values[coulomb] for coulomb, static, _ in STRIBECK_TERMS if static in values)
    positive = all(values[name] > 0.0 for name in ("omega_sf", "omega_sL") if name in values)
    if not (rises and positive):
        return found
    covariance = found.spread.covariance + _left_open(bias, found.spread.names)
    return replace(found, values=values, spread=replace(found.spread, covariance=covariance))


def _left_open(bias: Bias, names: Sequence[str]) -> Array:
    return np.diag([bias.variances[name] for name in names])


def _with_instruments(found: Found, joint: Problem, bias: Bias) -> Found:
    """Solve the inertia's equation with the rehearsals' instruments too; the others follow. The floor is theirs.

    It is solved where the likelihood's bias is taken off already, as rehearsals solve it at their true values: what the
    others are off by moves it in second order, and several deviations of that count.
    """
    names, there = found.spread.names, copy(joint)
    there.start = pack(found.values, joint.alpha)
    settle_anywhere(there, CLIP)
    solved = covariances(there, bias.rehearsals)
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
) -> Refined | str:
    """Return the refined estimate, or in words why the prediction error does not apply.

    Args:
        recordings: To fit.
        values: Equation-error values of all parameters.
        names: Those that are asked for.
        model: Declared terms and fixed values.
        correlated: Whether the torque's noise is given a correlated part.
    """
    if not names:
        return "every parameter is fixed"
    if model.friction != NOMINAL:
        return f"they know the {NOMINAL} friction only, and {model.friction} is declared"
    if not {"Ms", "omega_sf"} <= set(names) | set(model.fixed):
        return "no rise of friction toward rest was found to refine"
    motions = {id(r): motion(r) for r in recordings}
    for r in recordings:
        if motions[id(r)] is None:
            return (
                f"prediction errors need even sampling, a quantised encoder, measured torque and two breakaways from "
                f"rest, and {r.name} lacks one of them"
            )
    found = [m for m in motions.values() if m is not None]
    unloaded = [m for m in found if m.recording.stage == "unloaded"]
    loaded = [m for m in found if m.recording.stage == "loaded"]
    if not values["J"] > 0.0:
        return "the equation error finds no inertia to start from"
    if not unloaded:
        return "there is no unloaded recording to start from"
    if loaded and not {"mu_s", "omega_sL"} <= set(names) | set(model.fixed):
        # At the bandwidth of the equation error a rise may not show, and in the breakaways it does.
        values = {**values, "omega_sL": model.fixed.get("omega_sL", values["omega_sf"])}
    try:
        return staged.refine_stages(unloaded, loaded, values, model, correlated)
    except np.linalg.LinAlgError:
        return "these recordings do not pin the parameters of the prediction error"


def spread_of(refined: Refined) -> Spread:
    """Return the spread of refined values."""
    return Spread(refined.names, refined.covariance, math.inf)


def noise_of(refined: Refined, unit: str) -> MeasuredNoise:
    """Return the noise that refined values were found with."""
    noise, steps = refined.noise, [math.sqrt(12.0 * m.angle_variance) for m in refined.joint.motions]
    return MeasuredNoise(noise.torque, noise.correlated, noise.correlation_s, noise.angle, max(steps), unit)


def floors_of(names: tuple[str, ...], floor: Array) -> dict[str, float]:
    """Return name to the half width of the 90 % interval of an estimate at the Cramer-Rao bound ``floor``, (p, p)."""
    exact = Spread(names, floor, math.inf)
    return {name: exact.half_width(name) for name in names}


def joint_convergence(refined: Refined) -> Convergence:
    """Return how the joint refinement went."""
    return Convergence(
        stage="joint",
        method="prediction error",
        evaluations=refined.evaluations,
        generations=refined.iterations,
        cost=refined.innovation_rms,
        cost_unit="of the noise",
    )
