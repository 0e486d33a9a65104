"""The default method: both stages by variable projection, then refined by prediction errors where those apply."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from identification.estimate import prediction_error, varpro
from identification.estimate.acceptance import try_refinements
from identification.estimate.assemble import RISES, fit_of, parameter_table, trace_of, typical_error, units_of
from identification.estimate.bootstrap import bootstrap
from identification.estimate.covariance import covariances, named_covariances
from identification.estimate.prediction_error import Refined
from identification.estimate.prediction_problem import unpack
from identification.estimate.profile import profiles
from identification.estimate.regression import Stage, loaded_stage, require_motion, unloaded_stage
from identification.estimate.rehearsed import Bias, likelihood_bias
from identification.estimate.result import (
    SYSTEM_PARAMETERS,
    Convergence,
    Identification,
    MeasuredNoise,
    Profile,
    Resampled,
    Starts,
)
from identification.estimate.stretches import motion
from identification.estimate.stroke_curves import Rehearsal
from identification.estimate.tradeoff import least_pinned, tradeoffs
from identification.estimate.uncertainty import Spread, block_sandwich
from identification.model.ladder import NOMINAL
from identification.prepare import Prepared, default_bandwidth, prepare, torque_unit
from identification.recording import Array, Dataset, Model, Recording, RecordingError

Progress = Callable[[str, float], None]


def identify(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    profile: bool = False,
    draws: int = 0,
) -> Identification:
    """Identify the nine parameters in two stages (five where nothing is loaded).

    Args:
        dataset: Recordings and what is declared or fixed; ``validate`` recordings are scored once at the end.
        bandwidth_Hz: Of torque and regressors; None chooses the least over the recordings of what each bears.
        rng: Draws the stretches of the bootstrap.
        progress: Called with a stage's name and the share done.
        profile: Whether to profile the likelihood of every parameter as well, which takes several times as long.
        draws: Bootstrap draws, 0 for none.

    Raises:
        RecordingError: The recordings cannot pin the model; the message says what is missing.
    """
    started = perf_counter()
    tell = progress or (lambda _stage, _share: None)
    fitted = dataset.part("fit")
    if not fitted:
        raise RecordingError("no recording has role 'fit'; at least one is needed")
    if bandwidth_Hz is None:
        bandwidth_Hz = min(default_bandwidth(r) for r in fitted)
    tell("unloaded", 0.0)
    every = [prepare(r, bandwidth_Hz) for r in dataset.recordings]
    active = [p for p in every if p.recording.role == "fit"]
    stage_of = {stage: [p for p in active if p.recording.stage == stage] for stage in ("unloaded", "loaded")}
    model = dataset.model
    values, stages = solve_stages(stage_of["unloaded"], stage_of["loaded"], model, tell)
    names = free_names(values, model)
    tell("joint", 0.0)
    found = _refined(fitted, active, values, names, model, bandwidth_Hz)
    values, units, warnings = found.values, units_of(active), list(found.warnings)
    stages += found.stages
    curves, resampled, notes = _asked(found, units, profile, draws, rng, tell)
    warnings += notes
    tell("joint", 1.0)
    fits = {p.recording.name: fit_of([p], values, model.alpha) for p in every}
    validate = [p for p in every if p.recording.role == "validate"]
    parameters = parameter_table(active, values, found.spread, model, found.floors)
    for p in active:
        if not np.any(p.used):
            warnings.append(f"{p.recording.name}: no sample is in motion and resolved at {p.bandwidth_Hz:.3g} Hz")
    return Identification(
        method="default",
        motion=fitted[0].bench.motion,
        alpha=model.alpha,
        parameters=parameters,
        fit=fit_of(active, values, model.alpha, validate),
        stages=tuple(stages),
        fitted=dict(values),
        friction=model.friction,
        starts=found.starts,
        tradeoffs=tradeoffs(found.spread, values, units),
        least_pinned=least_pinned(found.spread, values),
        noise=None if found.taken is None else noise_of(found.taken, torque_unit(fitted[0])),
        profiles=curves,
        resampled=resampled,
        warnings=tuple(warnings),
        traces=tuple(trace_of(p, values, model.alpha) for p in every),
        fits_by_recording=fits,
        evaluations=sum(s.evaluations for s in stages),
        seconds=perf_counter() - started,
    )


def _asked(
    found: _Found,
    units: Mapping[str, str],
    profile: bool,
    draws: int,
    rng: np.random.Generator | None,
    tell: Progress,
) -> tuple[tuple[Profile, ...], tuple[Resampled, ...], list[str]]:
    """Return profiles and bootstrap as far as asked for, and why not where there are none."""
    if found.taken is None:
        what = " and ".join(w for w, asked in (("profiles", profile), ("bootstrap", draws)) if asked)
        return (), (), [f"no {what}: of the prediction errors alone, which were not taken"] if what else []
    curves: tuple[Profile, ...] = ()
    resampled: tuple[Resampled, ...] = ()
    # Both are about the likeliest values: they move with what the estimate was moved by.
    moved = {name: found.values[name] - found.taken.values[name] for name in found.taken.names}
    if profile:
        walked = profiles(found.taken, units, lambda share: tell("profiles", share))
        curves = tuple(curve.moved(moved[curve.name]) for curve in walked)
    if draws:
        rng = rng or np.random.default_rng(0)
        drawn = bootstrap(found.taken, units, draws, rng, lambda share: tell("bootstrap", share))
        resampled = tuple(d.moved(moved[d.name]) for d in drawn)
    return curves, resampled, []


@dataclass(frozen=True)
class _Found:
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


def _refined(
    recordings: Sequence[Recording],
    active: Sequence[Prepared],
    values: dict[str, float],
    names: Sequence[str],
    model: Model,
    bandwidth_Hz: float,
) -> _Found:
    """Refine equation-error values by prediction errors, and judge whether the refined ones are to be taken."""
    plain = _Found(values, block_sandwich(active, values, names, model.alpha))
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
    found = _Found(
        dict(refined.values),
        spread_of(refined),
        floors_of(refined.names, refined.floor),
        refined,
        refined.starts,
        stages,
    )
    if bias is None:
        return found
    if bias.rehearsals:
        found = _with_instruments(found, refined, bias.rehearsals)
    return _unbiased(found, bias)


def _with_instruments(found: _Found, refined: Refined, rehearsals: Sequence[Rehearsal]) -> _Found:
    """Solve the inertia's equation with the rehearsals' instruments too; the others follow. The floor is theirs."""
    joint, names = refined.joint, refined.names
    solved = covariances(joint, rehearsals)
    x = joint.origin()
    x[: len(solved.step)] += solved.step
    values = {**found.values, **unpack(joint.parameters(x), names)}
    achieved, floor = named_covariances(solved, joint, names)
    spread = replace(found.spread, covariance=achieved)
    return replace(found, values=values, spread=spread, floors=floors_of(names, floor))


def _unbiased(found: _Found, bias: Bias) -> _Found:
    """Take the likelihood's bias off; what so few rehearsals leave open of it is in the covariance."""
    values = {name: value - bias.shifts.get(name, 0.0) for name, value in found.values.items()}
    rises = all(values[static] >= values[coulomb] for coulomb, static, _ in RISES if static in values)
    positive = all(values[name] > 0.0 for name in ("omega_sf", "omega_sL") if name in values)
    if not (rises and positive):
        return found
    names = found.spread.names
    covariance = found.spread.covariance + np.diag([bias.variances[name] for name in names])
    return replace(found, values=values, spread=replace(found.spread, covariance=covariance))


