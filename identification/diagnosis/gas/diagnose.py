"""Diagnoses the gas generator: noise, test for a mismatch, location, effects and validation.

The errors on validation recordings are computed once, at the end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from scipy import stats

from identification.diagnosis.comparison import probability
from identification.diagnosis.gas.burns import CONSTANTS, VOLUME, Burn, burns, noise
from identification.diagnosis.gas.fit import Fitted, fit, nominal_model
from identification.diagnosis.gas.rows import COORDINATES, PRESSURE, UNIT, coordinates, padded_rows
from identification.diagnosis.gas.search import GasSearch, Progress, Rivalry, Selected, search
from identification.diagnosis.locate import Axis, curve, map_over, ranges
from identification.diagnosis.result import (
    Diagnosis,
    Estimate,
    Fit,
    IdentifiedEffect,
    Location,
    Map,
    ResidualTrace,
    Rival,
    Shift,
    Verdict,
)
from identification.diagnosis.rules import RULES
from identification.diagnosis.statement import finding
from identification.effects.effect import title
from identification.effects.gas_generator import GasEffect
from identification.numerics.spread import CONFIDENCE
from identification.recording import Dataset, RecordingError

ADEQUATE = 0.9
"""Least share of the mismatch power beyond the noise that the effects must explain together, if the
remaining mismatch exceeds the noise. The share is high because the gas balance, unlike friction,
has no unmodelled details: the right effect explains nearly all.
"""
_GREATEST_CONFIDENCE = 0.99
VALIDATION_RATIO = 1.5
"""Ratio of the rms error on validation recordings to the noise, from which a warning is given."""
DEVIATION_LIMIT = 3.0
"""Deviation of a constant, in tolerances, from which it is reported."""


def diagnose_gas(
    dataset: Dataset, *, rng: np.random.Generator | None = None, progress: Progress | None = None
) -> Diagnosis:
    """Test whether physics is missing from the gas-generator model; identify and locate the missing
    effects.

    The constants of propellant, valve and sensors, within their tolerances
    (:data:`identification.diagnosis.gas.burns.CONSTANTS`), and the state at the start of every
    recording are fitted together with the effects.

    Args:
        dataset: Recordings with pressure and valve angle, each from its ignition; recordings with
            role ``validate`` are used once, at the end.
        rng: Random generator for the sign flips.
        progress: Called with the name of the step and the share of the step that is done.

    Raises:
        RecordingError: A recording cannot be used.
    """
    started = perf_counter()
    tell: Progress = progress or (lambda _stage, _share: None)
    chance = rng or np.random.default_rng(0)
    _require_fitted(dataset)
    here, aside = burns(dataset.part("fit")), burns(dataset.part("validate"))
    found = search(here, noise(here), chance, tell)
    tell("locating", 0.95)
    drawn = _maps(found, chance)
    where = _location(found, drawn[0]) if drawn else None
    verdict = _verdict(found)
    effects = (
        _effects(found, where) if where and verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) else ()
    )
    scored = found.final if effects else found.baseline
    held = (
        (_validated(found.baseline, aside, found.sigma), _validated(scored, aside, found.sigma))
        if aside
        else None
    )
    main = _fit(found, scored, held)
    return Diagnosis(
        verdict=verdict,
        statement=_statement(verdict, effects, main, where, found.p_value),
        effects=effects,
        fit=main,
        fits=(main,),
        parameters=_constants(scored),
        parameter_shift=_shifts(found.baseline, scored),
        p_value=found.p_value,
        location=None if verdict is Verdict.NOTHING_MISSING else where,
        curve=curve(drawn) if verdict is Verdict.OUTSIDE_CATALOGUE else None,
        maps=drawn,
        steps=found.steps,
        traces=(
            *_traces(found.burns, found.baseline, scored, found.sigma),
            *(_traces(aside, held[0], held[1], found.sigma) if held else ()),
        ),
        warnings=_warnings(dataset, found, main),
        seconds=perf_counter() - started,
    )


def _require_fitted(dataset: Dataset) -> None:
    if not dataset.part("fit"):
        raise RecordingError(
            "no recording has the role fit, but a diagnosis needs at least one; set `role: fit` in "
            "the campaign file"
        )


def _shifts(baseline: Fitted, scored: Fitted) -> dict[str, Shift]:
    """Return the value of each constant in the nominal model and in the corrected model."""
    after = _constants(scored)
    return {
        name: Shift(before, after[name], CONSTANTS[name].unit if name in CONSTANTS else VOLUME.unit)
        for name, before in _constants(baseline).items()
    }


def _verdict(found: GasSearch) -> Verdict:
    if found.p_value > RULES.level:
        return Verdict.NOTHING_MISSING
    if not found.taken or _explained(found) < ADEQUATE:
        return Verdict.OUTSIDE_CATALOGUE
    return (
        Verdict.AMBIGUOUS if any(r.open for t in found.taken for r in t.rivals) else Verdict.NAMED
    )


def _explained(found: GasSearch) -> float:
    """Return the share of the mismatch beyond the noise that the effects explain; 1 if no
    significant mismatch remains.
    """
    if found.p_after > RULES.level:
        return 1.0
    before, after = (float(np.mean(f.residual**2)) for f in (found.baseline, found.final))
    return min(1.0, max(0.0, (before - max(after, 1.0)) / max(before - 1.0, 1e-12)))


def _effects(found: GasSearch, where: Location) -> tuple[IdentifiedEffect, ...]:
    sizes = intervals(found)
    taken = {t.name: t for t in found.taken}
    return tuple(
        _effect(effect, taken[effect.term.name], size, where, _explained(found))
        for effect, size in zip(found.final.model.effects, sizes, strict=True)
    )


def _effect(
    effect: GasEffect,
    taken: Selected,
    sizes: Mapping[str, Estimate],
    where: Location,
    explained: float,
) -> IdentifiedEffect:
    entry = effect.term
    sure = min([probability(r.preference) for r in taken.rivals], default=_GREATEST_CONFIDENCE)
    return IdentifiedEffect(
        name=entry.name,
        alias_group=(entry.name, *(r.name for r in taken.rivals if r.open)),
        confidence=min(_GREATEST_CONFIDENCE, sure) * (0.5 + 0.5 * explained),
        statement=finding(entry, sizes, where.recordings),
        assumption_broken=entry.assumption,
        where=where,
        parameters=sizes,
        rivals=tuple(_rival(r) for r in taken.rivals),
        separating_experiment=entry.experiment,
    )


def _rival(rivalry: Rivalry) -> Rival:
    why = (
        ""
        if rivalry.open
        else f"the error with this rival is larger by {rivalry.preference:.1f} standard errors"
    )
    return Rival(rivalry.name, min(1.0 - probability(rivalry.preference), 0.5), why)


def intervals(found: GasSearch) -> list[dict[str, Estimate]]:
    """Return the parameters of each effect with 90 % intervals, from the scatter over blocks of
    time (Liang and Zeger, Biometrika 73 (1986) 13).
    """
    final, stack = found.final, found.stack
    scale = np.linalg.norm(final.tangent, axis=0) + final.held
    tangent = final.tangent / scale
    bread = np.linalg.pinv(tangent.T @ tangent + np.diag((final.held / scale) ** 2), hermitian=True)
    sums = stack.sums(padded_rows(stack, tangent * final.residual[:, None]))
    sums[-1] = final.held / scale * final.pull
    count = final.tangent.shape[1]
    freedom = max(stack.blocks - count, 3)
    covariance = bread @ (sums.T @ sums) @ bread * stack.blocks / freedom / np.outer(scale, scale)
    wide = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, freedom)) * np.sqrt(np.diag(covariance))
    at = count - sum(len(e.term.sizes) for e in final.model.effects)
    out = []
    for effect in final.model.effects:
        units = {q.name: q.unit for q in effect.term.parameters}
        sizes = {}
        for name, size in effect.term.sizes.items():
            value, half = effect.parameters[name], float(wide[at])
            if size.trials:
                low, high = value * math.exp(-half), value * math.exp(min(half, 50.0))
            else:
                low, high = value - size.scale * half, value + size.scale * half
            sizes[name] = Estimate(value, low, high, units[name])
            at += 1
        out.append(sizes)
    return out


def _constants(fitted: Fitted) -> dict[str, float]:
    """Return the constants that all recordings have in common, and the mean of the free volumes."""
    volumes = [s.volume for s in fitted.model.starts]
    return {**fitted.model.constants, "V_0": float(np.mean(volumes))}


def _maps(found: GasSearch, rng: np.random.Generator) -> tuple[Map, ...]:
    before, after = (found.sigma * f.residual for f in (found.baseline, found.final))
    units = {c.name: c.unit for c in COORDINATES}
    stack, equation = found.stack, found.stack.equations[0]
    drawn = [
        map_over(
            equation,
            Axis(name, units[name], values),
            before,
            after,
            stack.block[: len(values)],
            stack.blocks,
            rng,
        )
        for name, values in coordinates(found.burns, found.baseline)
    ]
    return tuple(sorted((m for m in drawn if m is not None), key=lambda m: -m.share))


def _location(found: GasSearch, best: Map) -> Location:
    edges = np.cumsum([len(b.time) for b in found.burns])[:-1]
    powers = [float(np.mean(part**2)) for part in np.split(found.baseline.residual, edges)]
    names = tuple(
        b.recording.name for b, p in zip(found.burns, powers, strict=True) if p > RULES.recording
    )
    return Location(best.coordinate, best.unit, ranges(best), best.share, names)


def _fit(found: GasSearch, scored: Fitted, held: tuple[Fitted, Fitted] | None) -> Fit:
    step = min(float(np.median(np.diff(b.time))) for b in found.burns)
    return Fit(
        equation=PRESSURE,
        unit=UNIT,
        bandwidth_Hz=0.5 / step,
        baseline_rms=_rms(found.baseline, found.sigma),
        final_rms=_rms(scored, found.sigma),
        noise_floor_rms=found.sigma,
        validate_baseline_rms=_rms(held[0], found.sigma) if held else None,
        validate_final_rms=_rms(held[1], found.sigma) if held else None,
    )


def _rms(fitted: Fitted, sigma: float) -> float:
    return sigma * math.sqrt(float(np.mean(fitted.residual**2)))


def _validated(fitted: Fitted, aside: Sequence[Burn], sigma: float) -> Fitted:
    """Return the prediction of a model for recordings set aside; of these recordings only the state
    at the start is fitted.
    """
    starts = nominal_model(aside).starts
    return fit(aside, sigma, replace(fitted.model, starts=starts), shared=False)


def _traces(
    here: Sequence[Burn], before: Fitted, after: Fitted, sigma: float
) -> list[ResidualTrace]:
    edges = np.cumsum([len(b.time) for b in here])[:-1]
    pairs = zip(
        here,
        np.split(sigma * before.residual, edges),
        np.split(sigma * after.residual, edges),
        strict=True,
    )
    return [
        ResidualTrace(b.recording.name, b.recording.role, PRESSURE, UNIT, b.time, first, last)
        for b, first, last in pairs
    ]


def _statement(
    verdict: Verdict,
    effects: Sequence[IdentifiedEffect],
    main: Fit,
    where: Location | None,
    p_value: float,
) -> str:
    error = f"pressure error {main.baseline_rms:.3g} Pa; noise floor {main.noise_floor_rms:.3g}"
    if verdict is Verdict.NOTHING_MISSING:
        return (
            f"nothing is missing from the model of the gas generator that these recordings could "
            f"show (p = {p_value:.2g}); {error}"
        )
    if verdict is Verdict.OUTSIDE_CATALOGUE:
        place = f", most of it over {where.coordinate}" if where else ""
        return (
            f"the pressure has a mismatch that no effect of the catalogue explains{place}; {error}"
        )
    words = "; and ".join(e.statement for e in effects)
    if verdict is Verdict.AMBIGUOUS:
        groups = [
            " or ".join(title(n) for n in e.alias_group) for e in effects if len(e.alias_group) > 1
        ]
        words = f"{words}. These recordings cannot distinguish {' and '.join(groups)}"
    before, after, on = main.baseline_rms, main.final_rms, "the recordings it was fitted to"
    if main.validate_baseline_rms is not None and main.validate_final_rms is not None:
        before, after, on = (
            main.validate_baseline_rms,
            main.validate_final_rms,
            "recordings set aside",
        )
    return (
        f"{words}. Pressure error on {on} {before:.3g} -> {after:.3g} Pa; noise floor "
        f"{main.noise_floor_rms:.3g}."
    )


def _warnings(dataset: Dataset, found: GasSearch, main: Fit) -> tuple[str, ...]:
    warnings = []
    if not dataset.part("validate"):
        warnings.append(
            "no recording is set aside (role: validate), so all errors are errors on the fitted "
            "recordings"
        )
    unseen = main.validate_final_rms
    if unseen is not None and unseen > VALIDATION_RATIO * main.noise_floor_rms:
        warnings.append(
            f"on recordings set aside the error is {unseen / main.noise_floor_rms:.2g} times the "
            f"noise (limit {VALIDATION_RATIO:g}): the fitted recordings do not determine the "
            "parameters of the gas generator; fit recordings with steps between narrow and wide "
            "throats too"
        )
    for burn in found.burns:
        if float(np.ptp(burn.areas[0])) < 0.02 * float(np.mean(burn.areas[0])):
            warnings.append(
                f"{burn.recording.name}: the throat area hardly changes, so this recording shows "
                "no transient"
            )
    off = zip(CONSTANTS.items(), found.baseline.pull, strict=False)
    strained = [
        f"{name} by {abs(p):.1f} times {c.tolerance:.2g} {c.unit}"
        for (name, c), p in off
        if abs(p) > DEVIATION_LIMIT
    ]
    if strained:
        warnings.append(
            "a model without effects would need constants that differ from their nominal values: "
            f"{', '.join(strained)}; check these constants first"
        )
    return tuple(warnings)
