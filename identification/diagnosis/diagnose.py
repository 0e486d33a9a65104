"""From recordings to a verdict: noise floor, is anything missing, where, which physics, the corrected model, the proof.

Recordings set aside (role ``validate``) are touched once, at the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from identification.diagnosis.begin import NEAR_FLOOR, begun, common_bandwidth, started
from identification.diagnosis.contest import Contender, Round, probability
from identification.diagnosis.entries import ENTRIES
from identification.diagnosis.equations import Equation, equations
from identification.diagnosis.generic import LINEAR_UNITS
from identification.diagnosis.joint import Joint, estimates, pinned
from identification.diagnosis.locate import curve, location, maps, placed
from identification.diagnosis.result import (
    Diagnosis,
    Effect,
    Estimate,
    Fit,
    Location,
    Map,
    ResidualTrace,
    Rival,
    Shift,
    Verdict,
)
from identification.diagnosis.search import LEVEL, Progress, Search, search
from identification.diagnosis.stack import stacked
from identification.diagnosis.stretches import crowded, standing
from identification.diagnosis.taken_up import taken_up
from identification.diagnosis.terms import TERMS
from identification.diagnosis.terms.transmission import on_the_joint
from identification.diagnosis.unsought import unsought
from identification.diagnosis.view import View, views
from identification.diagnosis.wording import finding, title
from identification.estimate.assemble import units_of
from identification.prepare import prepare, torque_unit
from identification.recording import Bench, Dataset, RecordingError

GIVING = ("backlash", "compliance", "coupling_hysteresis", "gear_mesh_ripple")
"""Effects by which the valve moves otherwise than the motor, so that its friction follows the joint encoder."""
TURNING = ("cogging", "torque_ripple", "gear_mesh_ripple", "encoder_eccentricity", "gravity_imbalance")
"""Effects over an angle, of which a linear bench without a gear ratio (rad/m) says nothing."""
REJECTED = 1.645
"""Standard errors by which a rival must lose to be told from the effect named (5 %, one-sided)."""
ADEQUATE = 0.70
"""Share of the mismatch's power beyond the noise that names must explain between them to be a diagnosis."""
SUREST = 0.99
"""Most confidence in any name."""
UNFINISHED = 0.8
"""Most confidence in a name beside which the test says that more is missing: of 16 such blind rigs (seed 20280301) 13
had a right name first."""
FAINT, FAINT_MOST = 3.5, 0.9
"""Mean square of a mismatch over the noise's up to which a name gets no more confidence than that: a fifth of it may be
something else and still pass for noise (:data:`identification.diagnosis.kept.EXCESS`)."""
UNLIKELY = 0.05
"""Confidence in a rival that fits as well, with a parameter beyond what is plausible."""


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
        dataset: Recordings; those with role ``validate`` are scored once, at the end.
        bandwidth_Hz: Of every error; None chooses the least over the recordings of what each bears.
        rng: Of the tests by sign flips.
        progress: Called with what is being done and the share done.
        onlooker: Shown the nominal model's fit before anything is sought, for other methods on the same rows.

    Raises:
        RecordingError: The recordings cannot pin the nominal model, or a declared term cannot be granted.
    """
    clock = perf_counter()
    tell: Progress = progress or (lambda _stage, _share: None)
    chance = rng or np.random.default_rng(0)
    fitted, held = dataset.part("fit"), dataset.part("validate")
    if not fitted:
        raise RecordingError("no recording with role fit")
    bandwidth = bandwidth_Hz or common_bandwidth(fitted)
    tell("nominal model", 0.0)
    unit = torque_unit(fitted[0])
    here, first = begun(dataset, bandwidth)
    hidden, why = unsought(fitted, here)
    left_out = {*dataset.model.terms, *(TURNING if _slides(fitted[0].bench) else ()), *hidden}
    terms = [t for t in TERMS if t.name not in left_out]
    if onlooker is not None:
        onlooker(first)
    found = search(here, unit, first, terms, chance, tell, GIVING, dataset.model.fixed)
    gives = any(e.term.name in GIVING for e in found.final.effects)
    if gives:
        tell("the same on the valve's side", 0.0)
        here = views(fitted, bandwidth, True, dataset.recordings)
        again = started(here, unit, first.nominal, dataset.model)
        found = search(here, unit, again, on_the_joint(terms), chance, tell, fixed=dataset.model.fixed)
    baseline = found.baseline
    aside = views((*fitted, *held), bandwidth, gives, dataset.recordings)[len(fitted) :]
    tell("locating", 0.95)
    verdict, where, drawn = _judged(found, chance)
    effects = _effects(found, verdict) if verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) else ()
    scored = found.final if effects else baseline
    fits = _fits(found.baseline, scored, aside, unit, bandwidth)
    main = next((f for f in fits if drawn and f.equation == drawn[0].equation), fits[0])
    units = units_of([prepare(fitted[0], bandwidth)])
    unseen = taken_up(baseline, terms)
    traces = _traces(found.baseline, scored)
    alarm = verdict is not Verdict.NOTHING_MISSING
    places = (*standing((*here, *aside), unit), *(crowded(traces) if alarm else ()), *_too_little(found, verdict))
    return Diagnosis(
        verdict=verdict,
        statement=_statement(verdict, effects, main, where, found.p_value, unseen),
        effects=effects,
        fit=main,
        fits=fits,
        parameters=dict(scored.nominal.values),
        parameter_shift={
            name: Shift(
                float(value) if pinned(baseline, name) else None,
                float(scored.nominal.values[name]) if pinned(scored, name) else None,
                units[name],
            )
            for name, value in baseline.nominal.values.items()
        },
        p_value=found.p_value,
        location=where,
        curve=curve(drawn) if verdict is Verdict.OUTSIDE_CATALOGUE else None,
        maps=drawn,
        steps=found.steps,
        traces=traces,
        warnings=(*_warnings(dataset, here, unseen), *why, *places),
        seconds=perf_counter() - clock,
        alpha=dataset.model.alpha,
    )


def _slides(bench: Bench) -> bool:
    """Whether a linear bench is described without the motor that turns behind it."""
    return bench.motion == "linear" and bench.gear_ratio == 1.0


@dataclass(frozen=True)
class _Excess:
    """Power of an equation's whitened mismatch before and after, over its rows."""

    equation: str
    before: float
    after: float

    @property
    def explained(self) -> float:
        """Share of what is beyond the noise that is explained."""
        beyond = max(self.before - 1.0, 1e-12)
        return min(1.0, max(0.0, (self.before - max(self.after, 1.0)) / beyond))