def solve_stages(
    unloaded: Sequence[Prepared], loaded: Sequence[Prepared], model: Model, tell: Progress
) -> tuple[dict[str, float], list[Convergence]]:
    """Solve both stages by variable projection; return all values by name and how each search went.

    Raises:
        RecordingError: A stage without motion, or loaded recordings alone, which cannot tell system from load friction.
    """
    values: dict[str, float] = {}
    stages: list[Convergence] = []
    if unloaded:
        require_motion(unloaded)
        values, record = _solve(unloaded_stage(unloaded, model))
        stages.append(record)
    else:
        missing = [n for n in SYSTEM_PARAMETERS if n not in model.fixed]
        if missing:
            raise RecordingError(
                "no unloaded recording to fit: system and load friction cannot be told apart at one load; record an "
                f"unloaded stage, or fix {', '.join(missing)}"
            )
        values = {n: float(v) for n, v in model.fixed.items()}
    tell("unloaded", 1.0)
    if loaded:
        require_motion(loaded)
        found, record = _solve(loaded_stage(loaded, model, values))
        values = {**values, **found}
        stages.append(record)
    tell("loaded", 1.0)
    return values, stages


def _solve(stage: Stage) -> tuple[dict[str, float], Convergence]:
    solution = varpro.solve(stage.design, *stage.speed_range())
    samples = max(sum(int(np.sum(p.used)) for p in stage.prepared), 1)
    history = [
        stage.named(float(w), c)
        for w, c in zip(solution.omega_history, solution.coefficient_history, strict=True)
    ]  # fmt: skip
    return stage.named(solution.omega_s, solution.coefficients), Convergence(
        stage=stage.name,
        method="variable projection",
        evaluations=solution.evaluations,
        generations=solution.evaluations,
        cost=math.sqrt(solution.cost / samples),
        cost_unit=f"{torque_unit(stage.prepared[0].recording)} rms",
        cost_history=np.sqrt(solution.cost_history / samples),
        parameter_history={n: np.array([h[n] for h in history]) for n in stage.names},
    )


def free_names(values: Mapping[str, float], model: Model) -> tuple[str, ...]:
    """Return the names that the data are asked for: not fixed, and not a Stribeck term that is absent."""
    falling = [names for names in RISES if names[1] in values]
    flat = {names for names in falling if not values[names[1]] > values[names[0]]}
    absent = {static for _, static, _ in flat} | {speed for _, _, speed in flat}
    absent -= {speed for names in falling if names not in flat for speed in names[2:]}
    return tuple(n for n in values if n not in model.fixed and n not in absent)


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
        return prediction_error.refine_stages(unloaded, loaded, values, model, correlated)
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
