"""Diagnoses recordings: noise floor, mismatch, location, effects, corrected model, validation.

Recordings with role ``validate`` are set aside: no fit uses them. At the end they decide which
effects are accepted, and the errors of the corrected model are computed on them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
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
from identification.diagnosis.joint import Joint, fit
from identification.diagnosis.judgement import (
    Judged,
    effects_of,
    named_or_ambiguous,
    place_of,
    verdict_of,
    without_unlogged,
)
from identification.diagnosis.observable import Observable, collinear_effects, observable
from identification.diagnosis.reasons import Kind, Reason, explains_nearly_all, floors_left
from identification.diagnosis.result import Diagnosis, Fit, IdentifiedEffect, ResidualTrace, Verdict
from identification.diagnosis.rows import AT_INSTANTS
from identification.diagnosis.rules import RULES
from identification.diagnosis.scored import (
    Constants,
    Estimate,
    Scores,
    constants_of,
    covariance_of,
    curve_of,
    fits_of,
    grown,
    identified_constants,
    reported,
    scores,
    shifts_of,
    traces_of,
    unreported_constants,
)
from identification.diagnosis.search import Options, Progress, Search, search
from identification.diagnosis.significance import (
    crowded_recordings,
    rests_under_torque,
    trusted,
)
from identification.diagnosis.statement import statement, warnings_of
from identification.diagnosis.unexplained import unexplained, unrecorded_effects
from identification.diagnosis.within_limits import (
    choose,
    fit_from_estimate,
    long_enough,
    views_and_fit,
)
from identification.effects import EFFECTS, MOTION, with_own
from identification.effects.effect import Effect
from identification.effects.model import CorrectedModel
from identification.estimate.covariance import uncertain_constants
from identification.estimate.parameter_table import units_of
from identification.numerics.arrays import spanned
from identification.prepare import prepare
from identification.recording import Dataset, RecordingError
from identification.views.view import View, forget, one_clock, views

IDENTIFIED = (Verdict.NAMED, Verdict.AMBIGUOUS)


def diagnose(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    inspect: Callable[[Joint], None] | None = None,
    searched: Callable[[Search], None] | None = None,
    estimate: Estimate | None = None,
    effects: Sequence[Effect | type[Effect]] = (),
) -> Diagnosis:
    """Test whether effects are missing from the nominal model; identify and locate these effects.

    Args:
        dataset: Recordings; those with role ``validate`` are not fitted.
        bandwidth_Hz: Bandwidth of all errors, or None for a bandwidth chosen from the recordings.
        rng: Random generator for the sign flips.
        progress: Called with the name of the step and the share of the step that is done.
        inspect: Called with the fit of the nominal model before the search.
        searched: Called with the search whose effects are reported.
        estimate: The estimator of ``rig identify``, whose constants are those of the nominal
            model; the constants of the corrected model are refined by prediction errors too. With
            None, the constants are those of the fit of the rows.
        effects: Effects of one's own (:class:`identification.effects.own.OwnEffect`), which are
            searched beside those of the catalogue.

    Raises:
        RecordingError: The recordings do not determine the nominal model or a declared term.
        EffectError: An effect of one's own fails, or has the name of another effect.
    """
    clock, rng = perf_counter(), rng or np.random.default_rng(0)
    report: Progress = progress or (lambda _stage, _share: None)
    forget()
    report("nominal model", 0.0)
    everything, bandwidth, short = long_enough(dataset, bandwidth_Hz)
    dataset, _, resting = choose(everything, bandwidth)
    here, first = views_and_fit(dataset, bandwidth)
    terms, why = _effects_to_search(dataset, here, effects)
    if inspect is not None:
        inspect(first)
    task = _Task(everything, dataset, first, bandwidth, estimate, rng, report)
    here, aside, found, judged = _searches(task, terms)
    trusting = trusted(aside, (*here, *aside))
    if judged.verdict is Verdict.NOTHING_MISSING and _missing_aside(task, found.baseline, trusting):
        again = diagnose(
            _all_fitted(everything, {v.recording.name for v in trusting}),
            bandwidth_Hz=bandwidth_Hz,
            rng=rng,
            progress=progress,
            searched=searched,
            estimate=estimate,
            effects=effects,
        )
        if again.verdict is not Verdict.NOTHING_MISSING:
            return _found_aside(again)
    if searched is not None:
        searched(found)
    report("identifying the nominal parameters", 0.96)
    nominal, more = _nominal_constants(task, found)
    identified = effects_of(found, rng) if judged.verdict in IDENTIFIED else ()
    shown = _shown(task, found, nominal, judged, identified)
    judging = _judging(shown, {v.recording.name for v in trusting})
    left = _left(_with_own_starts(judging.main, found, trusting), found, trusting)
    if (doubt := _doubt(judging, judged, left)) is not None:
        where = judged.where or place_of(found, judged.maps)
        names = tuple(e.name for e in identified)
        why_not = Reason(doubt, found, names, left=left)
        judged = Judged(Verdict.OUTSIDE_CATALOGUE, where, judged.maps, why_not)
        if doubt is Kind.MUCH_LEFT:
            shown = shown._replace(effects=_part_of(identified))
        else:
            shown = _shown(task, found, nominal, judged, ())
    verdict, where, drawn, reason = judged
    unseen = collinear_effects(found.baseline, terms)
    every = (*here, *aside)
    crowds = () if verdict is Verdict.NOTHING_MISSING else crowded_recordings(shown.traces)
    return Diagnosis(
        verdict=verdict,
        statement=statement(
            verdict, shown.effects, shown.main, where, found.p_value, unseen, reason
        ),
        effects=shown.effects,
        fit=shown.main,
        fits=shown.fits,
        parameters=shown.after.model.parameters,
        parameter_shift=shifts_of(
            nominal, shown.constants, units_of([prepare(dataset.part("fit")[0], bandwidth)])
        ),
        p_value=found.p_value,
        location=where,
        curve=shown.after.model.curve,
        maps=drawn,
        steps=found.steps,
        traces=shown.traces,
        warnings=(
            *short,
            *resting,
            *warnings_of(dataset, here, [t for t in terms if t.name in unseen]),
            *why,
            *more,
            *shown.constants.warnings,
            *dropped_effects(found),
            *rests_under_torque(every, found.baseline.unit),
            *crowds,
            *_still_valve(found, every),
            *unexplained(found, verdict, reason, rng),
        ),
        seconds=perf_counter() - clock,
        alpha=shown.after.model.alpha,
        covariance=covariance_of(dataset, shown.after, shown.effects, bandwidth, shown.constants)
        if shown.effects
        else shown.constants.covariance,
        ranges=spanned([[*map(v.low_pass, (v.angle, v.velocity, v.moment))] for v in here]),
        model=shown.after.model,
    )


class _Shown(NamedTuple):
    """The reported model with its constants, errors and effects."""

    effects: tuple[IdentifiedEffect, ...]
    before: Scores
    after: Scores
    constants: Constants
    fits: tuple[Fit, ...]
    main: Fit
    traces: tuple[ResidualTrace, ...]


def _part_of(effects: Sequence[IdentifiedEffect]) -> tuple[IdentifiedEffect, ...]:
    """Return effects that are a part of a mismatch with a lower confidence: what else is missing
    may be what they imitate.
    """
    return _with_at_most(effects, RULES.part_confidence)


def _with_at_most(effects: Sequence[IdentifiedEffect], most: float) -> tuple[IdentifiedEffect, ...]:
    """Return effects and rivals with a bounded confidence."""
    return tuple(
        replace(
            e,
            confidence=min(e.confidence, most),
            rivals=tuple(replace(r, confidence=min(r.confidence, most)) for r in e.rivals),
        )
        for e in effects
    )


def _judging(shown: _Shown, names: Collection[str]) -> _Shown:
    """Return a reported model with the errors of the fitted recordings, and of those of the
    recordings set aside with these names.
    """
    before, after = (
        s._replace(parts=tuple(p for p in s.parts if p.role == "fit" or p.recording in names))
        for s in (shown.before, shown.after)
    )
    errors = [s.rms(shown.main.equation, "validate") for s in (before, after)]
    main = replace(shown.main, validate_baseline_rms=errors[0], validate_final_rms=errors[1])
    return shown._replace(before=before, after=after, main=main)


def _nominal_constants(task: _Task, found: Search) -> tuple[Constants, tuple[str, ...]]:
    """Return the constants of the nominal model, which are those of ``rig identify``, and warnings;
    without an estimator, or if it fails, those of the fit of the rows.
    """
    rows = constants_of(found.baseline)
    if task.estimate is None:
        return rows, ()
    try:
        identified = identified_constants(task.estimate(task.everything))
    except RecordingError as error:
        return rows, (f"not identified: {error}",)
    return identified, tuple(f"identification: {w}" for w in identified.warnings)


def _shown(
    task: _Task,
    found: Search,
    nominal: Constants,
    judged: Judged,
    effects: tuple[IdentifiedEffect, ...],
) -> _Shown:
    """Return the reported model: with the effects, or with the curve of a mismatch outside the
    catalogue, or the nominal model; its errors are computed last.
    """
    dataset, bandwidth = task.everything, task.bandwidth
    nominal = nominal._replace(warnings=())
    alpha, beside = dataset.model.alpha, unreported_constants(found.baseline)
    before, within = (
        scores(dataset, CorrectedModel({**values, **beside}, alpha), bandwidth)
        for values in (nominal.values, constants_of(found.baseline).values)
    )
    after, constants = before, nominal
    if effects:
        after, constants = reported(
            dataset, found.final, effects, bandwidth, nominal, task.estimate is not None, task.rng
        )
    elif judged.verdict is Verdict.OUTSIDE_CATALOGUE:
        drawn_curve = curve_of(dataset, before, judged.maps, bandwidth)
        if drawn_curve is not None:
            curved = scores(dataset, replace(before.model, curve=drawn_curve), bandwidth)
            unseen = [m.rms(drawn_curve.equation, "validate") for m in (curved, before)]
            if unseen[0] is None or unseen[1] is None or unseen[0] <= unseen[1]:
                after = curved
    final = found.final if effects else found.baseline
    place = judged.maps[0].equation if judged.maps else "torque"
    modelled = {e for n in after.model.effects for e in after.model.catalogue[n].exported}
    if effects and place not in modelled:
        place = next((e.name for e in found.baseline.equations if e.name in modelled), place)
    fits = fits_of(found.baseline, final, before, within, after, bandwidth, place)
    main = next((f for f in fits if f.equation == place), fits[0])
    traces = traces_of(found.baseline, before, after)
    return _Shown(effects, before, after, constants, fits, main, traces)


def _with_own_starts(main: Fit, found: Search, aside: Sequence[View]) -> Fit:
    """Return the errors with those of recordings set aside after a fit of their states at the
    start, if these states are unknown because the recordings have no common clock.
    """
    every = [v.recording for v in (*found.baseline.views, *aside)]
    starts = any(e.term.start for e in found.final.effects)
    if main.validate_final_rms is None or not starts or one_clock(every):
        return main
    fitted = validation_rms(found.final, aside).get(main.equation, main.validate_final_rms)
    return replace(main, validate_final_rms=min(main.validate_final_rms, fitted))


def _left(main: Fit, found: Search, aside: Sequence[View]) -> float:
    """Return :func:`floors_left`, at most that of one fit of the same model to all recordings.

    Recordings set aside may show what the fitted ones do not determine, such as the static friction
    of a slow motion: an error that other constants explain is no further physics.
    """
    left, final = floors_left(main), found.final
    if left <= RULES.floors_left or not aside or not final.effects:
        return left
    try:
        together = fit(_all_views(final, aside), final.unit, final.nominal, final.effects)
    except RecordingError:
        return left
    fitted, unseen = _errors_of(together, main.equation, len(final.views))
    best = replace(main, final_rms=fitted, validate_final_rms=unseen)
    return min(left, floors_left(best))


def _all_views(joint: Joint, aside: Sequence[View]) -> tuple[View, ...]:
    """Return the views of a fit and those set aside as further recordings of one fit."""
    count = len(joint.views)
    return (*joint.views, *(replace(v, index=count + k) for k, v in enumerate(aside)))


def _errors_of(joint: Joint, name: str, count: int) -> tuple[float, float]:
    """Return the rms error of an equation in the first ``count`` recordings and in the others."""
    part = next((e for e in joint.stack.equations if e.name == name), None)
    if part is None:
        return 0.0, 0.0
    rows = part.sigma * joint.residual[joint.stack.part(name)]
    other = part.owner >= count
    fitted, unseen = (
        float(np.sqrt(np.mean(rows[mine] ** 2))) if np.any(mine) else 0.0
        for mine in ((part.owner >= 0) & ~other, other)
    )
    return fitted, unseen


def _missing_aside(task: _Task, baseline: Joint, aside: Sequence[View]) -> bool:
    """Return whether recordings set aside show a mismatch that no constants explain, although the
    fitted ones do not.
    """
    name = "torque"
    sigma = next((e.sigma for e in baseline.equations if e.name == name), math.inf)
    most = RULES.floors * sigma
    if not aside or not validation_rms(baseline, aside).get(name, 0.0) > most:
        return False
    every, model = _all_views(baseline, aside), task.dataset.model
    try:
        together = fit_from_estimate(every, baseline.unit, baseline.nominal, model)
    except RecordingError:
        return False
    return _errors_of(together, name, len(baseline.views))[1] > most


def _all_fitted(dataset: Dataset, names: Collection[str]) -> Dataset:
    """Return a dataset in which the named recordings are fitted too, without others that were set
    aside: those cannot judge effects.
    """
    recordings = tuple(
        replace(r, role="fit") for r in dataset.recordings if r.role == "fit" or r.name in names
    )
    return replace(dataset, recordings=recordings)


def _found_aside(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis of recordings that were set aside first: no recording is left to test its
    names.
    """
    return replace(
        found,
        effects=_with_at_most(found.effects, RULES.undecided_confidence),
        warnings=(
            "the fitted recordings alone show no mismatch; those set aside do, and were fitted "
            "too, so that no recording is left to test the effects",
            *found.warnings,
        ),
    )


