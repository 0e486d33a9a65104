"""Refines a fit within the limits of its nominal parameters, and computes the residual at the
refined values.

The search compares effects by fits without limits, although friction and inertia of a machine are
not negative. The fit within these limits is reported, and its errors on recordings set aside are
computed (bounded least squares: Stark and Parker, Computational Statistics 10 (1995) 129).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from scipy.optimize import lsq_linear

from identification.diagnosis.joint import Joint, fit, nominal_after_effects, start_fit
from identification.diagnosis.linear import (
    Added,
    contribution,
    effect_derivatives,
    is_infeasible,
    predicted_and_attained,
    with_rises_held,
)
from identification.diagnosis.rules import RULES
from identification.diagnosis.stack import Stack, stack_of, with_effect_basis
from identification.estimate.bandwidth import Choice, choose_bandwidth, moving_samples
from identification.estimate.default import free_names, solve_stages
from identification.estimate.equation_error import LEAST_MOTION, samples_in_motion
from identification.model.parameters import LADDER, STRIBECK_TERMS, bears_load
from identification.numerics.least_squares import unit_columns
from identification.prepare import prepare, torque_unit
from identification.recording import Array, Dataset, Model, Recording, RecordingError
from identification.views.nominal import LARGEST_STEP, SPEEDS, Nominal
from identification.views.view import View, views

ROUNDS = 8
"""Greatest number of steps; several steps are needed because the fall of friction, and regressors
that depend on the nominal values, make the problem nonlinear.
"""
CONVERGED = 1e-5  # relative change of the cost below which the refinement ends
STEP_SHARES = (1.0, 0.5, 0.2)  # shares of a step that are tried
RIDGE = 1e-4
"""Weight of a ridge penalty on every parameter, relative to the weight of the rows; of equivalent
solutions the penalty selects the smallest.
"""
Problem = tuple[Array, Array, tuple[Array, Array], Array]
_JUDGED: WeakKeyDictionary[Joint, bool] = WeakKeyDictionary()
"""Cache: fit to whether it is infeasible, for several comparisons that ask about one fit."""
_COULOMB_OF = {static: coulomb for coulomb, static, _ in STRIBECK_TERMS}


@dataclass(frozen=True)
class _Point:
    """Parameters and their residual."""

    nominal: Nominal
    effects: tuple[Added, ...]
    stack: Stack
    # Whitened residual, shape (n,). In all equations except the torque equation, constants that are
    # not reported, such as the zero of an encoder, are projected out.
    left: Array

    @property
    def cost(self) -> float:
        """Sum of whitened squares."""
        return float(self.left @ self.left)


def infeasible(joint: Joint) -> bool:
    """Whether a fit is infeasible: its residual, after refinement within the limits of the
    parameters, is far greater than the fit without limits predicts, or no machine has one of its
    effects. Effects of an infeasible fit are not accepted.
    """
    if joint not in _JUDGED:
        _JUDGED[joint] = any(
            e.term.impossible(e.coefficients, joint.nominal) for e in joint.effects
        ) or (infeasible_as_fitted(joint) and not _attained_within_limits(joint))
    return _JUDGED[joint]


def _attained_within_limits(joint: Joint) -> bool:
    """Whether a fit, refined within its limits, leaves about what it predicts."""
    promised, _ = predicted_and_attained(joint.stack, joint.effects, joint.residual)
    limited = within_limits(joint)
    rows = limited.residual[limited.stack.part("torque")]
    return not is_infeasible(promised, float(np.mean(rows**2)))


def infeasible_as_fitted(joint: Joint) -> bool:
    """Whether the residual of a fit, with parameters beyond a limit moved to the limit, is far
    greater than the fit predicts.

    A fit whose last effect does not appear in the torque equation counts as feasible, because such
    an effect does not change the friction parameters.
    """
    if joint.effects and "torque" not in joint.effects[-1].term.columns:
        return False
    promised, kept = predicted_and_attained(joint.stack, joint.effects, joint.residual)
    return is_infeasible(promised, kept) and is_infeasible(
        promised, with_rises_held(joint.stack, joint.effects)
    )


def within_limits(joint: Joint) -> Joint:
    """Return a fit with its nominal parameters and coefficients refined within their limits.

    The residual of the returned fit is computed at the refined values, not predicted by a linear
    step.
    """
    if joint.limited:
        return joint
    best = _point_at(joint, joint.nominal, joint.effects, joint.stack)
    for _ in range(ROUNDS):
        better = None
        for held in ((), SPEEDS):
            step, effects = _bounded_step(best, held)
            trials = (
                _point_after(joint, best, share * step, effects, share) for share in STEP_SHARES
            )
            better = next((t for t in trials if t.cost < best.cost), None)
            if better is not None:
                break
        if better is None:
            break
        done = better.cost > (1.0 - CONVERGED) * best.cost
        best = better
        if done:
            break
    left = replace(best.stack, residual=best.stack.projected(best.left[:, None])[:, 0])
    effect_basis = with_effect_basis(left, effect_derivatives(left, best.effects))
    return Joint(best.nominal, best.effects, best.stack.equations, best.left, effect_basis)


def parameter_derivatives(joint: Joint) -> Array:
    """Return whitened derivatives by nominal parameters and coefficients, shape (n, k)."""
    return _problem(joint)[0]


def cross_validation_residual(joint: Joint, parts: Array) -> Array:
    """Return the whitened residual of each part of the rows, with nominal parameters and
    coefficients fitted to all other parts, shape (n,).

    Args:
        joint: Result of :func:`within_limits`.
        parts: Number of the part to which each row belongs, shape (n,), or -1 for rows in no part,
            whose residual is zero.
    """
    every, begin, limits, drawn = _problem(joint)
    out = np.where(parts < 0, 0.0, joint.residual)
    for part in np.unique(parts[parts >= 0]):
        mine = parts == part
        found = _bounded_least_squares(
            every[~mine], joint.residual[~mine] + every[~mine] @ begin, limits, drawn
        )
        out[mine] += every[mine] @ (begin - found)
    return out


def _point_at(joint: Joint, nominal: Nominal, effects: Sequence[Added], like: Stack) -> _Point:
    stack = stack_of(joint.rows_at(nominal), nominal, like)
    left = stack.measured
    for effect in effects:
        left -= contribution(stack, effect)
    return _Point(nominal, tuple(effects), stack, without_nuisances(stack, left))


def without_nuisances(stack: Stack, rows: Array) -> Array:
    """Return whitened rows, shape (n,) or (n, k), after a fit of the constants that are no nominal
    parameters, such as the rotor's share of the inertia or the zero of an encoder.
    """
    out = rows.copy()
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        part = stack.part(equation.name)
        if equation.name == "torque":
            own = [name not in stack.nominal.free for name in equation.names]
            basis, _ = np.linalg.qr(equation.tangent[:, own])
        out[part] -= basis @ (basis.T @ out[part])
    return out


def _bounded_step(point: _Point, held: Sequence[str]) -> tuple[Array, tuple[Added, ...]]:
    """Return a step of the nominal parameters, and the effects with its coefficients."""
    every, begin, limits, drawn = _bounded_problem(point, held)
    found = _bounded_least_squares(every, point.left + every @ begin, limits, drawn)
    effects, at = [], len(point.nominal.free)
    for effect in point.effects:
        if effect.term.size is None:
            width = len(effect.coefficients)
            effect = replace(effect, coefficients=tuple(found[at : at + width].tolist()))
            at += width
        effects.append(effect)
    return found[: len(point.nominal.free)], tuple(effects)


def _problem(joint: Joint) -> Problem:
    """Return the least-squares problem at the values of a fit."""
    if joint.limited:
        return joint.problem()
    return _bounded_problem(_Point(joint.nominal, joint.effects, joint.stack, joint.residual), ())


def _bounded_problem(point: _Point, held: Sequence[str]) -> Problem:
    """Return the data of the bounded least-squares problem: whitened columns of nominal parameters
    and coefficients, shape (n, k); present values; limits; and centre of the ridge penalty.
    """
    stack, nominal = point.stack, point.nominal
    count = len(nominal.free)
    torque = next(e for e in stack.equations if e.name == "torque")
    own = np.zeros((len(point.left), count))
    own[stack.part("torque")] = torque.tangent[:, :count] / torque.sigma
    own[:, [k for k, name in enumerate(nominal.free) if name in held]] = 0.0
    low, high = _step_limits(nominal)
    columns, begin, lows = [own], [np.zeros(count)], [low]
    for effect in point.effects:
        if effect.term.size is None:
            columns.append(stack.whitened(stack.columns(effect.term, effect.shape)))
            begin.append(np.array(effect.coefficients))
            least = np.full(columns[-1].shape[1], -math.inf)
            least[list(effect.term.positive)] = 0.0
            lows.append(least)
    every = without_nuisances(stack, np.concatenate(columns, axis=1))
    start = np.concatenate(begin)
    lower = np.concatenate(lows)
    upper = np.concatenate([high, np.full(len(start) - count, math.inf)])
    drawn = np.concatenate([-_values(nominal), np.zeros(len(start) - count)])
    return every, start, (lower, upper), drawn


def _bounded_least_squares(
    every: Array, target: Array, limits: tuple[Array, Array], drawn: Array
) -> Array:
    """Return the bounded solution, with a small ridge penalty toward ``drawn``."""
    even, scale = unit_columns(every)
    q, r = np.linalg.qr(even)
    found = lsq_linear(
        np.concatenate([r, RIDGE * np.eye(len(scale))]),
        np.concatenate([q.T @ target, RIDGE * drawn * scale]),
        (limits[0] * scale, limits[1] * scale),
        method="bvls",
    )
    return np.asarray(found.x / scale)


def _values(nominal: Nominal) -> Array:
    """Return the values to which a step is added: rises, and 0 for Stribeck speeds."""
    return np.array(
        [
            0.0 if name in SPEEDS else nominal.get(name) - nominal.get(_COULOMB_OF.get(name, ""))
            for name in nominal.free
        ]
    )


def _step_limits(nominal: Nominal) -> tuple[Array, Array]:
    """Return the least and the greatest step of each free nominal parameter."""
    low = -np.maximum(_values(nominal), 0.0)
    high = np.full(len(low), math.inf)
    for k, name in enumerate(nominal.free):
        if name == "offset":
            low[k] = -math.inf
        elif name in SPEEDS:
            low[k], high[k] = -LARGEST_STEP, LARGEST_STEP
        elif name in nominal.most:
            high[k] = max(nominal.most[name] - nominal.get(name), 0.0)
    # The solver requires that the two limits of a parameter differ.
    room = np.where(np.isfinite(low), 1e-12 * np.maximum(np.abs(low), 1.0), 0.0)
    return low, np.maximum(high, low + room)


def _point_after(
    joint: Joint, point: _Point, step: Array, effects: Sequence[Added], share: float
) -> _Point:
    """Return the point after a share of a step."""
    placed = tuple(
        replace(
            new,
            coefficients=tuple(
                (1.0 - share) * a + share * b
                for a, b in zip(old.coefficients, new.coefficients, strict=True)
            ),
        )
        for old, new in zip(point.effects, effects, strict=True)
    )
    nominal, placed = start_fit(
        nominal_after_effects(point.nominal.moved(step, step), placed), placed
    )
    return _point_at(joint, nominal, placed, point.stack)


SPEED_QUANTILES, TRIAL_SPEEDS = (0.02, 0.3), 3
"""Speed quantiles between which trial Stribeck speeds lie, and the number of these speeds."""
ACCEPTED_RATIO = 0.7
"""Greatest ratio of the sum of squares of a fit from an assumed fall of friction to that of the
fit from the estimate, for which the assumed fall is accepted.

