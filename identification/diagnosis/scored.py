"""Reported constants and errors of a diagnosis, which are computed last: the errors are those of
the exported model, by the function with which every command predicts recordings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.diagnosis.joint import Joint, identifiable, noise_left
from identification.diagnosis.linear import contribution
from identification.diagnosis.result import Fit, IdentifiedEffect, Map, ResidualTrace, Shift
from identification.diagnosis.rows import AT_INSTANTS, Equation
from identification.diagnosis.rules import RULES
from identification.effects import EFFECTS
from identification.effects.effect import Effect
from identification.effects.model import (
    COORDINATES,
    CorrectedModel,
    Curve,
    predictions,
    refit,
    views_for,
)
from identification.numerics.least_squares import scaled_least_squares
from identification.numerics.spread import NO_SPREAD, Spread, correlation_samples, quantile
from identification.recording import Array, Dataset, RecordingError
from identification.result import Identification
from identification.signals import BoolArray
from identification.views.predicted import Predicted, relative, rms

REFINED_SAMPLES = 60_000
"""Number of samples up to which a new fit of the nominal parameters by prediction errors takes
about as long as the search for effects, some ten seconds.
"""
SETTLED_COST = 1.01
"""Greatest ratio of the errors with and without a rise of static friction at which a rise that the
recordings do not determine is left out.
"""
BLOCK_S = 2.0  # length of the blocks in which the errors of two models are compared, s
FOLDS, BINS, LEAST_IN_BIN = 5, 16, 5
"""Parts of the blocks, of which each is predicted by a curve through the others; number of bins of
the curve, and least number of samples in a bin.
"""
STATIC_OF: Mapping[str, str] = {"Mc": "Ms", "mu_c": "mu_s", "mu_gc": "mu_gs"}
Estimate = Callable[[Dataset], Identification]  # the estimator of `rig identify`


class Constants(NamedTuple):
    """Nominal parameters of one estimator."""

    # Name to value, also of parameters that the recordings do not determine.
    values: Mapping[str, float]
    # Name to value, None for a parameter that the recordings do not determine.
    known: Mapping[str, float | None]
    warnings: tuple[str, ...] = ()  # warnings of the estimator
    covariance: Spread = NO_SPREAD  # covariance of the default estimator


class Scores(NamedTuple):
    """Errors of one model on all recordings."""

    model: CorrectedModel
    parts: tuple[Predicted, ...]

    def of(self, equation: str, role: str) -> list[Predicted]:
        """Return the recordings of one role."""
        return [p for p in self.parts if p.equation == equation and p.role == role]

    def rms(self, equation: str, role: str) -> float | None:
        """Return the root-mean-square error of one equation, or None without samples."""
        return rms(self.of(equation, role))


def scores(dataset: Dataset, model: CorrectedModel, bandwidth_Hz: float) -> Scores:
    """Return the errors of a model on all recordings of a dataset."""
    seen = views_for(dataset.recordings, bandwidth_Hz, model)
    return Scores(model, tuple(p for view in seen for p in predictions(view, model)))


def constants_of(joint: Joint) -> Constants:
    """Return the nominal parameters of a fit of the rows."""
    values = {n: float(v) for n, v in joint.nominal.values.items()}
    return Constants(values, {n: v if identifiable(joint, n) else None for n, v in values.items()})


def identified_constants(found: Identification) -> Constants:
    """Return the nominal parameters of ``rig identify``."""
    known = {n: found.parameters[n].value if n in found.parameters else None for n in found.fitted}
    return Constants(dict(found.fitted), known, found.warnings, found.covariance)


def unreported_constants(joint: Joint) -> dict[str, float]:
    """Return the constants of a fit beside the nominal parameters, which the exported model needs:
    resistance ``R``, ohm, and back-EMF constant ``Ke``, V s/rad, of a voltage equation; inertia of
    the rotor at the joint ``J_r``, kg m^2, of a flexible transmission.
    """
    out: dict[str, float] = {}
    for found in joint.stack.equations:
        if found.name not in ("torque", "voltage"):
            continue
        own = [n for n in found.names if n not in joint.nominal.free]
        if not own:
            continue
        rows = joint.stack.part(found.name)
        left = found.residual / found.sigma
        for effect in joint.effects:
            left = left - contribution(joint.stack, effect)[rows]
        columns = found.tangent[:, [n in own for n in found.names]]
        moved = scaled_least_squares(columns, left * found.sigma)
        bench = found.views[0].recording.bench
        known = {
            "R": ("R", bench.resistance),
            "Ke": ("Ke", bench.back_emf_constant),
            "rotor": ("J_r", 0.0),
        }
        out |= {
            known[n][0]: (known[n][1] or 0.0) + float(m)
            for n, m in zip(own, moved, strict=True)
            if n in known
        }
    return out


def model_with(
    constants: Mapping[str, float],
    alpha: float,
    effects: Sequence[IdentifiedEffect],
    dataset: Dataset,
    catalogue: Mapping[str, Effect] = EFFECTS,
) -> CorrectedModel:
    """Return the model of these nominal parameters and effects."""
    names = [r.name for r in dataset.recordings]
    given: dict[str, dict[str, float]] = {}
    for effect in effects:
        values = {n: float(e.value) for n, e in effect.parameters.items()}
        if catalogue[effect.name].place is not None:
            shown = [names.index(r) for r in effect.where.recordings if r in names]
            values["recording"] = 1.0 + min(shown, default=0)
        given[effect.name] = values
    return CorrectedModel(dict(constants), alpha, given, catalogue=catalogue)


def reported(
    dataset: Dataset,
    final: Joint,
    effects: Sequence[IdentifiedEffect],
    bandwidth_Hz: float,
    before: Constants,
    refine: bool,
    rng: np.random.Generator,
) -> tuple[Scores, Constants]:
    """Return the corrected model with its errors, and its nominal parameters.

    Candidates are the constants of the fit that found the effects and, with ``refine``, those of
    the default estimator after the effects were subtracted, which resolve the fall of friction with
    speed. The latter are taken unless their torque error is larger. If no effect changes the torque
    or the motion that friction depends on, the constants are those before.
    """
    beside, alpha = unreported_constants(final), final.nominal.fitted_alpha or final.nominal.alpha
    catalogue = {**{e.term.name: e.term for e in final.effects}, **EFFECTS}
    terms = [catalogue[e.name] for e in effects]
    acting = any(t.flexible or {"torque", "breakaway"} & {*t.columns} for t in terms)

    def scored(constants: Constants) -> tuple[Scores, Constants]:
        model = model_with({**constants.values, **beside}, alpha, effects, dataset, catalogue)
        return _settled(dataset, scores(dataset, model, bandwidth_Hz), constants, bandwidth_Hz)

    if not acting:
        model = model_with({**before.values, **beside}, alpha, effects, dataset, catalogue)
        return scores(dataset, model, bandwidth_Hz), before
    best = scored(constants_of(final))
    samples = sum(len(r.time) for r in dataset.part("fit"))
    if not refine:
        return best
    if samples > REFINED_SAMPLES:
        note = (
            f"with {samples} samples (more than {REFINED_SAMPLES}), the nominal parameters are "
            f"from equation errors at the bandwidth {bandwidth_Hz:.3g} Hz: static friction and "
            "Stribeck speed are less precise than those of rig identify"
        )
        return best[0], best[1]._replace(warnings=(*best[1].warnings, note))
    try:
        found = identified_constants(refit(dataset, best[0].model, bandwidth_Hz, rng))
    except RecordingError as error:
        note = f"the nominal parameters were not fitted again: {error}"
        return best[0], best[1]._replace(warnings=(*best[1].warnings, note))
    notes = tuple(f"nominal parameters fitted again: {w}" for w in found.warnings)
    other = scored(found._replace(warnings=notes))
    if worse(other[0], best[0], "torque", "fit"):
        return best[0], best[1]._replace(covariance=found.covariance)
    return other


def _settled(
    dataset: Dataset, first: Scores, constants: Constants, bandwidth_Hz: float
) -> tuple[Scores, Constants]:
    """Return the errors without rises of static friction that the recordings do not determine.

    Equation errors at a low bandwidth may give an arbitrarily high static friction below the
    resolvable speed, and a machine simulated with this friction never breaks away. If the errors
    need the rise, it stays.
    """
    values, notes = dict(first.model.parameters), []
    for coulomb, static in STATIC_OF.items():
        if {coulomb, static} <= values.keys() and constants.known.get(static) is None:
            if values[static] == values[coulomb]:
                continue
            values[static] = values[coulomb]
            notes.append(
                f"{static} is not determined by these recordings; the corrected model sets it "
                f"equal to {coulomb}"
            )
    if not notes:
        return first, constants
    other = scores(dataset, replace(first.model, parameters=values), bandwidth_Hz)
    pairs = [(s.rms("torque", "fit") or 0.0) for s in (first, other)]
    if pairs[1] > SETTLED_COST * pairs[0]:
        return first, constants
    settled = {n: values[n] for n in constants.values}
    return other, constants._replace(values=settled, warnings=(*constants.warnings, *notes))


def covariance_of(
    dataset: Dataset,
    scored: Scores,
    effects: Sequence[IdentifiedEffect],
    bandwidth_Hz: float,
    constants: Constants,
) -> Spread:
    """Return the covariance of the corrected model's parameters, those of effects as
    ``effect.name``, from the errors of all equations over the recordings that were fitted.

    It is that of least squares with the variance of each equation's error, over the correlation
    time of the errors. The variances of effects are those of their reported intervals, and no
    nominal variance is below that of the default estimator. Constants that the recordings do not
    determine count as exact.
    """
    model = scored.model
    seen = views_for(dataset.recordings, bandwidth_Hz, model)
    seen = tuple(v for v in seen if v.recording.role == "fit")
    scale = {p.equation: scored.rms(p.equation, "fit") or 1.0 for p in scored.parts}

    def errors(values: Mapping[str, float]) -> Array:
        parts = [p for v in seen for p in predictions(v, model.changed(values))]
        left = [(p.measured - p.model) / scale[p.equation] for p in parts]
        return np.nan_to_num(np.concatenate(left))

    halves = {
        f"{e.name}.{n}": 0.5 * (p.high - p.low) for e in effects for n, p in e.parameters.items()
    }
    exact = {*dataset.model.fixed, *(n for n, v in constants.known.items() if v is None)}
    base, columns = errors({}), {}
    for name, value in model.values.items():
        step = 1e-3 * halves[name] if name in halves else 1e-4 * abs(value)
        if step > 0.0 and name not in exact:
            change = (errors({name: value + step}) - base) / step
            if np.any(change):
                columns[name] = change
    if not columns:
        return NO_SPREAD
    design = np.stack(list(columns.values()), axis=1)
    size = np.linalg.norm(design, axis=0)
    bread = np.linalg.pinv((design / size).T @ (design / size), rcond=1e-12, hermitian=True)
    matrix = bread / np.outer(size, size) * float(np.mean(base[base != 0.0] ** 2))
    matrix *= correlation_samples(base[base != 0.0])
    names, deviation = tuple(columns), np.sqrt(np.diag(matrix))
    own = constants.covariance
    least = dict(zip(own.names, np.sqrt(np.diag(own.matrix)), strict=True))
    wide = np.array(
        [
            halves[n] / quantile(math.inf) / d if n in halves else max(least.get(n, 0.0) / d, 1.0)
            for n, d in zip(names, deviation, strict=True)
        ]
    )
    return Spread(names, matrix * np.outer(wide, wide), math.inf)


def worse(one: Scores, other: Scores, equation: str, role: str) -> bool:
    """Whether the error of the first model is larger, by more than its scatter over blocks."""
    pairs = [
        (math.sqrt(float(np.mean(a[k] ** 2))), math.sqrt(float(np.mean(b[k] ** 2))))
        for p, q in _matched(one, other)
        if (p.equation, p.role) == (equation, role)
        for time, a, b in [_errors(p, q)]
        for k in _blocks(time, np.ones(len(time), bool))
    ]
    if len(pairs) < 2:
        first, second = one.rms(equation, role), other.rms(equation, role)
        return first is not None and second is not None and first > second
    grown = np.array([a - b for a, b in pairs])
    spread = float(np.std(grown, ddof=1)) / math.sqrt(len(grown))
    return float(np.mean(grown)) > RULES.rejected * spread


def grown(one: Scores, other: Scores, equation: str) -> bool:
    """Whether the error of the first model is larger, by more than its scatter, on the recordings
    set aside, or without such recordings on those fitted.
    """
    return worse(one, other, equation, "validate" if one.of(equation, "validate") else "fit")


def _errors(one: Predicted, other: Predicted) -> tuple[Array, Array, Array]:
    """Return times and errors of two predictions of one recording where both are known."""
    time, a, b = np.intersect1d(one.time, other.time, return_indices=True)
    off, left = (one.measured - one.model)[a], (other.measured - other.model)[b]
    known = np.isfinite(off) & np.isfinite(left)
    return time[known], off[known], left[known]


def _blocks(time: Array, known: BoolArray) -> list[NDArray[np.intp]]:
    """Return the indices of the known samples, by blocks of :data:`BLOCK_S`."""
    places = np.flatnonzero(known)
    numbers = ((time[places] - time[0]) // BLOCK_S).astype(int) if len(places) else places
    return [places[numbers == n] for n in np.unique(numbers)]


def fits_of(
    baseline: Joint,
    final: Joint,
    before: Scores,
    within: Scores,
    after: Scores,
    bandwidth_Hz: float,
    main: str,
) -> tuple[Fit, ...]:
    """Return the errors of every equation that the fit has; of an equation at instants only if it
    is the main equation.

    The noise floor is what no model can explain: the noise of the rows that remains with the
    effects, where it is lower than without.

    Args:
        baseline: Fit of the nominal model.
        final: Fit with the effects.
        before: Errors of the nominal model.
        within: Errors of the nominal model with the constants of ``baseline``.
        after: Errors of the corrected model.
        bandwidth_Hz: Bandwidth of the errors.
        main: Name of the equation in which the mismatch is judged.
    """
    out = []
    for equation in baseline.equations:
        if equation.name in AT_INSTANTS and equation.name != main:
            continue
        pairs = [s.rms(equation.name, "fit") for s in (before, after)]
        if None in pairs:
            continue
        out.append(
            Fit(
                equation=equation.name,
                unit=equation.unit,
                bandwidth_Hz=bandwidth_Hz,
                baseline_rms=float(pairs[0] or 0.0),
                final_rms=float(pairs[1] or 0.0),
                noise_floor_rms=_floor(equation, final),
                validate_baseline_rms=before.rms(equation.name, "validate"),
                validate_final_rms=after.rms(equation.name, "validate"),
                nominal_within_limits_rms=within.rms(equation.name, "fit"),
                validate_nominal_within_limits_rms=within.rms(equation.name, "validate"),
                relative=relative(after.of(equation.name, "fit")),
            )
        )
    return tuple(out)


def _floor(equation: Equation, final: Joint) -> float:
    """Return the rms of the rows of an equation that is noise, or an error of the best sensors."""
    lower = noise_left(equation, final)
    return min(e.sigma * math.sqrt(float(np.mean(e.allowed()))) for e in (equation, lower))


def traces_of(baseline: Joint, before: Scores, after: Scores) -> tuple[ResidualTrace, ...]:
    """Return the errors of both models as the mismatch of every fitted recording and equation."""
    units = {e.name: e.unit for e in baseline.equations}
    out = []
    for p, q in _matched(before, after):
        rows = _errors(p, q)
        if p.equation in units and p.role == "fit" and len(rows[0]):
            unit = units[p.equation]
            out.append(ResidualTrace(p.recording, p.role, p.equation, unit, *rows))
    return tuple(out)


def _matched(one: Scores, other: Scores) -> list[tuple[Predicted, Predicted]]:
    """Return the predictions of the same equation and recording by two models."""
    known = {(p.equation, p.recording): p for p in other.parts}
    pairs = [(p, known.get((p.equation, p.recording))) for p in one.parts]
    return [(p, q) for p, q in pairs if q is not None]


def shifts_of(before: Constants, after: Constants, units: Mapping[str, str]) -> dict[str, Shift]:
    """Return each nominal parameter without and with the effects."""
    return {n: Shift(before.known.get(n), after.known.get(n), units[n]) for n in before.values}


def curve_of(
    dataset: Dataset, before: Scores, drawn: Sequence[Map], bandwidth_Hz: float
) -> Curve | None:
    """Return the mean of the remaining mismatch over the coordinate of its location; None if no
    simulation knows the coordinate, or if the curve does not lower the error of blocks that were
    left out.

    Args:
        dataset: All recordings.
        before: Errors of the nominal model.
        drawn: Maps of the mismatch, that of the location first.
        bandwidth_Hz: Bandwidth of the errors.
    """
    if not drawn or drawn[0].coordinate not in COORDINATES or drawn[0].equation in AT_INSTANTS:
        return None
    where = drawn[0]
    places, errors, folds = [], [], []
    seen = {v.recording.name: v for v in views_for(dataset.recordings, bandwidth_Hz, before.model)}
    count = 0
    for part in before.of(where.equation, "fit"):
        view, off = seen[part.recording], part.measured - part.model
        value = view.low_pass(getattr(view, COORDINATES[where.coordinate]))
        sense = view.low_pass(view.sense) if where.against_motion else np.ones(len(off))
        known = np.isfinite(off) & (np.abs(sense) > 0.5)
        blocks = np.full(len(off), -1)
        for block in _blocks(part.time, known):
            blocks[block] = count
            count += 1
        places.append(value[known])
        errors.append((off / np.where(sense == 0.0, 1.0, sense))[known])
        folds.append(blocks[known] % FOLDS)
    place, error, fold = (np.concatenate(parts) for parts in (places, errors, folds))
    whole = _binned(place, error)
    if whole is None or count < FOLDS:
        return None
    left = error.copy()
    for k in range(FOLDS):
        part_curve = _binned(place[fold != k], error[fold != k])
        if part_curve is None:
            return None
        left[fold == k] -= np.interp(place[fold == k], *part_curve)
    if not float(left @ left) < (1.0 - RULES.least_curve_gain) * float(error @ error):
        return None
    return where.curve(*whole)


def _binned(place: Array, error: Array) -> tuple[Array, Array] | None:
    """Return centres and means of about equally filled bins, or None for fewer than two bins."""
    edges = np.unique(np.quantile(place, np.linspace(0.0, 1.0, BINS + 1))) if len(place) else place
    if len(edges) < 3:
        return None
    at = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, len(edges) - 2)
    kept = [k for k in range(len(edges) - 1) if np.sum(at == k) >= LEAST_IN_BIN]
    if len(kept) < 2:
        return None
    means = [(float(np.mean(place[at == k])), float(np.mean(error[at == k]))) for k in kept]
    return np.array([m[0] for m in means]), np.array([m[1] for m in means])
