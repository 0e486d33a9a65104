"""Verdict of a search: the identified effects, with their rivals and confidence."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from identification.diagnosis.comparison import Contender, Round, probability
from identification.diagnosis.joint import Joint, estimates, without_effect
from identification.diagnosis.linear import contribution
from identification.diagnosis.locate import best_map, location, maps
from identification.diagnosis.reasons import Excess, Kind, Reason, excess_of, reason_outside
from identification.diagnosis.removal import judging_equations
from identification.diagnosis.result import (
    Estimate,
    IdentifiedEffect,
    Location,
    Map,
    Rival,
    Verdict,
)
from identification.diagnosis.rows import Equation, between_samples
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Search
from identification.diagnosis.significance import greatest, over_own_noise
from identification.diagnosis.stack import Stack
from identification.diagnosis.statement import finding
from identification.model.parameters import parameter_unit
from identification.prepare import drive_channel
from identification.recording import Array
from identification.views.view import one_clock

FAINT_RATIO = 1.0 + (RULES.excess - 1.0) / (1.0 - RULES.faint_confidence)
"""Ratio of the mean-square mismatch to that of the noise, up to which a mismatch is faint. The part
of a faint mismatch that is attributed to noise (`excess`) may be due to an unidentified effect.
"""


VISIBLE = 3.0
"""Rms mismatch over the noise from which a diagnosis must find it (the limit of the proofs)."""


class Judged(NamedTuple):
    """Verdict of a search."""

    verdict: Verdict
    where: Location | None
    maps: tuple[Map, ...]
    # Reason why the effects of the catalogue do not explain the mismatch, or why the verdict is
    # *nothing missing* in spite of a mismatch; None otherwise.
    reason: Reason | None = None


def verdict_of(found: Search, rng: np.random.Generator, searched: Search | None = None) -> Judged:
    """Return the verdict, the location of the mismatch, and its maps.

    Args:
        found: The search with its fits within their limits and the accepted effects.
        rng: Random generator for the maps' confidence bands.
        searched: The search before effects were dropped, or None if no effect was dropped. The
            effects before and after dropping must explain enough of the mismatch.
    """
    stack = found.baseline.stack
    main = main_equation(found)
    rows = stack.part(main.name)
    before, after = (main.sigma * j.residual[rows] for j in (found.baseline, found.final))
    drawn = maps(stack, main, before, after, rng)
    where = location(main, drawn[0], before) if drawn else None
    if found.p_value > RULES.level:
        return Judged(Verdict.NOTHING_MISSING, None, drawn)
    least = RULES.tested_from if found.final.effects else RULES.excess
    # Effects that appear at instants alone are judged by the equation of these instants, which has
    # outliers: they must explain it.
    acting = {n for e in found.final.effects for n in judging_equations(found.final, e.term)}
    explained = [e.equation for e in excess_of(found) if e.explained >= RULES.adequate]
    own = acting & {*explained}
    if not _any_beyond_noise(found.baseline, least, own):
        return Judged(Verdict.NOTHING_MISSING, None, drawn)
    reason = reason_outside(found, searched or found)
    if reason is not None:
        return Judged(Verdict.OUTSIDE_CATALOGUE, where, drawn, reason)
    return Judged(named_or_ambiguous(found), where, drawn)


def place_of(found: Search, drawn: tuple[Map, ...]) -> Location | None:
    """Return the location of a mismatch by its maps; None without a map."""
    if not drawn:
        return None
    main = next(e for e in found.baseline.equations if e.name == drawn[0].equation)
    rows = found.baseline.stack.part(main.name)
    return location(main, drawn[0], main.sigma * found.baseline.residual[rows])


def named_or_ambiguous(found: Search) -> Verdict:
    """Return the verdict on effects that explain the mismatch, from their rivals."""
    open_rivals = any(_open_rivals(r) for r in found.rounds)
    return Verdict.AMBIGUOUS if open_rivals else Verdict.NAMED


def without_unlogged(judged: Judged, found: Search) -> Judged:
    """Return the verdict; a mismatch outside the catalogue that voltages and currents between the
    samples may cause has the verdict *nothing missing*.

    This function is called after all searches, so that it does not prevent a search.
    """
    if judged.verdict is not Verdict.OUTSIDE_CATALOGUE:
        return judged
    if _any_beyond_noise(found.baseline, RULES.excess, between=True):
        return judged
    return Judged(Verdict.NOTHING_MISSING, None, judged.maps, Reason(Kind.BETWEEN_SAMPLES, found))


def _any_beyond_noise(
    joint: Joint, least: float, own: Collection[str] = (), between: bool = False
) -> bool:
    """Whether the mismatch of the nominal model exceeds the noise in any equation that judges
    models.

    Args:
        joint: Fit of the nominal model.
        least: Ratio of the mean-square mismatch to that of the noise, from which it is beyond the
            noise.
        own: Names of further equations, by which an accepted effect is judged.
        between: Whether a mismatch that voltages and currents between the samples may cause counts
            as noise. A mismatch of at least :data:`VISIBLE` times the noise never counts as noise.
    """
    for equation in joint.equations:
        if not equation.judges and equation.name not in own:
            continue
        rows = over_own_noise(joint, equation)
        if between and equation.name == "voltage":
            hidden = (between_samples(equation.views) / equation.sigma) ** 2 / equation.allowed()
            rows = rows / np.sqrt(1.0 + np.minimum(hidden, VISIBLE**2 / RULES.excess - 1.0))
        if (
            equation.white
            or float(np.mean(rows**2)) > least
            or greatest(rows, equation) > RULES.excess_of_one
        ):
            return True
    return False


def main_equation(found: Search) -> Equation:
    """Return the equation whose mismatch, relative to the noise, the corrected model reduces most
    in each row; the torque equation if there is no reduction.

    The breakaway equation, which has few rows, is returned only if the effects reduce the mismatch
    of no other equation as much over all rows.
    """
    if found.p_value > RULES.level:
        return found.baseline.equations[0]
    # The breakaway equation judges no model, even if the pattern of its mismatch is significant.
    judges = [e for e in found.baseline.equations if e.judges]
    if found.final.effects:
        base = found.baseline
        return _most_reduced(base.equations, base.stack, base.residual, found.final.residual)
    loudest = found.loudest.split(" ")[0]
    named = [e for e in judges if e.name == loudest]
    left = {e.name: over_own_noise(found.baseline, e) for e in judges}
    return named[0] if named else max(judges, key=lambda e: np.sum(left[e.name] ** 2 - 1.0))


def _most_reduced(
    equations: Sequence[Equation], stack: Stack, before: Array, after: Array
) -> Equation:
    """Return the equation whose mismatch is reduced most in each row; the breakaway equation, which
    has few rows, only if its mismatch is reduced most over all rows.
    """

    def reduction(equation: Equation) -> float:
        rows = stack.part(equation.name)
        return float(np.sum(before[rows] ** 2) - np.sum(after[rows] ** 2))

    most = max(equations, key=reduction)
    if not most.judges:
        return most
    others = [e for e in equations if e.judges]
    return max(others, key=lambda e: reduction(e) / max(1, len(e.residual)))


def _open_rivals(taken: Round) -> tuple[str, ...]:
    """Return the rivals that are not rejected."""
    return tuple(r.name for r in taken.rivals if r.open)


def effects_of(found: Search, rng: np.random.Generator) -> tuple[IdentifiedEffect, ...]:
    """Return every accepted effect with its parameters, rivals and confidence, in the order of
    their selection.

    A rival that replaced an effect is the last effect of the fit, but takes the place of the
    replaced effect in the returned list.
    """
    sizes = estimates(found.final)
    places = {e.term.name: k for k, e in enumerate(found.final.effects)}
    excess = {e.equation: e for e in excess_of(found)}
    return tuple(
        _effect(found, places[r.name], sizes[places[r.name]], r, excess, rng)
        for r in found.rounds
        if r.name in places
    )


def _effect(
    found: Search,
    k: int,
    sizes: Mapping[str, Estimate],
    taken: Round,
    excess: Mapping[str, Excess],
    rng: np.random.Generator,
) -> IdentifiedEffect:
    entry = found.final.effects[k].term
    motion = found.baseline.views[0].recording.bench.motion
    amperes = found.baseline.unit == "A"
    units = {q.name: parameter_unit(motion, q.name, q.unit, amperes) for q in entry.parameters}
    parameters = {n: replace(e, unit=units.get(n, "")) for n, e in sizes.items()}
    stack = found.baseline.stack
    shown = [e for e in found.baseline.equations if e.name in found.final.effects[k].term.columns]
    own = max(shown, key=lambda e: excess[e.name].before * len(e.residual))
    rows = stack.part(own.name)
    where, over_speed = _location_of(found, k, shown, rng)
    open_names = _open_rivals(taken)
    quality = max(excess[own.name].explained, 1.0 if excess[own.name].after < RULES.excess else 0.0)
    alone = found.rounds[0].name == taken.name
    made = contribution(found.final.stack, found.final.effects[k])
    without = float(np.mean((found.final.residual + made)[rows] ** 2))
    needed = excess[own.name].before if alone else without
    incomplete = found.p_after <= RULES.level or little_unseen(found)
    confidence = confidence_of(taken, quality, incomplete, needed, alone)
    views = found.baseline.views
    # That each recording starts cold is then an assumption, which the set-aside error cannot test:
    # it fits the state at the start of a recording.
    assumed_cold = bool(entry.start) and not one_clock([v.recording for v in views])
    if over_speed or assumed_cold or not entry.shows_a_period(views):
        confidence = min(confidence, RULES.undecided_confidence)
    rivals = tuple(
        Rival(
            r.name,
            min(1.0 - probability(r.preference), RULES.implausible_confidence if r.beyond else 0.5),
            _why_not(r),
        )
        for r in taken.rivals
    )
    # What distinguishes effects of the catalogue may not do so for a candidate of one's own.
    # A rival that these recordings cannot distinguish was not fitted.
    fitted = (e.term for r in taken.rivals for e in r.joint.effects if e.term.name in open_names)
    asked = next((term for term in (entry, *fitted) if term.group == "own"), entry)
    return IdentifiedEffect(
        name=taken.name,
        alias_group=(taken.name, *open_names),
        confidence=confidence,
        statement=finding(
            entry, parameters, where.recordings, drive_channel(found.baseline.views[0].recording)
        ),
        assumption_broken=entry.assumption,
        where=where,
        parameters=parameters,
        rivals=rivals,
        separating_experiment=asked.experiment,
    )


def _location_of(
    found: Search, k: int, shown: Sequence[Equation], rng: np.random.Generator
) -> tuple[Location, bool]:
    """Return the location of effect ``k``, which has regressors in the equations ``shown``, and
    whether it is friction at a place that a function of speed or load explains as well: in some
    motions, such as one sine, place and speed are one thing.
    """
    effect, missing, left = found.final.effects[k], found.baseline.stack, found.baseline.residual
    if len(found.final.effects) > 1:
        missing = without_effect(found.final, k)
        left = missing.residual
    main = _most_reduced(shown, missing, left, found.final.residual)
    rows = missing.part(main.name)
    before, after = main.sigma * left[rows], main.sigma * found.final.residual[rows]
    stated = effect.term.coordinate.split(":")[0]
    drawn = maps(missing, main, before, after, rng, stated)
    where = location(main, best_map(drawn, stated), before)
    share = {m.coordinate: m.share for m in drawn}
    placed = any(m.coordinate == stated == "angle" and m.against_motion for m in drawn)
    as_well = max(share.get("speed", 0.0), share.get("load", 0.0)) >= RULES.alike * share.get(
        stated, 0.0
    )
    if effect.term.place is None:
        return where, placed and as_well
    index = round(effect.shape[effect.term.place])
    names = {v.index: v.recording.name for v in main.views}
    return replace(where, recordings=(names[index],)), False


def little_unseen(found: Search) -> bool:
    """Whether the effects explain less of the unseen mismatch than right ones would."""
    share = found.unseen_share
    return share is not None and share < RULES.nearly_complete


def confidence_of(
    taken: Round, quality: float, incomplete: bool, before: float, alone: bool = True
) -> float:
    """Return the confidence in an effect, from its rivals, the share of the mismatch that is
    explained, and whether further physics is missing.

    Args:
        taken: Selection round of the effect, with its rivals.
        quality: Share of the mismatch beyond the noise that is explained in the main equation of
            the effect.
        incomplete: Whether further physics is missing.
        before: Mean-square mismatch of this equation without the effect, relative to that of the
            noise.
        alone: Whether the effect was selected first. For a later effect, a faint mismatch may be
            due to an error of the regressors of the earlier effects.
    """
    over = [
        max(probability(r.preference), 1.0 - RULES.implausible_confidence if r.beyond else 0.0)
        for r in taken.rivals
    ]
    most = (
        RULES.incomplete_confidence
        if incomplete or (before < FAINT_RATIO and not alone)
        else RULES.faint_confidence
        if before < FAINT_RATIO
        else RULES.greatest_confidence
    )
    if taken.unconfirmed:
        most = min(most, RULES.undecided_confidence)
    return min(most, min([RULES.greatest_confidence, *over]) * (0.5 + 0.5 * quality))


def _why_not(rival: Contender) -> str:
    """Return the reason why a rival is rejected; empty if the rival is not rejected."""
    if rival.preference >= RULES.rejected:
        return f"the error with this rival is larger by {rival.preference:.1f} standard errors"
    return f"this rival fits as well, but only with {rival.beyond}" if rival.beyond else ""