def _doubt(shown: _Shown, judged: Judged, left: float) -> Kind | None:
    """Return why the reported model contradicts its verdict, or None if it does not.

    *Nothing is missing* requires that the nominal model explains the torque, down to about the
    noise floor. Identified effects require that the corrected model does not increase the error, of
    unused recordings where there are some, and that it leaves little more than the noise.
    """
    if shown.effects:
        if grown(shown.after, shown.before, shown.main.equation):
            return Kind.NOT_BETTER
        # At instants the rows, less the rate of rise, have judged already.
        much = left > RULES.floors_left
        return Kind.MUCH_LEFT if much and shown.main.equation not in AT_INSTANTS else None
    if judged.verdict is not Verdict.NOTHING_MISSING:
        return None
    torque = next((f for f in shown.fits if f.equation == "torque"), None)
    if torque is not None and (torque.relative or 0.0) ** 2 > 1.0 - RULES.explained:
        return Kind.MISFIT
    hidden = judged.reason is not None and judged.reason.kind is Kind.BETWEEN_SAMPLES
    for each in shown.fits:
        if each.equation in AT_INSTANTS or (hidden and each.equation == "voltage"):
            continue
        least = min(each.baseline_rms, each.nominal_within_limits_rms or each.baseline_rms)
        if least > RULES.floors * each.noise_floor_rms:
            return Kind.MISFIT
    return None


