"""From recordings to a verdict: noise floor, is anything missing, where, which physics, the
corrected model, the proof.

Recordings set aside (role ``validate``) take no part in any fit. At the end they decide which names
are kept, and are scored.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from time import perf_counter

import numpy as np

from identification.diagnosis.catalogue import ENTRIES
from identification.diagnosis.catalogue.entry import title
from identification.diagnosis.fit.intervals import pinned
from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.start import bandwidth_of, begun, started
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
from identification.diagnosis.score.collinear import taken_up
from identification.diagnosis.score.locate import curve
from identification.diagnosis.score.observable import Observable, observable
from identification.diagnosis.score.significance import LEVEL
from identification.diagnosis.score.single_recordings import crowded, standing
from identification.diagnosis.selection.held_out import held_out, paying, unpaid
from identification.diagnosis.selection.indistinct import opened
from identification.diagnosis.selection.search import Progress, Search, search
from identification.diagnosis.terms import TERMS
from identification.diagnosis.terms.term import Term
from identification.diagnosis.terms.transmission import on_the_joint
from identification.diagnosis.verdict.judgement import effects_of, judged, too_little
from identification.diagnosis.verdict.unrecorded import unsought
from identification.estimate.uncertainty.parameter_table import units_of
from identification.prepare import prepare, torque_unit
from identification.recording import Bench, Dataset, Recording, RecordingError

GIVING = ("backlash", "compliance", "coupling_hysteresis", "gear_mesh_ripple")
"""Effects by which the valve moves otherwise than the motor, so that its friction follows the joint
encoder.
"""
TURNING = (
    "cogging",
    "torque_ripple",
    "gear_mesh_ripple",
    "encoder_eccentricity",
    "gravity_imbalance",
)
"""Effects over an angle, of which a linear bench without a gear ratio (rad/m) says nothing."""


def diagnose(
    dataset: Dataset,
    *,
    bandwidth_Hz: float | None = None,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
    onlooker: Callable[[Joint], None] | None = None,
) -> Diagnosis:
    """Say whether physics is missing from the nominal model of these recordings, where, and which.

    Args:
        dataset: Recordings; those with role ``validate`` take no part in any fit.
        bandwidth_Hz: Of every error; None chooses the least over the recordings of what each bears.
        rng: Of the tests by sign flips.
        progress: Called with what is being done and the share done.
        onlooker: Shown the nominal model's fit before anything is sought.

    Raises:
        RecordingError: The recordings cannot pin the nominal model or bear a declared term.
    """
    clock = perf_counter()
    tell: Progress = progress or (lambda _stage, _share: None)
    tell("nominal model", 0.0)
    chance = rng or np.random.default_rng(0)
    fitted, bandwidth = _fitted(dataset, bandwidth_Hz)
    unit = torque_unit(fitted[0])
    here, first = begun(dataset, bandwidth)
    terms, why = _sought(dataset, here)
    if onlooker is not None:
        onlooker(first)
    here, found, gives = _searched(dataset, (here, first), terms, bandwidth, chance, tell)
    aside = _aside(dataset, bandwidth, gives)
    tell("what each name is worth on recordings that took no part", 0.92)
    searched, found = found, opened(paying(found, here, aside, unit), terms)
    tell("locating", 0.95)
    verdict, where, drawn = judged(found, chance, searched)
    effects = effects_of(found, chance) if verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) else ()
    scored = found.final if effects else found.baseline
    fits = _fits(found.baseline, scored, aside, unit, bandwidth)
    main = next((f for f in fits if drawn and f.equation == drawn[0].equation), fits[0])
    unseen, traces = taken_up(found.baseline, terms), _traces(found.baseline, scored)
    places = (*_places(verdict, traces, (*here, *aside)), *too_little(found, verdict, chance))
    return Diagnosis(
        verdict=verdict,
        statement=_statement(verdict, effects, main, where, found.p_value, unseen),
        effects=effects,
        fit=main,
        fits=fits,
        parameters=dict(scored.nominal.values),
        parameter_shift=_shifts(found, scored, units_of([prepare(fitted[0], bandwidth)])),
        p_value=found.p_value,
        location=where,
        curve=curve(drawn) if verdict is Verdict.OUTSIDE_CATALOGUE else None,
        maps=drawn,
        steps=found.steps,
        traces=traces,
        warnings=(*_warnings(dataset, here, unseen), *why, *unpaid(found), *places),
        seconds=perf_counter() - clock,
        alpha=dataset.model.alpha,
    )


def observed(dataset: Dataset, bandwidth_Hz: float | None = None) -> tuple[Observable, ...]:
    """Say which effects these recordings can show, at which size, and which they cannot
    distinguish.

    Args:
        dataset: Recordings; those with role ``validate`` take no part.
        bandwidth_Hz: Of every error; None chooses it as :func:`diagnose` does.

    Raises:
        RecordingError: The recordings do not determine the nominal model.
    """
    here, nominal = begun(dataset, _fitted(dataset, bandwidth_Hz)[1])
    return observable(nominal, _sought(dataset, here)[0])


def _places(
    verdict: Verdict, traces: Sequence[ResidualTrace], every: Sequence[View]
) -> tuple[str, ...]:
    """Return where recordings stand under a torque, and where the mismatch is crowded."""
    crowds = crowded(traces) if verdict is not Verdict.NOTHING_MISSING else ()
    return (*standing(every, torque_unit(every[0].recording)), *crowds)


def _fitted(dataset: Dataset, bandwidth_Hz: float | None) -> tuple[tuple[Recording, ...], float]:
    """Return the recordings to fit, and the bandwidth of every error, Hz.

    Raises:
        RecordingError: There are none.
    """
    fitted = dataset.part("fit")
    if not fitted:
        raise RecordingError("no recording with role fit")
    return fitted, bandwidth_Hz or bandwidth_of(fitted)


def _searched(
    dataset: Dataset,
    begun_at: tuple[tuple[View, ...], Joint],
    terms: Sequence[Term],
    bandwidth: float,
    rng: np.random.Generator,
    tell: Progress,
) -> tuple[tuple[View, ...], Search, bool]:
    """Search the effects, and once more on the valve's side where the transmission is found to
    give; return the recordings as searched last, how the search ended, and whether it gives.

    Args:
        dataset: What is diagnosed.
        begun_at: Its recordings and the nominal model's fit of them.
        terms: Effects to choose from.
        bandwidth: Of every error, Hz.
        rng: Of the tests by sign flips.
        tell: Told what is being done.
    """
    (here, first), fitted, fixed = begun_at, dataset.part("fit"), dataset.model.fixed
    unit = torque_unit(fitted[0])
    found = search(here, unit, first, terms, rng, tell, GIVING, fixed)
    if not any(e.term.name in GIVING for e in found.final.effects):
        return here, found, False
    tell("the same on the valve's side", 0.0)
    here = views(fitted, bandwidth, True, dataset.recordings)
    again = started(here, unit, first.nominal, dataset.model)
    return here, search(here, unit, again, on_the_joint(terms), rng, tell, fixed=fixed), True


def _sought(dataset: Dataset, here: Sequence[View]) -> tuple[list[Term], tuple[str, ...]]:
    """Return the effects that are sought, and why others are not."""
    fitted = dataset.part("fit")
    hidden, why = unsought(fitted, here)
    left_out = {*dataset.model.terms, *(TURNING if _slides(fitted[0].bench) else ()), *hidden}
    return [t for t in TERMS if t.name not in left_out], why


def _aside(dataset: Dataset, bandwidth: float, gives: bool) -> tuple[View, ...]:
    """Return the recordings that took no part."""
    fitted, held = dataset.part("fit"), dataset.part("validate")
    return views((*fitted, *held), bandwidth, gives, dataset.recordings)[len(fitted) :]


def _slides(bench: Bench) -> bool:
    """Whether a linear bench is described without the motor that turns behind it."""
    return bench.motion == "linear" and bench.gear_ratio == 1.0


def _shifts(found: Search, final: Joint, units: Mapping[str, str]) -> dict[str, Shift]:
    """Return each nominal parameter before and after, as far as the recordings pin it."""

    def value(joint: Joint, name: str) -> float | None:
        return float(joint.nominal.values[name]) if pinned(joint, name) else None

    return {
        name: Shift(value(found.baseline, name), value(final, name), units[name])
        for name in found.baseline.nominal.values
    }


def _fits(
    baseline: Joint, final: Joint, aside: Sequence[View], unit: str, bandwidth: float
) -> tuple[Fit, ...]:
    held_before, held_after = held_out(baseline, aside, unit), held_out(final, aside, unit)
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
        told = f"p = {p_value:.2g}" if p_value > LEVEL else "the mismatch is within the noise"
        said = f"nothing is missing that these recordings could show ({told}); {error}"
        return f"{said}; {_unseen(unseen)}" if unseen else said
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
        return f"something is missing that is in no catalogue{place}; {error}"
    words = "; and ".join(e.statement for e in effects)
    if verdict is Verdict.AMBIGUOUS:
        groups = [
            " or ".join(title(n) for n in e.alias_group) for e in effects if len(e.alias_group) > 1
        ]
        words = f"{words}. These recordings cannot distinguish {' and '.join(groups)}"
    return f"{words}. {change}"


def _unseen(names: Sequence[str]) -> str:
    return (
        f"these recordings cannot show {', '.join(title(n) for n in names)}, which the nominal "
        f"parameters can explain completely"
    )


def _warnings(dataset: Dataset, here: Sequence[View], unseen: Sequence[str]) -> tuple[str, ...]:
    warnings = []
    if unseen:
        warnings.append(
            f"{_unseen(unseen)}; an experiment that shows it: "
            f"{' '.join(ENTRIES[n].experiment for n in unseen)}"
        )
    if not dataset.part("validate"):
        warnings.append(
            "no recording is set aside (role: validate), so the errors are of the fit itself"
        )
    for view in here:
        if not np.any(view.moving):
            warnings.append(
                f"{view.recording.name}: no sample in steady motion; it says nothing of the torque"
            )
    return tuple(warnings)