In simulated trials in which an injected effect masked the fall of friction the ratio was 0.06 to
0.6; a wrong fall lowers the sum of squares by a few per cent.
"""
GREATEST_BANDWIDTH_HZ = 25.0
"""Greatest bandwidth, unless too few samples are in motion at this bandwidth. A higher bandwidth
adds noise and hardly any contribution of the effects.
"""
RUNG_WITHOUT_LOAD: Mapping[str, str] = {
    "load_dependent": "coulomb_viscous",
    "stribeck_load_dependent": "stribeck",
}
"""Rung with load-dependent friction to the rung that replaces it if no load is declared."""


def _steady_samples(recordings: Sequence[Recording], bandwidth_Hz: float) -> int:
    """Return the number of samples that both an identification and a diagnosis can use."""
    moving = moving_samples(recordings, bandwidth_Hz)
    if moving < LEAST_MOTION:
        return moving
    return min(moving, sum(int(np.sum(v.moving)) for v in views(recordings, bandwidth_Hz)))


def views_and_fit(dataset: Dataset, bandwidth_Hz: float) -> tuple[tuple[View, ...], Joint]:
    """Return views of the recordings to fit, and the fit of the nominal model to them."""
    fitted = dataset.part("fit")
    start = estimated_nominal(dataset, fitted, bandwidth_Hz)
    here = views(fitted, bandwidth_Hz, campaign=dataset.recordings)
    return here, fit_from_estimate(here, torque_unit(fitted[0]), start, dataset.model)


def fit_from_estimate(here: Sequence[View], unit: str, start: Nominal, model: Model) -> Joint:
    """Fit the nominal model, starting from the estimate and, if the mismatch of this fit exceeds
    the noise, from assumed falls of friction with speed too.

    An unmodelled effect can mask the fall of friction with speed in an estimate, so that the
    estimate has no fall; no later step of a fit finds the fall.
    """
    return with_assumed_fall(fit(here, unit, start), start, model.fixed)


def with_assumed_fall(first: Joint, start: Nominal, fixed: Collection[str]) -> Joint:
    """Return the fit ``first``, or a fit with the same effects that starts from an assumed fall of
    friction with speed, if the mismatch of the latter is far smaller.

    Args:
        first: The fit; if its mismatch is within the noise, no other fit is tried.
        start: Nominal values from which this fit started.
        fixed: Names of nominal parameters that are not estimated.
    """
    if _mean_square(first) < RULES.excess:
        return first
    raised = [start.raised(omega, fixed) for omega in _trial_stribeck_speeds(first.views)]
    other = min((first.again(r, first.effects) for r in raised), key=_mean_square)
    return other if _mean_square(other) < ACCEPTED_RATIO * _mean_square(first) else first


def feasible_or_first(first: Joint) -> Joint:
    """Return the fit ``first`` or, if it is infeasible, a feasible fit that starts from an assumed
    fall of friction with speed.

    The static friction of the load may become equal to Coulomb friction during a fit, because few
    rows are slow enough to determine the static friction; no later step separates the two levels.
    """
    if not infeasible_as_fitted(first):
        return first
    held = first.nominal.values.keys() - set(first.nominal.free)
    middle = _trial_stribeck_speeds(first.views)[TRIAL_SPEEDS // 2]
    again = first.again(first.nominal.raised(middle, held), first.effects)
    return first if infeasible_as_fitted(again) else again


def _trial_stribeck_speeds(here: Sequence[View]) -> list[float]:
    """Return trial Stribeck speeds of the assumed fall of friction, rad/s."""
    speed = np.concatenate([np.abs(v.low_pass(v.velocity))[v.moving] for v in here])
    low, high = np.quantile(speed, SPEED_QUANTILES)
    return [float(omega) for omega in np.geomspace(low, high, TRIAL_SPEEDS)]


def _mean_square(joint: Joint) -> float:
    """Return the mean-square torque mismatch over that of the noise; 0 without rows."""
    rows = joint.residual[joint.stack.part("torque")]
    return float(np.mean(rows**2)) if len(rows) else 0.0


def estimated_nominal(
    dataset: Dataset, recordings: Sequence[Recording], bandwidth: float
) -> Nominal:
    """Estimate the nominal parameters from some recordings of a dataset, by variable projection."""
    prepared = [prepare(r, bandwidth) for r in recordings]
    unloaded = [p for p in prepared if p.recording.stage == "unloaded"]
    loaded = [p for p in prepared if p.recording.stage == "loaded"]
    model = dataset.model
    unknown = bears_load(model.friction) and not any(r.known_load for r in recordings)
    if unknown:
        model = replace(model, friction=RUNG_WITHOUT_LOAD[model.friction])
    values, _ = solve_stages(unloaded, loaded, model, lambda _stage, _share: None)
    free = free_names(values, model)
    if unknown:
        gear = [
            name for name in LADDER[dataset.model.friction] if name not in LADDER[model.friction]
        ]
        values = {**values, **dict.fromkeys(gear, 0.0)}
        free = (
            *free,
            *(
                name
                for name in gear
                if name not in model.fixed and (name == "mu_gc" or "Ms" in free)
            ),
        )
    return Nominal(values, free, model.alpha)


# Chooses the recordings and the bandwidth of a diagnosis.


def fitted_part(dataset: Dataset) -> tuple[Recording, ...]:
    """Return the recordings with role ``fit``."""
    fitted = dataset.part("fit")
    if not fitted:
        raise RecordingError(
            "no recording has the role fit, but a diagnosis needs at least one; set `role: fit` in "
            "the campaign file"
        )
    return fitted


def long_enough(dataset: Dataset, bandwidth_Hz: float | None) -> Choice:
    """Return the bandwidth of all errors, and the recordings long enough for its filter."""
    fitted_part(dataset)
    return choose_bandwidth(dataset, bandwidth_Hz, GREATEST_BANDWIDTH_HZ, _steady_samples)


def choose(dataset: Dataset, bandwidth_Hz: float | None) -> Choice:
    """Return the recordings to use, and the bandwidth of all errors; recordings that cannot be
    used have the role ``unused``, those too short for the filter are left out.

    Loaded recordings in which the joint rests nearly all the time do not determine friction under
    load. Such recordings are not used, and only the unloaded recordings are diagnosed.

    Args:
        dataset: The dataset.
        bandwidth_Hz: Bandwidth of all errors, or None for a bandwidth chosen from the recordings.
    """
    dataset, bandwidth, short = long_enough(dataset, bandwidth_Hz)
    fitted = dataset.part("fit")
    moving = {
        stage: samples_in_motion([prepare(r, bandwidth) for r in fitted if r.stage == stage])
        for stage in {r.stage for r in fitted}
    }
    rests = moving.get("loaded", LEAST_MOTION) < LEAST_MOTION
    if not rests or moving.get("unloaded", 0) < LEAST_MOTION:
        return Choice(dataset, bandwidth, short)
    kept = tuple(
        replace(r, role="unused") if r.stage == "loaded" else r for r in dataset.recordings
    )
    names = ", ".join(r.name for r in dataset.recordings if r.stage == "loaded")
    warning = (
        f"{names}: at a bandwidth of {bandwidth:.3g} Hz these loaded recordings have "
        f"{moving['loaded']} samples in motion, and at least {LEAST_MOTION} are needed. Therefore "
        "no loaded recording is used, and effects of the load are not diagnosed; add recordings in "
        "which the loaded joint moves longer"
    )
    return Choice(replace(dataset, recordings=kept), bandwidth, (*short, warning))
