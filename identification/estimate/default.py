"""The default identification method: equation error, then maximum likelihood (docs/method.md).

Variable projection minimises the equation error. The values are then refined by prediction errors,
and the refined values are used if they pass the acceptance tests.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from identification.estimate import equation_error as varpro
from identification.estimate.bandwidth import choose_bandwidth, common_bandwidth, listed
from identification.estimate.covariance import shifts_of_constants, with_constants, with_priors
from identification.estimate.equation_error import (
    Stage,
    discrepancy,
    loaded_stage,
    require_motion,
    unloaded_stage,
)
from identification.estimate.parameter_table import (
    least_pinned,
    parameter_table,
    printed_fit,
    trace_of,
    tradeoffs,
    units_of,
    widened,
)
from identification.estimate.refinement import (
    Found,
    corrected,
    equation_noise,
    noise_of,
    refine,
    refine_pieces,
    refine_recordings,
)
from identification.estimate.searches import Refined
from identification.estimate.uncertainty import bootstrap, profiles
from identification.model.parameters import STRIBECK_TERMS, SYSTEM_PARAMETERS
from identification.numerics.arrays import Progress, silent, spanned
from identification.numerics.spread import Spread, quantile
from identification.prepare import (
    Prepared,
    joint_angle,
    prepare,
    resting,
    torque_unit,
    volts_per_torque,
)
from identification.recording import Dataset, Model, Recording, RecordingError
from identification.result import (
    MOST_FLOORS,
    Convergence,
    Fit,
    Identification,
    Parameter,
    Profile,
    Resampled,
)


def identify(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    profile: bool = False,
    draws: int = 0,
    in_pieces: bool = False,
) -> Identification:
    """Identify the nine parameters in two stages; if no recording is loaded, the five system
    parameters.

    Args:
        dataset: Recordings and the declared model; the errors on recordings with role ``validate``
            are computed once, at the end.
        bandwidth_Hz: Bandwidth of torque and regressors, or None for the least of the recordings'
            default bandwidths, or a greater bandwidth if the motion needs it.
        rng: Random generator for the simulated replicates and the bootstrap, or None for seed 0.
        progress: Called with the name of a step and the share of the step that is done.
        profile: Whether to compute profile likelihoods as well; the identification then takes
            several times as long.
        draws: Number of bootstrap samples, 0 for none.
        in_pieces: Whether to process the recordings piece by piece, without replicates, profiles
            and bootstrap. Memory in addition to the recordings then grows by 14 bytes per sample,
            and traces cover the first piece of each recording only.
    """
    started = perf_counter()
    tell = progress or silent
    chance = rng or np.random.default_rng(0)
    if not dataset.part("fit"):
        raise RecordingError("no recording has role 'fit'; at least one is needed")
    if in_pieces and bandwidth_Hz is None:
        bandwidth_Hz = common_bandwidth([pieces(r)[0] for r in dataset.part("fit")])
    dataset, bandwidth_Hz, short = choose_bandwidth(dataset, bandwidth_Hz)
    cut = [(r, pieces(r) if in_pieces else [r]) for r in dataset.recordings]
    fitted = [parts for r, parts in cut if r.role == "fit"]
    every = [part for parts in fitted for part in parts]
    tell("unloaded", 0.0)
    prepared = [(r, [prepare(part, bandwidth_Hz) for part in parts]) for r, parts in cut]
    active = [p for r, parts in prepared if r.role == "fit" for p in parts]
    model = dataset.model
    values, stages = solve_stages(*by_load(active), model, tell)
    names = free_names(values, model)
    noise = equation_noise(by_load(active)[0], values, model.alpha)

    def refined(correlated: bool) -> Refined | str:
        if in_pieces:
            heads = [parts[0] for parts in fitted]
            return refine_pieces(
                heads, every, values, names, model, partial(tell, "joint"), correlated, noise
            )
        return refine_recordings(every, values, names, model, correlated, tell, noise)

    tell("joint", 0.0)
    found = refine(refined, active, values, names, model.alpha)
    curves: tuple[Profile, ...] = ()
    resampled: tuple[Resampled, ...] = ()
    notes = [_TOO_LONG] if profile or draws else []
    doubts: tuple[str, ...] = ()
    if not in_pieces:
        doubts = *varpro.averaging(active, values, names, model.alpha), *_unresolved(active)
        found = corrected(found, chance, tell)
        curves, resampled, notes = _asked(found, units_of(active), profile, draws, chance, tell)
    tell("joint", 1.0)
    whole = replace(
        found, stages=(*stages, *found.stages), warnings=(*found.warnings, *notes, *short, *doubts)
    )
    result = identification(dataset, prepared, whole)
    seconds = perf_counter() - started
    return replace(result, profiles=curves, resampled=resampled, seconds=seconds)


def identification(
    dataset: Dataset, prepared: Sequence[tuple[Recording, Sequence[Prepared]]], found: Found
) -> Identification:
    """Return the result of the default method.

    ``prepared``: every recording with its pieces; traces contain the first piece only.
    """
    model = dataset.model
    active = [p for r, parts in prepared if r.role == "fit" for p in parts]
    every = [p for _, parts in prepared for p in parts]
    cut = len(every) > len(prepared)
    first = active[0].recording
    constants = shifts_of_constants(
        active, lambda moved: solve_stages(*by_load(moved), model, silent)[0]
    )
    fit, fits = printed_fit(every, cut, found.values, model.alpha)
    known = with_constants(_with_discrepancy(found, active, fit, model.alpha), constants)
    values, spread, priors, doubts = with_priors(found.values, known, model.priors)
    # Whether recordings determine a parameter depends on their noise; its interval contains what
    # the model lacks as well.
    noise_alone = with_priors(found.values, with_constants(found.spread, constants), model.priors)
    if priors:
        fit, fits = printed_fit(every, cut, values, model.alpha)
    # The floor is the bound for the recordings alone, without priors.
    table = widened(
        parameter_table(
            active,
            values,
            noise_alone[1],
            model,
            {} if priors else found.floors,
            found.taken is None and (fit.floors or 0.0) > MOST_FLOORS,
        ),
        spread,
    )
    return Identification(
        method="default",
        motion=first.bench.motion,
        alpha=model.alpha,
        parameters=table,
        fit=fit,
        stages=found.stages,
        fitted=dict(values),
        friction=model.friction,
        starts=found.starts,
        # These results describe the recordings alone, without priors.
        tradeoffs=tradeoffs(found.spread, found.values, units_of(active)),
        least_pinned=least_pinned(found.spread, found.values),
        noise=None if found.taken is None else noise_of(found.taken, torque_unit(first)),
        warnings=(*found.warnings, *doubts),
        known_constants=constants,
        priors=priors,
        covariance=spread.only([n for n, p in table.items() if p.value is not None]),
        ranges=spanned([(p.angle, p.velocity, p.moment) for p in active]),
        traces=tuple(trace_of(parts[0], values, model.alpha) for _, parts in prepared),
        fits_by_recording=fits,
        evaluations=sum(s.evaluations for s in found.stages),
    )


def _with_discrepancy(found: Found, active: Sequence[Prepared], fit: Fit, alpha: float) -> Spread:
    """Return the covariance of the estimate, with that due to a torque that the model lacks if the
    refinement was rejected or the error is above the noise floor.
    """
    spread = found.spread
    if not spread.names or (found.taken is not None and (fit.floors or 0.0) <= MOST_FLOORS):
        return spread
    volts = volts_per_torque(active[0].recording) or 1.0
    sizes = fit.discrepancy_rms / volts, (fit.noise_floor_rms or 0.0) / volts
    more = discrepancy(active, found.values, spread.names, alpha, *sizes)
    return replace(spread, matrix=spread.matrix + more)


def by_load(prepared: Sequence[Prepared]) -> tuple[list[Prepared], list[Prepared]]:
    """Split prepared recordings into unloaded and loaded recordings."""
    unloaded, loaded = (
        [p for p in prepared if p.recording.stage == stage] for stage in ("unloaded", "loaded")
    )
    return unloaded, loaded


def _unresolved(active: Sequence[Prepared]) -> list[str]:
    """Return one warning on all recordings that the equation error cannot use."""
    idle = [p.recording.name for p in active if not np.any(p.used)]
    if not idle:
        return []
    return [
        f"{listed(idle)}: not used for the start values, because at a bandwidth of "
        f"{active[0].bandwidth_Hz:.3g} Hz the joint rests within every filter window"
    ]


def _asked(
    found: Found,
    units: Mapping[str, str],
    profile: bool,
    draws: int,
    rng: np.random.Generator,
    tell: Progress,
) -> tuple[tuple[Profile, ...], tuple[Resampled, ...], list[str]]:
    """Return the requested profiles and bootstrap results, or why they cannot be computed."""
    if found.taken is None:
        what = " and ".join(
            w for w, asked in (("profiles", profile), ("bootstrap", draws)) if asked
        )
        why = f"no {what}: the refinement by prediction errors, which it needs, was not accepted"
        return (), (), [why] if what else []
    curves: tuple[Profile, ...] = ()
    resampled: tuple[Resampled, ...] = ()
    # Profiles and bootstrap results are centred at the maximum of the likelihood; the bias
    # correction is applied to them as it was to the estimate.
    moved = {name: found.values[name] - found.taken.values[name] for name in found.taken.names}
    if profile:
        # Use the reported covariance, which includes the information from replicates and the
        # uncertainty of the bias.
        stated = replace(found.taken, covariance=found.spread.matrix)
        walked = profiles(stated, units, lambda share: tell("profiles", share))
        curves = tuple(curve.moved(moved[curve.name]) for curve in walked)
    if draws:
        drawn = bootstrap(found.taken, units, draws, rng, lambda share: tell("bootstrap", share))
        resampled = tuple(d.moved(moved[d.name]) for d in drawn)
    return curves, resampled, []


def solve_stages(
    unloaded: Sequence[Prepared], loaded: Sequence[Prepared], model: Model, tell: Progress
) -> tuple[dict[str, float], list[Convergence]]:
    """Solve both stages by variable projection; return values by name, and search records."""
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
                "no unloaded recording to fit: friction without load cannot be separated from "
                f"friction due to the load; record an unloaded stage, or fix {', '.join(missing)}"
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
    """Return the names of the parameters to estimate: not fixed, and in a friction term."""
    falling = [names for names in STRIBECK_TERMS if names[1] in values]
    flat = {names for names in falling if not values[names[1]] > values[names[0]]}
    absent = {static for _, static, _ in flat} | {speed for _, _, speed in flat}
    absent -= {speed for names in falling if names not in flat for speed in names[2:]}
    return tuple(n for n in values if n not in model.fixed and n not in absent)


LONG_SAMPLES = 200_000
"""Number of samples to fit above which recordings are processed in pieces, which is faster."""
_TOO_LONG = (
    "no profiles and no bootstrap: these are computed only if all recordings together have "
    f"at most {LONG_SAMPLES} samples; use fewer or shorter recordings"
)
PIECE_SAMPLES = 60_000
_SEARCH_SAMPLES = 6000
"""Number of samples before the end of a piece in which a rest is searched for the cut."""


def identify_any_length(
    dataset: Dataset, *, rng: np.random.Generator | None = None, **options: Any
) -> Identification:
    """Identify by the default method within the bounds of the model, piece by piece if the
    recordings are long; the options are those of :func:`default.identify`.
    """
    chance = rng or np.random.default_rng(0)
    if dataset.model.bounds:
        return _within_bounds(
            dataset, lambda part: identify_any_length(part, rng=copy.deepcopy(chance), **options)
        )
    samples = sum(len(r.time) for r in dataset.part("fit"))
    return identify(dataset, rng=chance, in_pieces=samples > LONG_SAMPLES, **options)


def _within_bounds(
    dataset: Dataset, estimate: Callable[[Dataset], Identification]
) -> Identification:
    """Return the estimate within the bounds of the model.

    A parameter whose estimate is beyond its bound is fixed at the bound, and the others are fitted
    again. What the free estimate leaves of the parameter's range, from the bound to the other end
    of the interval, is the half width of its interval, and moves the other parameters as their
    covariance says.
    """
    model = dataset.model
    bounds = dict(model.bounds)
    free = estimate(replace(dataset, model=replace(model, bounds={})))
    beyond = [n for n, (low, high) in bounds.items() if not low <= free.fitted.get(n, low) <= high]
    if not beyond:
        return replace(free, parameters=_cut_at(bounds, free.parameters))
    name, before = beyond[0], free.fitted[beyond[0]]
    low, high = bounds.pop(name)
    at = min(max(before, low), high)
    priors = {n: p for n, p in model.priors.items() if n != name}
    held = replace(model, fixed={**model.fixed, name: at}, bounds=bounds, priors=priors)
    found = estimate(replace(dataset, model=held))
    half, covariance = 0.0, found.covariance
    if name in free.covariance.names:
        row = free.covariance.matrix[free.covariance.names.index(name)]
        slopes = dict(zip(free.covariance.names, row, strict=True))
        whole = free.covariance.half_width(name)
        half = min(max(whole - abs(before - at), 0.0), high - low)
        names = (*covariance.names, name)
        slope = np.array([slopes.get(n, 0.0) / slopes[name] for n in names])
        matrix = np.zeros((len(names), len(names)))
        matrix[:-1, :-1] = covariance.matrix
        matrix += np.outer(slope, slope) * (half / quantile(covariance.freedom)) ** 2
        covariance = replace(covariance, names=names, matrix=matrix)
    unit, reason = found.parameters[name].unit, f"at its bound; without it {before:.4g}"
    bounded = Parameter(name, unit, at, at, at, at_bound=True, reason=reason)
    table = widened({**found.parameters, name: bounded}, covariance)
    warning = f"{name} is at its bound {at:.4g} {unit}; without this bound it would be {before:.4g}"
    if not half:
        warning += (
            ", and its interval does not reach the bound: the bound is wrong, or the model lacks "
            "an effect"
        )
    return replace(
        found,
        parameters=_cut_at({**bounds, name: (low, high)}, table),
        covariance=covariance,
        warnings=(*found.warnings, warning),
        evaluations=free.evaluations + found.evaluations,
        seconds=free.seconds + found.seconds,
    )


def _cut_at(
    bounds: Mapping[str, tuple[float, float]], table: Mapping[str, Parameter]
) -> dict[str, Parameter]:
    """Return the parameters with intervals that end at the bounds."""
    return {
        name: p
        if p.low is None or p.high is None or name not in bounds
        else replace(p, low=max(p.low, bounds[name][0]), high=min(p.high, bounds[name][1]))
        for name, p in table.items()
    }


def pieces(recording: Recording) -> list[Recording]:
    """Cut a recording into views of about ``PIECE_SAMPLES`` samples, at rests if possible."""
    n, start = len(recording.time), 0
    found = []
    while start < n:
        stop = n if n - start < 1.5 * PIECE_SAMPLES else _cut(recording, start + PIECE_SAMPLES)
        found.append(
            replace(recording, channels={c: v[start:stop] for c, v in recording.channels.items()})
        )
        start = stop
    return found


def _cut(recording: Recording, near: int) -> int:
    """Return the sample of the middle of the last rest shortly before ``near``, else ``near``."""
    window = slice(near - _SEARCH_SAMPLES, near)
    angle = joint_angle(
        replace(recording, channels={c: v[window] for c, v in recording.channels.items()})
    )
    if angle is None:
        return near
    edges = np.flatnonzero(np.diff(np.concatenate(([0], resting(angle).astype(np.int64), [0]))))
    if not edges.size:
        return near
    return near - _SEARCH_SAMPLES + int((edges[-2] + edges[-1]) // 2)
