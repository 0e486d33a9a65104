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
from identification.diagnosis.stack import Stack
from identification.diagnosis.statement import statement, warnings_of
from identification.diagnosis.unexplained import unexplained, unrecorded_effects
from identification.diagnosis.within_limits import choose, fit_from_estimate, views_and_fit
from identification.effects import MOTION
from identification.effects.effect import Effect
from identification.estimate.parameter_table import units_of
from identification.prepare import prepare
from identification.recording import Array, Dataset, RecordingError
from identification.views.view import View, forget, views

Maps = tuple[Map, ...]
IDENTIFIED = (Verdict.NAMED, Verdict.AMBIGUOUS)
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
    clock, rng = perf_counter(), rng or np.random.default_rng(0)
    report: Progress = progress or (lambda _stage, _share: None)
    forget()
    report("nominal model", 0.0)
    dataset, bandwidth, resting = choose(dataset, bandwidth_Hz)
    here, first = views_and_fit(dataset, bandwidth)
    terms, why = _effects_to_search(dataset, here)
    if inspect is not None:
        inspect(first)
    task = _Task(dataset, first, bandwidth, rng, report)
    here, aside, found, judged = _searches(task, terms)
    verdict, where, drawn, reason = judged
    effects = effects_of(found, rng) if verdict in IDENTIFIED else ()
    scored = found.final if effects else found.baseline
    shift = _shifts(found, scored, units_of([prepare(dataset.part("fit")[0], bandwidth)]))
    if verdict is Verdict.NOTHING_MISSING and estimate is not None:
        report("identifying the nominal parameters", 0.97)
        found, shift, more = _with_estimate(found, estimate(dataset), shift)
        scored, why = found.baseline, (*why, *more)
    main, fits = fits_of(found.baseline, scored, aside, bandwidth, drawn)
    unseen, traces = (
        collinear_effects(found.baseline, terms),
        traces_of(found.baseline.stack, found.baseline.residual, scored.residual),
    )
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
    """Inputs of every search of one diagnosis; ``first`` is the fit of the nominal model."""

    dataset: Dataset
    first: Joint
    bandwidth: float
    rng: np.random.Generator
    report: Progress


class _Outcome(NamedTuple):
    """Views of fitted recordings and of those set aside, search after validation, and verdict."""

    here: tuple[View, ...]
    aside: tuple[View, ...]
    found: Search
    judged: Judged


def _searches(task: _Task, terms: Sequence[Effect]) -> _Outcome:
    """Return the first outcome of up to four searches whose verdict names an effect, or the first.

    A dropped effect may have been selected in place of others: the further searches are without
    the dropped effects. In the last search the effects are fitted for which no score could be
    computed; such an effect must explain nearly all of the mismatch.
    """
    outcomes, tried = [_outcome(task, terms)], terms
    for _ in range(RULES.further_searches):
        without = {s.name for s in outcomes[-1].found.steps if s.action == DROPPED}
        if outcomes[-1].judged.verdict is not Verdict.OUTSIDE_CATALOGUE or not without:
            break
        tried = [t for t in tried if t.name not in without]
        outcomes.append(_outcome(task, tried))
    last = outcomes[-1]
    if last.judged.verdict is Verdict.OUTSIDE_CATALOGUE:
        last = _outcome(task, terms, thorough=True)
        last = last if explains_nearly_all(last.found) else outcomes[0]
    taken = last if last.judged.verdict in IDENTIFIED else outcomes[0]
    return taken._replace(judged=without_unlogged(taken.judged, taken.found))


def _outcome(task: _Task, terms: Sequence[Effect], thorough: bool = False) -> _Outcome:
    """Search for effects, validate them on unused recordings, and judge the result, once."""
    here, searched, flexible = _search_sides(task, terms, thorough)
    fitted, held = task.dataset.part("fit"), task.dataset.part("validate")
    every = views((*fitted, *held), task.bandwidth, flexible, task.dataset.recordings)
    aside = every[len(fitted) :]
    found, judged = judge(searched, aside, terms, task.rng, task.report)
    return _Outcome(here, aside, found, judged)