class _Task(NamedTuple):
    """Inputs of one diagnosis: all recordings, the dataset that is searched, the fit of the nominal
    model, bandwidth, estimator of ``rig identify`` or None, random generator, and progress.
    """

    everything: Dataset
    dataset: Dataset
    first: Joint
    bandwidth: float
    estimate: Estimate | None
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
    found, judged = judge(searched, trusted(aside, every), terms, task.rng, task.report)
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
    found = validated_effects(searched, aside, terms)
    report("locating", 0.95)
    judged = verdict_of(found, rng, searched)
    if judged.verdict in IDENTIFIED:
        found = with_indistinct_effects(found, terms)
        judged = judged._replace(verdict=named_or_ambiguous(found))
    return found, judged


def observable_effects(
    dataset: Dataset,
    bandwidth_Hz: float | None = None,
    effects: Sequence[Effect | type[Effect]] = (),
) -> tuple[Observable, ...]:
    """Return which effects these recordings can show, at which size, and which effects they cannot
    distinguish.

    Args:
        dataset: Recordings; those with role ``validate`` are not used.
        bandwidth_Hz: Bandwidth of all errors, or None for the bandwidth that :func:`diagnose`
            chooses.
        effects: Effects of one's own, beside those of the catalogue.

    Raises:
        RecordingError: The recordings do not determine the nominal model.
        EffectError: An effect of one's own fails, or has the name of another effect.
    """
    dataset, bandwidth, _ = choose(dataset, bandwidth_Hz)
    here, nominal = views_and_fit(dataset, bandwidth)
    return observable(nominal, _effects_to_search(dataset, here, effects)[0])


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
    dataset: Dataset, here: Sequence[View], own: Sequence[Effect | type[Effect]]
) -> tuple[list[Effect], tuple[str, ...]]:
    """Return the effects to search for, and warnings that state why others are excluded."""
    excluded, why = unrecorded_effects(dataset.part("fit"), here)
    left_out = {*dataset.model.terms, *excluded}
    more = list(with_own(own).values())[len(EFFECTS) :]
    return [t for t in (*MOTION, *more) if t.name not in left_out], why


def as_exact(dataset: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """Return a dataset without priors and uncertainties, and warnings that state this."""
    constants = uncertain_constants(dataset.part("fit"))
    warnings = []
    if constants:
        listed = ", ".join(f"{c.place} {c.value:.4g} +- {c.uncertainty:.2g}" for c in constants)
        warnings.append(
            "the diagnosis takes known constants as exact: its intervals do not contain the "
            f"uncertainty of {listed}; the intervals of rig identify do"
        )
    if dataset.model.priors:
        warnings.append(
            f"the diagnosis does not use the priors of {', '.join(dataset.model.priors)}: it "
            "fits these parameters freely"
        )
    recordings = tuple(replace(r, uncertainties={}) for r in dataset.recordings)
    model = replace(dataset.model, priors={})
    return replace(dataset, recordings=recordings, model=model), tuple(warnings)