def _excess(found: Search) -> list[_Excess]:
    stack = found.baseline.stack
    out = []
    for equation in found.baseline.equations:
        rows = stack.part(equation.name)
        before, after = (float(np.mean(j.residual[rows] ** 2)) for j in (found.baseline, found.final))
        out.append(_Excess(equation.name, before, after))
    return out


def _judged(found: Search, rng: np.random.Generator) -> tuple[Verdict, Location | None, tuple[Map, ...]]:
    """Return the verdict, where the mismatch is, and its maps."""
    stack = found.baseline.stack
    main = _main_equation(found)
    rows = stack.part(main.name)
    before, after = (main.sigma * j.residual[rows] for j in (found.baseline, found.final))
    drawn = maps(stack, main, before, after, rng)
    where = location(main, drawn[0], before) if drawn else None
    if found.p_value > LEVEL:
        return Verdict.NOTHING_MISSING, None, drawn
    # A breakaway is one number for a rest, and its noise that of an instant within a sample: it judges no model.
    judges = [e for e in _excess(found) if e.equation != "breakaway"]
    worst = max(judges, key=lambda e: e.before * _rows(found, e.equation))
    if not found.final.effects or (worst.explained < ADEQUATE and worst.after > NEAR_FLOOR):
        return Verdict.OUTSIDE_CATALOGUE, where, drawn
    open_rivals = any(_open(r) for r in found.rounds)
    return (Verdict.AMBIGUOUS if open_rivals else Verdict.NAMED), where, drawn


def _too_little(found: Search, verdict: Verdict) -> tuple[str, ...]:
    """Say what effects of the catalogue explain a part of a mismatch that has no name."""
    if verdict is not Verdict.OUTSIDE_CATALOGUE or not found.final.effects:
        return ()
    share = next(e.explained for e in _excess(found) if e.equation == _main_equation(found).name)
    words = "; and ".join(e.statement for e in _effects(found, verdict))
    return (f"{100.0 * share:.0f} % of what is beyond the noise, too little for a name, would be explained if {words}",)