def judge(
    searched: Search,
    aside: Sequence[View],
    terms: Sequence[Effect],
    rng: np.random.Generator,
    report: Progress,
) -> tuple[Search, Judged]:
    """Validate the effects of a search on unused recordings, and judge the result.

    Args:
        searched: The search.
        aside: Recordings that are set aside.
        terms: Effects that were searched for.
        rng: Random generator for the bands of the maps.
        report: Called with the name of the step and the share of the step that is done.
    """
    report("validating effects on unused recordings", 0.92)
    found = validated_effects(searched, aside)
    report("locating", 0.95)
    judged = verdict_of(found, rng, searched)
    if judged.verdict in IDENTIFIED:
        found = with_indistinct_effects(found, terms)
        judged = judged._replace(verdict=named_or_ambiguous(found))
    return found, judged


def _with_estimate(
    found: Search,
    estimated: tuple[Mapping[str, float | None], tuple[str, ...]],
    shift: Mapping[str, Shift],
) -> tuple[Search, dict[str, Shift], tuple[str, ...]]:
    """Return the search and the shifts at estimated values, and the estimator's warnings."""
    values, warnings = estimated
    given = {n: v for n, v in values.items() if v is not None}
    nominal = nominal_at(found.baseline, given)
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
    """Return texts on effects, recordings and mismatch that the result needs."""
    verdict = judged.verdict
    crowds = crowded_recordings(traces) if verdict is not Verdict.NOTHING_MISSING else ()
    return (
        *dropped_effects(found),
        *rests_under_torque(every, found.baseline.unit),
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
    """Search with friction as a function of the motor's motion and, if the transmission is found to
    be flexible, again as a function of the valve's motion, unless the valve hardly moves.

    Returns views and result of the last search, and whether the valve's motion is used.
    """
    dataset, first, model = task.dataset, task.first, task.dataset.model
    options = Options(True, model.fixed, thorough)
    found = search(first, terms, task.rng, task.report, options)
    if not any(e.term.flexible for e in found.final.effects):
        return first.views, found, False
    task.report("search on the valve's side", 0.0)
    options = replace(options, until_flexible=False)
    here = views(dataset.part("fit"), task.bandwidth, True, dataset.recordings)
    try:
        again = fit_from_estimate(here, first.unit, first.nominal, model)
    except RecordingError:
        return first.views, search(first, terms, task.rng, task.report, options), False
    terms = [t.on_the_joint() for t in terms]
    return here, search(again, terms, task.rng, task.report, options), True


def _effects_to_search(
    dataset: Dataset, here: Sequence[View]
) -> tuple[list[Effect], tuple[str, ...]]:
    """Return the effects to search for, and warnings that state why others are excluded."""
    excluded, why = unrecorded_effects(dataset.part("fit"), here)
    left_out = {*dataset.model.terms, *excluded}
    return [t for t in MOTION if t.name not in left_out], why


def _shifts(found: Search, final: Joint, units: Mapping[str, str]) -> dict[str, Shift]:
    """Return each identifiable nominal parameter of the nominal and of the corrected model."""

    def value(joint: Joint, name: str) -> float | None:
        return float(joint.nominal.values[name]) if identifiable(joint, name) else None

    return {
        name: Shift(value(found.baseline, name), value(final, name), units[name])
        for name in found.baseline.nominal.values
    }


def fits_of(
    baseline: Joint, final: Joint, aside: Sequence[View], bandwidth: float, drawn: Maps
) -> tuple[Fit, tuple[Fit, ...]]:
    """Return the errors of the equation in which the mismatch is judged, and of all equations."""
    held_before, held_after = validation_rms(baseline, aside), validation_rms(final, aside)
    out = []
    for equation in baseline.equations:
        rows = baseline.stack.part(equation.name)
        rms = [
            equation.sigma * math.sqrt(float(np.mean(j.residual[rows][equation.owner >= 0] ** 2)))
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


def traces_of(stack: Stack, first: Array, last: Array) -> tuple[ResidualTrace, ...]:
    """Return whitened rows by two models as the mismatch of every recording and equation."""
    out = []
    for equation in stack.equations:
        rows = stack.part(equation.name)
        before, after = (equation.sigma * left[rows] for left in (first, last))
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
