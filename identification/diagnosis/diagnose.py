"""Diagnosis of recordings: noise floor, test for a mismatch, its location, the effects, the
corrected model and its validation.

Recordings set aside (role ``validate``) take no part in any fit. At the end they decide which
effects are accepted, and they are scored.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from identification.diagnosis.catalogue import ENTRIES
from identification.diagnosis.catalogue.entry import title
from identification.diagnosis.fit.at_values import nominal_at
from identification.diagnosis.fit.intervals import identifiable
from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.start import bandwidth_of, fit_from_estimate, views_and_fit
from identification.diagnosis.result import (
    Diagnosis,
    Effect,
    Fit,
    Location,
    ResidualTrace,
    Shift,
    Verdict,
)
from identification.diagnosis.rows.view import View, views
from identification.diagnosis.score.collinear import collinear_effects
from identification.diagnosis.score.locate import curve
from identification.diagnosis.score.observable import Observable, observable
from identification.diagnosis.score.significance import LEVEL
from identification.diagnosis.score.single_recordings import crowded_recordings, rests_under_torque
from identification.diagnosis.selection.held_out import (
    dropped_effects,
    validated_effects,
    validation_rms,
)
from identification.diagnosis.selection.indistinct import with_indistinct_effects
from identification.diagnosis.selection.search import Progress, Search, search
from identification.diagnosis.terms import TERMS
from identification.diagnosis.terms.term import Term
from identification.diagnosis.terms.transmission import on_the_joint
from identification.diagnosis.verdict.judgement import effects_of, insufficient_effects, verdict_of
from identification.diagnosis.verdict.unrecorded import unrecorded_effects
from identification.estimate.uncertainty.parameter_table import units_of
from identification.prepare import prepare, torque_unit
from identification.recording import Bench, Dataset, Recording, RecordingError

FLEXIBLE = ("backlash", "compliance", "coupling_hysteresis", "gear_mesh_ripple")
"""Effects with which the valve moves otherwise than the motor, so that its friction depends on the
joint encoder's angle.
"""
Estimate = Callable[[Dataset], Mapping[str, float | None]]
"""Nominal parameters of a dataset by another estimator; None for one that is not determined."""
ANGULAR = (
    "cogging",
    "torque_ripple",
    "gear_mesh_ripple",
    "encoder_eccentricity",
    "gravity_imbalance",
)
"""Effects periodic in an angle, which a linear bench without a gear ratio (rad/m) cannot show."""


def diagnose(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    inspect: Callable[[Joint], None] | None = None,
    estimate: Estimate | None = None,
) -> Diagnosis:
    """Test whether effects are missing from the nominal model, identify and locate them.

    Args:
        dataset: Recordings; those with role ``validate`` take no part in any fit.
        bandwidth_Hz: Bandwidth of every error; None chooses it from the recordings.
        rng: Random generator for the sign flips.
        progress: Called with the name of the step and the share done.
        inspect: Called with the nominal model's fit before the search.
        estimate: Returns the nominal parameters of the recordings, None for one that they do not
            determine; used if nothing is missing, as the nominal model is then complete. None
            keeps the values fitted to the equations.

    Raises:
        RecordingError: The recordings do not determine the nominal model or a declared term.
    """
    clock, rng = perf_counter(), rng or np.random.default_rng(0)
    report: Progress = progress or (lambda _stage, _share: None)
    report("nominal model", 0.0)
    fitted, bandwidth = _fitted(dataset, bandwidth_Hz)
    unit, prepared = torque_unit(fitted[0]), [prepare(fitted[0], bandwidth)]
    here, first = views_and_fit(dataset, bandwidth)
    terms, why = _effects_to_search(dataset, here)
    if inspect is not None:
        inspect(first)
    here, searched, gives = _search_sides(dataset, (here, first), terms, bandwidth, rng, report)
    aside = _validation_views(dataset, bandwidth, gives)
    report("validating effects on unused recordings", 0.92)
    found = with_indistinct_effects(validated_effects(searched, here, aside, unit), terms)
    report("locating", 0.95)
    verdict, where, drawn = verdict_of(found, rng, searched)
    effects = effects_of(found, rng) if verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) else ()
    shift = _shifts(found, found.final if effects else found.baseline, units_of(prepared))
    if verdict is Verdict.NOTHING_MISSING and estimate is not None:
        report("identifying the nominal parameters", 0.97)
        found, shift = _with_estimate(found, here, unit, estimate(dataset), shift)
    scored = found.final if effects else found.baseline
    fits = _fits(found.baseline, scored, aside, unit, bandwidth)
    main = next((f for f in fits if drawn and f.equation == drawn[0].equation), fits[0])
    unseen, traces = collinear_effects(found.baseline, terms), _traces(found.baseline, scored)
    partly = insufficient_effects(found, verdict, rng)
    places = (*_local_findings(verdict, traces, (*here, *aside)), *partly)
    return Diagnosis(
        verdict=verdict,
        statement=_statement(verdict, effects, main, where, found.p_value, unseen),
        effects=effects,
        fit=main,
        fits=fits,
        parameters=dict(scored.nominal.values),
        parameter_shift=shift,
        p_value=found.p_value,
        location=where,
        curve=curve(drawn) if verdict is Verdict.OUTSIDE_CATALOGUE else None,
        maps=drawn,
        steps=found.steps,
        traces=traces,
        warnings=(*_warnings(dataset, here, unseen), *why, *dropped_effects(found), *places),
        seconds=perf_counter() - clock,
        alpha=dataset.model.alpha,
    )


def _with_estimate(
    found: Search,
    here: Sequence[View],
    unit: str,
    values: Mapping[str, float | None],
    shift: Mapping[str, Shift],
) -> tuple[Search, dict[str, Shift]]:
    """Return a search that found nothing with the nominal model at estimated values, and these
    values before and after the correction.
    """
    given = {n: v for n, v in values.items() if v is not None}
    nominal = nominal_at(here, unit, found.baseline, given)
    same = {
        n: replace(s, before=values[n], after=values[n]) if n in values else s
        for n, s in shift.items()
    }
    return replace(found, baseline=nominal, final=nominal), same


def observable_effects(
    dataset: Dataset, bandwidth_Hz: float | None = None
) -> tuple[Observable, ...]:
    """Return which effects these recordings can show, at which size, and which they cannot
    distinguish.

    Args:
        dataset: Recordings; those with role ``validate`` take no part.
        bandwidth_Hz: Bandwidth of every error; None chooses it as :func:`diagnose` does.

    Raises:
        RecordingError: The recordings do not determine the nominal model.
    """
    here, nominal = views_and_fit(dataset, _fitted(dataset, bandwidth_Hz)[1])
    return observable(nominal, _effects_to_search(dataset, here)[0])


def _local_findings(
    verdict: Verdict, traces: Sequence[ResidualTrace], every: Sequence[View]
) -> tuple[str, ...]:
    """Return texts on rests under a torque that no other rest withstood, and on recordings that
    contain most of the mismatch.
    """
    crowds = crowded_recordings(traces) if verdict is not Verdict.NOTHING_MISSING else ()
    return (*rests_under_torque(every, torque_unit(every[0].recording)), *crowds)


def _fitted(dataset: Dataset, bandwidth_Hz: float | None) -> tuple[tuple[Recording, ...], float]:
    """Return the recordings to fit, and the bandwidth of every error, Hz.

    Raises:
        RecordingError: No recording has the role ``fit``.
    """
    fitted = dataset.part("fit")
    if not fitted:
        raise RecordingError(
            "no recording has the role fit; a diagnosis needs at least one: set role: fit in the "
            "campaign file"
        )
    return fitted, bandwidth_Hz or bandwidth_of(fitted)


def _search_sides(
    dataset: Dataset,
    start: tuple[tuple[View, ...], Joint],
    terms: Sequence[Term],
    bandwidth: float,
    rng: np.random.Generator,
    report: Progress,
) -> tuple[tuple[View, ...], Search, bool]:
    """Search for effects on the motor's side and, with a flexible transmission, again on the
    valve's side.

    Args:
        dataset: The dataset.
        start: Views of its recordings and the fit of the nominal model.
        terms: Effects to choose from.
        bandwidth: Bandwidth of every error, Hz.
        rng: Random generator for the sign flips.
        report: Called with the name of the step and the share done.

    Returns:
        Views of the last search, its result, and whether the transmission is flexible.
    """
    (here, first), fitted, fixed = start, dataset.part("fit"), dataset.model.fixed
    unit = torque_unit(fitted[0])
    found = search(here, unit, first, terms, rng, report, FLEXIBLE, fixed)
    if not any(e.term.name in FLEXIBLE for e in found.final.effects):
        return here, found, False
    report("search on the valve's side", 0.0)
    here = views(fitted, bandwidth, True, dataset.recordings)
    again = fit_from_estimate(here, unit, first.nominal, dataset.model)
    return here, search(here, unit, again, on_the_joint(terms), rng, report, fixed=fixed), True


def _effects_to_search(
    dataset: Dataset, here: Sequence[View]
) -> tuple[list[Term], tuple[str, ...]]:
    """Return the effects to search for, and warnings that state why others are excluded."""
    fitted = dataset.part("fit")
    excluded, why = unrecorded_effects(fitted, here)
    left_out = {*dataset.model.terms, *(ANGULAR if _is_linear(fitted[0].bench) else ()), *excluded}
    return [t for t in TERMS if t.name not in left_out], why


def _validation_views(dataset: Dataset, bandwidth: float, gives: bool) -> tuple[View, ...]:
    """Return views of the recordings that are set aside."""
    fitted, held = dataset.part("fit"), dataset.part("validate")
    return views((*fitted, *held), bandwidth, gives, dataset.recordings)[len(fitted) :]


def _is_linear(bench: Bench) -> bool:
    """Whether a linear bench is described without its motor and gear."""
    return bench.motion == "linear" and bench.gear_ratio == 1.0


def _shifts(found: Search, final: Joint, units: Mapping[str, str]) -> dict[str, Shift]:
    """Return each nominal parameter before and after the correction, if it is identifiable."""

    def value(joint: Joint, name: str) -> float | None:
        return float(joint.nominal.values[name]) if identifiable(joint, name) else None

    return {
        name: Shift(value(found.baseline, name), value(final, name), units[name])
        for name in found.baseline.nominal.values
    }


def _fits(
    baseline: Joint, final: Joint, aside: Sequence[View], unit: str, bandwidth: float
) -> tuple[Fit, ...]:
    held_before, held_after = (
        validation_rms(baseline, aside, unit),
        validation_rms(final, aside, unit),
    )
    out = []
    for equation in baseline.equations:
        rows = baseline.stack.part(equation.name)
        rms = [
            equation.sigma * math.sqrt(float(np.mean(j.residual[rows] ** 2)))
            for j in (baseline, final)
        ]
        out.append(
            Fit(
                equation=equation.name,
                unit=equation.unit,
                bandwidth_Hz=bandwidth,
                baseline_rms=rms[0],
                final_rms=rms[1],
                noise_floor_rms=equation.sigma,
                validate_baseline_rms=held_before.get(equation.name),
                validate_final_rms=held_after.get(equation.name),
            )
        )
    return tuple(out)


def _traces(baseline: Joint, final: Joint) -> tuple[ResidualTrace, ...]:
    out = []
    for equation in baseline.equations:
        rows = baseline.stack.part(equation.name)
        before, after = (equation.sigma * j.residual[rows] for j in (baseline, final))
        for view in equation.views:
            mine = equation.owner == view.index
            if np.any(mine):
                out.append(
                    ResidualTrace(
                        view.recording.name,
                        view.recording.role,
                        equation.name,
                        equation.unit,
                        equation.time[mine],
                        before[mine],
                        after[mine],
                    )
                )
    return tuple(out)


def _statement(
    verdict: Verdict,
    effects: Sequence[Effect],
    main: Fit,
    where: Location | None,
    p_value: float,
    unseen: Sequence[str],
) -> str:
    error = (
        f"{main.equation} error {main.baseline_rms:.3g} {main.unit}; noise floor "
        f"{main.noise_floor_rms:.3g}"
    )
    if verdict is Verdict.NOTHING_MISSING:
        evidence = f"p = {p_value:.2g}" if p_value > LEVEL else "the mismatch is within the noise"
        said = f"nothing is missing that these recordings could show ({evidence}); {error}"
        return f"{said}; {_unobservable_sentence(unseen)}" if unseen else said
    held = main.validate_baseline_rms is not None and main.validate_final_rms is not None
    before, after = (
        (main.validate_baseline_rms, main.validate_final_rms)
        if held
        else (main.baseline_rms, main.final_rms)
    )
    recordings = "unseen recordings" if held else "the recordings it was fitted to"
    change = (
        f"{main.equation.capitalize()} error on {recordings} {before:.3g} -> {after:.3g} "
        f"{main.unit}; "
        f"noise floor {main.noise_floor_rms:.3g}."
    )
    if verdict is Verdict.OUTSIDE_CATALOGUE:
        place = f", most of it over {where.coordinate}" if where else ""
        return (
            f"the {main.equation} equation has a mismatch that no effect of the catalogue "
            f"explains{place}; {error}"
        )
    words = "; and ".join(e.statement for e in effects)
    if verdict is Verdict.AMBIGUOUS:
        groups = [
            " or ".join(title(n) for n in e.alias_group) for e in effects if len(e.alias_group) > 1
        ]
        words = f"{words}. These recordings cannot distinguish {' and '.join(groups)}"
    return f"{words}. {change}"


def _unobservable_sentence(names: Sequence[str]) -> str:
    return (
        f"these recordings cannot show {', '.join(title(n) for n in names)}, which the nominal "
        f"parameters can explain completely"
    )


def _warnings(dataset: Dataset, here: Sequence[View], unseen: Sequence[str]) -> tuple[str, ...]:
    warnings = []
    if unseen:
        warnings.append(
            f"{_unobservable_sentence(unseen)}; an experiment that shows it: "
            f"{' '.join(ENTRIES[n].experiment for n in unseen)}"
        )
    if not dataset.part("validate"):
        warnings.append(
            "no recording is set aside (role: validate), so all errors are those of the "
            "fitted recordings"
        )
    for view in here:
        if not np.any(view.moving):
            warnings.append(
                f"{view.recording.name}: no sample is in steady motion, so this recording does not "
                "contribute to the torque equation"
            )
    return tuple(warnings)