def _rows(found: Search, equation: str) -> int:
    rows = found.baseline.stack.part(equation)
    return int(rows.stop - rows.start)


def _main_equation(found: Search) -> Equation:
    """Return the equation whose mismatch the final model takes away most of; the torque's where there is none."""
    if found.p_value > LEVEL:
        return found.baseline.equations[0]
    stack = found.baseline.stack

    def taken(equation: Equation) -> float:
        rows = stack.part(equation.name)
        return float(np.sum(found.baseline.residual[rows] ** 2) - np.sum(found.final.residual[rows] ** 2))

    if found.final.effects:
        return max(found.baseline.equations, key=taken)
    loudest = found.loudest.split(" ")[0]
    named = [e for e in found.baseline.equations if e.name == loudest]
    return named[0] if named else found.baseline.equations[0]


def _open(taken: Round) -> tuple[str, ...]:
    """Return rivals that the data cannot reject."""
    return tuple(r.name for r in taken.rivals if r.preference < REJECTED)


def _effects(found: Search, verdict: Verdict) -> tuple[Effect, ...]:
    sizes = estimates(found.final)
    rounds = {r.name: r for r in found.rounds}
    excess = {e.equation: e for e in _excess(found)}
    return tuple(
        _effect(found, k, added.term.name, sizes[k], rounds[added.term.name], excess)
        for k, added in enumerate(found.final.effects)
    )


def own_bench(found: Search) -> Bench:
    """Return the bench that was diagnosed."""
    return found.baseline.equations[0].views[0].recording.bench


def _effect(
    found: Search,
    k: int,
    name: str,
    sizes: Mapping[str, Estimate],
    taken: Round,
    excess: Mapping[str, _Excess],
) -> Effect:
    entry = ENTRIES[name]
    linear, amperes = own_bench(found).motion == "linear", found.baseline.equations[0].unit == "A"
    units = {q.name: LINEAR_UNITS.get(q.unit, q.unit) if linear else q.unit for q in entry.parameters}
    if amperes:
        units = {n: unit.replace("N m", "A") for n, unit in units.items()}
    parameters = {n: replace(e, unit=units.get(n, "")) for n, e in sizes.items()}
    stack = found.baseline.stack
    own = max(
        (e for e in found.baseline.equations if e.name in found.final.effects[k].term.columns),
        key=lambda e: excess[e.name].before * len(e.residual),
    )
    rows = stack.part(own.name)
    before, after = (own.sigma * j.residual[rows] for j in (found.baseline, found.final))
    drawn = maps(stack, own, before, after, np.random.default_rng(0))
    where = location(own, placed(drawn, entry.coordinate.split(":")[0]), before)
    place = found.final.effects[k].term.place
    if place is not None:
        index = round(found.final.effects[k].shape[place])
        where = replace(where, recordings=(own.views[[v.index for v in own.views].index(index)].recording.name,))
    open_names = _open(taken)
    quality = max(excess[own.name].explained, 1.0 if excess[own.name].after < NEAR_FLOOR else 0.0)
    confidence = confidence_of(taken, quality, found.p_after, excess[own.name].before)
    rivals = tuple(
        Rival(
            r.name,
            min(1.0 - probability(r.preference), UNLIKELY if r.beyond else 0.5),
            _why_not(r),
        )
        for r in taken.rivals
    )
    return Effect(
        name=name,
        alias_group=(name, *open_names),
        confidence=confidence,
        statement=finding(entry, parameters, where.recordings),
        assumption_broken=entry.assumption,
        where=where,
        parameters=parameters,
        rivals=rivals,
        separating_experiment=entry.experiment,
    )


def confidence_of(taken: Round, quality: float, p_after: float, before: float) -> float:
    """Return the confidence in a name: over its rivals, by how much it explains, and whether more is missing after all.

    Args:
        taken: With its rivals.
        quality: Share of the mismatch beyond the noise that is explained in its main equation.
        p_after: Of the test that anything more is missing.
        before: Mean square of that equation's mismatch over the noise's without any name.
    """
    over = [max(probability(r.preference), 1.0 - UNLIKELY if r.beyond else 0.0) for r in taken.rivals]
    most = UNFINISHED if p_after <= LEVEL else FAINT_MOST if before < FAINT else SUREST
    return min(most, min([SUREST, *over]) * (0.5 + 0.5 * quality))


