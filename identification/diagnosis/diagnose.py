"""Diagnoses recordings: noise floor, mismatch, location, effects, corrected model, validation.

Recordings with role ``validate`` are set aside: no fit uses them. At the end they decide which
effects are accepted, and the errors of the corrected model are computed on them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from identification.diagnosis.held_out import (
    DROPPED,
    dropped_effects,
    validated_effects,
    validation_rms,
    with_indistinct_effects,
)
from identification.diagnosis.joint import Joint, identifiable, nominal_at
from identification.diagnosis.judgement import (
    Judged,
    effects_of,
    named_or_ambiguous,
    verdict_of,
    without_unlogged,
)
from identification.diagnosis.locate import curve
from identification.diagnosis.observable import Observable, collinear_effects, observable
from identification.diagnosis.reasons import explains_nearly_all
from identification.diagnosis.result import (
    Diagnosis,
    Fit,
    Map,
    ResidualTrace,
    Shift,
    Verdict,
)
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Options, Progress, Search, search
from identification.diagnosis.significance import crowded_recordings, rests_under_torque
from identification.diagnosis.statement import statement, warnings_of
from identification.diagnosis.unexplained import unexplained, unrecorded_effects
from identification.diagnosis.within_limits import choose, fit_from_estimate, views_and_fit
from identification.effects import MOTION
from identification.effects.effect import Effect
from identification.estimate.parameter_table import units_of
from identification.prepare import prepare, torque_unit
from identification.recording import Dataset, RecordingError
from identification.views.view import View, forget, views

Maps = tuple[Map, ...]
Estimate = Callable[[Dataset], tuple[Mapping[str, float | None], tuple[str, ...]]]
"""Function that estimates the nominal parameters of a dataset; it returns name to value, None for a
parameter that is not determined, and the warnings of the estimator.
"""


def diagnose(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    inspect: Callable[[Joint], None] | None = None,
    estimate: Estimate | None = None,
) -> Diagnosis:
    """Test whether effects are missing from the nominal model; identify and locate these effects.

    Args:
        dataset: Recordings; those with role ``validate`` are not fitted.
        bandwidth_Hz: Bandwidth of all errors, or None for a bandwidth chosen from the recordings.
        rng: Random generator for the sign flips.
        progress: Called with the name of the step and the share of the step that is done.
        inspect: Called with the fit of the nominal model before the search.
        estimate: Estimator of the nominal parameters that are reported if nothing is missing; with
            None, the parameters of the fit are reported.

    Raises:
        RecordingError: The recordings do not determine the nominal model or a declared term.
    """
    clock, rng, report = perf_counter(), rng or np.random.default_rng(0), _begin(progress)
    dataset, bandwidth, resting = choose(dataset, bandwidth_Hz)
    here, first = views_and_fit(dataset, bandwidth)
    terms, why = _effects_to_search(dataset, here)
    if inspect is not None:
        inspect(first)
    task = _Task(dataset, here, first, bandwidth, rng, report)
    here, aside, found, judged = _searches(task, terms)
    verdict, where, drawn, reason = judged
    effects = effects_of(found, rng) if verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) else ()
    scored = found.final if effects else found.baseline
    shift = _shifts(found, scored, units_of([prepare(dataset.part("fit")[0], bandwidth)]))
    if verdict is Verdict.NOTHING_MISSING and estimate is not None:
        report("identifying the nominal parameters", 0.97)
        found, shift, more = _with_estimate(found, here, task.unit, estimate(dataset), shift)
        scored, why = found.baseline, (*why, *more)
    main, fits = _fits(found.baseline, scored, aside, task.unit, bandwidth, drawn)
    unseen, traces = collinear_effects(found.baseline, terms), _traces(found.baseline, scored)
    findings = _findings(found, judged, traces, (*here, *aside), rng)
    return Diagnosis(
        verdict=verdict,
        statement=statement(verdict, effects, main, where, found.p_value, unseen, reason),
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
        warnings=(*resting, *warnings_of(dataset, here, unseen), *why, *findings),
        seconds=perf_counter() - clock,
        alpha=dataset.model.alpha,
    )


class _Task(NamedTuple):
    """Inputs of every search of one diagnosis.

    Attributes:
        dataset: The dataset.
        here: Views of the fitted recordings.
        first: Fit of the nominal model to the fitted recordings.
        bandwidth: Bandwidth of every error, Hz.
        rng: Random generator for the sign flips.
        report: Called with the name of the step and the share done.
    """

    dataset: Dataset
    here: tuple[View, ...]
    first: Joint
    bandwidth: float
    rng: np.random.Generator
    report: Progress

    @property
    def unit(self) -> str:
        """Unit of the torque."""
        return torque_unit(self.dataset.part("fit")[0])


class _Outcome(NamedTuple):
    """Views of the fitted recordings and of the recordings set aside, the search after validation,
    and the verdict on this search.
    """

    here: tuple[View, ...]
    aside: tuple[View, ...]
    found: Search
    judged: Judged

    @property
    def verdict(self) -> Verdict:
        """The verdict."""
        return self.judged.verdict


def _searches(task: _Task, terms: Sequence[Effect]) -> _Outcome:
    """Search, validate and judge. While the verdict is *outside the catalogue*, search again
    without the dropped effects, because a dropped effect may have been selected in place of others.
    If no search ends with another verdict, fit the effects for which no score could be computed;
    such an effect must explain nearly all of the mismatch.

    If no further search ends with another verdict, the first outcome is returned.
    """
    outcomes, tried = [_outcome(task, terms)], terms
    for _ in range(RULES.further_searches):
        without = {s.name for s in outcomes[-1].found.steps if s.action == DROPPED}
        if outcomes[-1].verdict is not Verdict.OUTSIDE_CATALOGUE or not without:
            break
        tried = [t for t in tried if t.name not in without]
        outcomes.append(_outcome(task, tried))
    last = outcomes[-1]
    if last.verdict is Verdict.OUTSIDE_CATALOGUE:
        last = _outcome(task, terms, thorough=True)
        last = last if explains_nearly_all(last.found) else outcomes[0]
    taken = last if last.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) else outcomes[0]
    return taken._replace(judged=without_unlogged(taken.judged, taken.found))


def _outcome(task: _Task, terms: Sequence[Effect], thorough: bool = False) -> _Outcome:
    """Search for effects, validate them on unused recordings, and judge the result, once."""
    here, searched, flexible = _search_sides(task, terms, thorough)
    aside = _validation_views(task.dataset, task.bandwidth, flexible)
    task.report("validating effects on unused recordings", 0.92)
    found = validated_effects(searched, here, aside, task.unit)
    task.report("locating", 0.95)
    judged = verdict_of(found, task.rng, searched)
    if judged.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS):
        found = with_indistinct_effects(found, terms)
        judged = judged._replace(verdict=named_or_ambiguous(found))
    return _Outcome(here, aside, found, judged)


def _begin(progress: Progress | None) -> Progress:
    """Release the cached signals of the previous diagnosis; return the progress function."""
    forget()
    report: Progress = progress or (lambda _stage, _share: None)
    report("nominal model", 0.0)
    return report


def _with_estimate(
    found: Search,
    here: Sequence[View],
    unit: str,
    estimated: tuple[Mapping[str, float | None], tuple[str, ...]],
    shift: Mapping[str, Shift],
) -> tuple[Search, dict[str, Shift], tuple[str, ...]]:
    """Return a search without identified effects, with the nominal model at estimated values; the
    nominal parameters before and after this replacement; and the estimator's warnings.
    """
    values, warnings = estimated
    given = {n: v for n, v in values.items() if v is not None}
    nominal = nominal_at(here, unit, found.baseline, given)
    same = {
        n: replace(s, before=values[n], after=values[n]) if n in values else s
        for n, s in shift.items()
    }
    return replace(found, baseline=nominal, final=nominal), same, warnings


def observable_effects(
    dataset: Dataset, bandwidth_Hz: float | None = None
) -> tuple[Observable, ...]:
    """Return which effects these recordings can show, at which size, and which effects they cannot
    distinguish.

    Args:
        dataset: Recordings; those with role ``validate`` are not used.
        bandwidth_Hz: Bandwidth of all errors, or None for the bandwidth that :func:`diagnose`
            chooses.

    Raises:
        RecordingError: The recordings do not determine the nominal model.
    """
    dataset, bandwidth, _ = choose(dataset, bandwidth_Hz)
    here, nominal = views_and_fit(dataset, bandwidth)
    return observable(nominal, _effects_to_search(dataset, here)[0])


def _findings(
    found: Search,
    judged: Judged,
    traces: Sequence[ResidualTrace],
    every: Sequence[View],
    rng: np.random.Generator,
) -> tuple[str, ...]:
    """Return texts on dropped effects, on rests under a torque greater than at the end of any other
    rest, on recordings that contain most of the mismatch, and on the mismatch that the effects do
    not explain.
    """
    verdict = judged.verdict
    crowds = crowded_recordings(traces) if verdict is not Verdict.NOTHING_MISSING else ()
    return (
        *dropped_effects(found),
        *rests_under_torque(every, torque_unit(every[0].recording)),
        *crowds,
        *_still_valve(found, every),
        *unexplained(found, verdict, judged.reason, rng),
    )


def _still_valve(found: Search, every: Sequence[View]) -> tuple[str, ...]:
    """Return a text if the motion of a valve behind a flexible transmission is not used."""
    flexible = any(e.term.flexible for e in found.final.effects)
    if not flexible or any(np.any(v.twist) for v in every):
        return ()
    return (
        "the valve moves too little for a fit of its own motion, so friction is fitted to the "
        "motion of the motor",
    )


def _search_sides(
    task: _Task, terms: Sequence[Effect], thorough: bool
) -> tuple[tuple[View, ...], Search, bool]:
    """Search for effects with friction as a function of the motor's motion. If this search finds a
    flexible transmission, search again with friction as a function of the valve's motion; if the
    valve hardly moves, a longer search with the motor's motion replaces this second search.

    Returns:
        Views of the last search, its result, and whether the transmission is flexible.
    """
    fitted, model = task.dataset.part("fit"), task.dataset.model
    options = Options(True, model.fixed, thorough)
    found = search(task.here, task.unit, task.first, terms, task.rng, task.report, options)
    if not any(e.term.flexible for e in found.final.effects):
        return task.here, found, False
    task.report("search on the valve's side", 0.0)
    options = replace(options, until_flexible=False)
    here = views(fitted, task.bandwidth, True, task.dataset.recordings)
    try:
        again = fit_from_estimate(here, task.unit, task.first.nominal, model)
    except RecordingError:
        found = search(task.here, task.unit, task.first, terms, task.rng, task.report, options)
        return task.here, found, False
    found = search(
        here, task.unit, again, [t.on_the_joint() for t in terms], task.rng, task.report, options
    )
    return here, found, True


def _effects_to_search(
    dataset: Dataset, here: Sequence[View]
) -> tuple[list[Effect], tuple[str, ...]]:
    """Return the effects that the search may select, and warnings that state why others are
    excluded.
    """
    fitted = dataset.part("fit")
    excluded, why = unrecorded_effects(fitted, here)
    left_out = {*dataset.model.terms, *excluded}
    return [t for t in MOTION if t.name not in left_out], why


def _validation_views(dataset: Dataset, bandwidth: float, flexible: bool) -> tuple[View, ...]:
    """Return views of the recordings set aside, that is, with role ``validate``."""
    fitted, held = dataset.part("fit"), dataset.part("validate")
    return views((*fitted, *held), bandwidth, flexible, dataset.recordings)[len(fitted) :]


def _shifts(found: Search, final: Joint, units: Mapping[str, str]) -> dict[str, Shift]:
    """Return each identifiable nominal parameter of the nominal and of the corrected model."""

    def value(joint: Joint, name: str) -> float | None:
        return float(joint.nominal.values[name]) if identifiable(joint, name) else None

    return {
        name: Shift(value(found.baseline, name), value(final, name), units[name])
        for name in found.baseline.nominal.values
    }


def _fits(
    baseline: Joint, final: Joint, aside: Sequence[View], unit: str, bandwidth: float, drawn: Maps
) -> tuple[Fit, tuple[Fit, ...]]:
    """Return the errors of the equation in which the mismatch is judged, and of all equations."""
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
    return next((f for f in out if drawn and f.equation == drawn[0].equation), out[0]), tuple(out)


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