def _why_not(rival: Contender) -> str:
    """Say why a rival was not taken; empty where it might as well have been."""
    if rival.preference >= REJECTED:
        return f"its error is larger by {rival.preference:.1f} standard errors"
    return f"it fits as well, but only with {rival.beyond}" if rival.beyond else ""


def _fits(baseline: Joint, final: Joint, aside: Sequence[View], unit: str, bandwidth: float) -> tuple[Fit, ...]:
    held_before, held_after = held_out(baseline, aside, unit), held_out(final, aside, unit)
    out = []
    for equation in baseline.equations:
        rows = baseline.stack.part(equation.name)
        rms = [equation.sigma * math.sqrt(float(np.mean(j.residual[rows] ** 2))) for j in (baseline, final)]
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


def held_out(joint: Joint, aside: Sequence[View], unit: str) -> dict[str, float]:
    """Return each equation's rms over recordings that took no part, nothing of the torque's model fitted to them."""
    if not aside:
        return {}
    rows = equations(aside, joint.nominal, unit)
    if not rows:  # hardly a sample of them is in steady motion
        return {}
    stack = stacked(rows, joint.nominal)
    # What a recording alone shows cannot be told of another one: a mislabelled weight, a slip.
    general = [e for e in joint.effects if e.term.place is None]
    out = {}
    for equation in rows:
        rest = equation.residual.copy()
        for effect in general:
            columns = stack.columns(effect.term, effect.shape).get(equation.name)
            if columns is not None:
                rest -= columns @ np.array(effect.coefficients)
        if equation.name != "torque":
            scale = np.linalg.norm(equation.tangent, axis=0)
            basis, _ = np.linalg.qr(equation.tangent / np.where(scale > 0.0, scale, 1.0))
            rest -= basis @ (basis.T @ rest)
        out[equation.name] = float(np.sqrt(np.mean(rest**2)))
    return out


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
    error = f"{main.equation} error {main.baseline_rms:.3g} {main.unit}; noise floor {main.noise_floor_rms:.3g}"
    if verdict is Verdict.NOTHING_MISSING:
        said = f"nothing is missing that these recordings could show (p = {p_value:.2g}); {error}"
        return f"{said}; {_unseen(unseen)}" if unseen else said
    held = main.validate_baseline_rms is not None and main.validate_final_rms is not None
    before, after = (
        (main.validate_baseline_rms, main.validate_final_rms) if held else (main.baseline_rms, main.final_rms)
    )
    recordings = "unseen recordings" if held else "the recordings it was fitted to"
    change = (
        f"{main.equation.capitalize()} error on {recordings} {before:.3g} -> {after:.3g} {main.unit}; "
        f"noise floor {main.noise_floor_rms:.3g}."
    )
    if verdict is Verdict.OUTSIDE_CATALOGUE:
        place = f", most of it over {where.coordinate}" if where else ""
        return f"something is missing that is in no catalogue{place}; {error}"
    words = "; and ".join(e.statement for e in effects)
    if verdict is Verdict.AMBIGUOUS:
        groups = [" or ".join(title(n) for n in e.alias_group) for e in effects if len(e.alias_group) > 1]
        words = f"{words}. These recordings cannot tell {' and '.join(groups)} apart"
    return f"{words}. {change}"


def _unseen(names: Sequence[str]) -> str:
    return f"the nominal constants would take up {', '.join(title(n) for n in names)} whole, and none of it be seen"


def _warnings(dataset: Dataset, here: Sequence[View], unseen: Sequence[str]) -> tuple[str, ...]:
    warnings = []
    if unseen:
        warnings.append(f"{_unseen(unseen)}; what would show it: {' '.join(ENTRIES[n].experiment for n in unseen)}")
    if not dataset.part("validate"):
        warnings.append("no recording is set aside (role: validate), so the errors are of the fit itself")
    for view in here:
        if not np.any(view.moving):
            warnings.append(f"{view.recording.name}: no sample in steady motion; it says nothing of the torque")
    return tuple(warnings)
