"""Tests whether an effect reduces the error on recordings that were not used in its fit.

If recordings are set aside, the error is that of their prediction. Otherwise each part of the
recordings is predicted from a fit to all other parts, with nonlinear parameters and Stribeck speeds
fixed (cross-validation: Stone, Journal of the Royal Statistical Society B 36 (1974) 111).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from identification.diagnosis.fit.intervals import undetermined_size
from identification.diagnosis.fit.joint import Joint, fit
from identification.diagnosis.fit.linear import Added
from identification.diagnosis.fit.stack import Stack
from identification.diagnosis.fit.within_limits import (
    cross_validation_residual,
    parameter_derivatives,
    within_limits,
)
from identification.diagnosis.result import Step
from identification.diagnosis.rules import RULES
from identification.diagnosis.selection.comparison import (
    Contender,
    Round,
    implausible,
    preference,
)
from identification.diagnosis.selection.crossing import distinguished_by_crossings
from identification.diagnosis.selection.removal import judging_equations
from identification.diagnosis.selection.search import Search
from identification.diagnosis.selection.unseen import (
    decisive_reduction,
    explained_share,
    judged_rows,
    reduction,
    validation_residual,
)
from identification.effects import EFFECTS
from identification.effects.effect import title
from identification.recording import Array
from identification.views.view import View

DROPPED = "drop"
"""Name of a step that drops an effect because the effect does not reduce the error on unused
recordings, or because the recordings do not determine its size.
"""


def validated_effects(
    found: Search, here: Sequence[View], aside: Sequence[View], unit: str
) -> Search:
    """Return a search with fits within their limits, and without effects that do not reduce the
    error on unused recordings significantly.

    Of the effects that fail this test, the effect that reduces the error least is dropped first,
    and the other effects are fitted again. The first rival of a dropped effect that reduces the
    error significantly replaces the dropped effect. Then, if several effects remain, every effect
    except the one that was selected first is dropped if the interval of its size contains zero.
    Finally, the errors on recordings set aside decide between each remaining effect and its rivals.

    Args:
        found: The search.
        here: Recordings that were fitted.
        aside: Recordings that are set aside.
        unit: Unit of the torque.
    """
    baseline = within_limits(here, unit, found.baseline)
    case = _Case(here, aside, unit, baseline)
    joint = within_limits(here, unit, found.final)
    rounds, steps = {r.name: r for r in found.rounds}, list(found.steps)
    while True:
        trials = [
            (_error_reduction(case, joint, without, effect), effect.term.name, without)
            for effect in joint.effects
            if effect.term.place is None
            for without in [_fit_without(case, joint, effect)]
        ]
        worth, name, without = min(trials, key=lambda t: t[0], default=(math.inf, "", baseline))
        if worth >= RULES.rejected:
            dropped = _without_undetermined(case, joint, rounds, steps)
            if dropped is None:
                break
            joint = dropped
            continue
        steps.append(_step(DROPPED, name, without.cost - joint.cost, worth, case))
        joint, taken = without, rounds.pop(name, None)
        if taken is not None:
            joint = _with_replacing_rival(case, joint, taken, rounds, steps)
    judged = []
    for kept in rounds.values():
        joint, now = _with_rivals_judged(case, joint, kept, steps)
        judged.append(now)
    return replace(
        found,
        baseline=baseline,
        final=joint,
        rounds=tuple(judged),
        steps=tuple(steps),
        unseen_share=_unseen_share(case, joint),
    )


def _with_replacing_rival(
    case: _Case, joint: Joint, taken: Round, rounds: dict[str, Round], steps: list[Step]
) -> Joint:
    """Return the fit with the first rival of a dropped effect that reduces the error significantly,
    or the fit without the dropped effect if there is no such rival. The selection round of the
    rival and a step are added.
    """
    for rival in taken.rivals:
        tried = _fit_with_rival(case, joint, rival)
        if tried is None:
            continue
        # An effect that occurs in one recording only cannot be tested on other recordings.
        alone = tried.effects[-1].term.place is not None
        worth = math.inf if alone else _error_reduction(case, tried, joint, tried.effects[-1])
        if worth >= RULES.rejected:
            steps.append(_step("swap", rival.name, joint.cost - tried.cost, worth, case, alone))
            rounds[rival.name] = Round(rival.name, ())
            return tried
    return joint


def _without_undetermined(
    case: _Case, joint: Joint, rounds: dict[str, Round], steps: list[Step]
) -> Joint | None:
    """Return the fit without an effect whose size has an interval that contains zero, or None if
    there is no such effect.

    The effect that was selected first is kept. The selection round of the dropped effect is
    removed, and a step is added.
    """
    for k, effect in enumerate(joint.effects):
        name = effect.term.name
        first = name == next(iter(rounds), name)
        found = None if first else undetermined_size(joint, k)
        if found is None:
            continue
        parameter, size = found
        without = _fit_without(case, joint, effect)
        note = f"the 90 % interval of {parameter}, {size.low:.3g} to {size.high:.3g}, contains zero"
        steps.append(Step(DROPPED, name, None, without.cost - joint.cost, note))
        rounds.pop(name, None)
        return without
    return None


def _unseen_share(case: _Case, joint: Joint) -> float | None:
    """Return the share of the mismatch beyond the noise on recordings set aside that all effects
    together explain, in the equations by which the effects are judged. The result is None if there
    is no such mismatch, or if a parameter of an effect is unknown in recordings set aside, such as
    a phase that differs between recordings.
    """
    names = {name for e in joint.effects for name in judging_equations(joint, e.term)}
    before, after = (
        validation_residual(j, case.aside, case.unit, starts) if case.aside else None
        for j, starts in ((case.baseline, joint.effects), (joint, ()))
    )
    if before is None or after is None:
        return None
    for effect in joint.effects:
        columns = after[0].columns(effect.term, effect.shape).values()
        if effect.term.place is None and not any(np.any(c) for c in columns):
            return None
    stack = before[0]
    noise = np.sqrt(np.concatenate([e.allowed() for e in stack.equations]))
    left = [rows / noise for rows in (_in_noise_of(case.baseline, joint, after), before[1])]
    share = explained_share(stack, left, sorted(names & {e.name for e in stack.equations}))
    return None if share is None else max(share, 0.0)


def _with_rivals_judged(
    case: _Case, joint: Joint, taken: Round, steps: list[Step]
) -> tuple[Joint, Round]:
    """Compare an effect with its rivals by their errors on the recordings set aside; return the fit
    and the selection round of the effect.

    A rival is rejected if the error with the rival is significantly larger than the error with the
    effect. A rival that the fit does not reject replaces the effect if the error with the rival is
    significantly smaller than the error with the effect.
    """
    seen = _seen_aside(case, joint, taken.name)
    if seen is None:
        return joint, taken
    rivals, better = [], []
    for rival in taken.rivals:
        tried = within_limits(case.here, case.unit, rival.joint)
        there = _seen_aside(case, tried, rival.name)
        # The torque during crossings has already decided between a gap and a loop.
        if distinguished_by_crossings(EFFECTS[taken.name], EFFECTS[rival.name]):
            there = None
        if there is not None and _others(tried, rival.name) == _others(joint, taken.name):
            stack, left, names = seen
            worse = decisive_reduction(stack, [left, _in_noise_of(joint, tried, there[:2])], names)
            if worse >= RULES.rejected:
                rival = replace(rival, preference=max(rival.preference, worse))
            elif worse <= -RULES.rejected:
                if rival.preference < RULES.rejected and not rival.beyond:
                    better.append((worse, rival, tried))
                else:
                    rival = replace(rival, preference=min(rival.preference, 0.0))
        rivals.append(rival)
    if not better:
        return joint, replace(taken, rivals=tuple(rivals))
    worse, rival, tried = min(better, key=lambda b: b[0])
    steps.append(_step("swap", rival.name, joint.cost - tried.cost, -worse, case))
    # Stouffer's sum of the preferences by the fitted recordings and by the recordings set aside.
    former = Contender(taken.name, joint, (-rival.preference - worse) / math.sqrt(2.0), "")
    others = (
        replace(r, preference=preference(tried, r.joint)) for r in rivals if r.name != rival.name
    )
    return tried, Round(rival.name, (former, *others))


def _in_noise_of(joint: Joint, other: Joint, seen: tuple[Stack, Array]) -> Array:
    """Return the residual of another fit relative to the noise of ``joint``.

    The noises of the two fits differ if the noise of one fit was estimated again
    (:func:`identification.diagnosis.fit.noise.with_lower_noise`).
    """
    sigma = {e.name: e.sigma for e in joint.equations}
    stack, out = seen[0], seen[1].copy()
    for equation in other.equations:
        out[stack.part(equation.name)] *= equation.sigma / sigma[equation.name]
    return out


def _others(joint: Joint, name: str) -> set[str]:
    """Return the names of all effects of a fit except ``name``."""
    return {e.term.name for e in joint.effects} - {name}


def _seen_aside(case: _Case, joint: Joint, name: str) -> tuple[Stack, Array, list[str]] | None:
    """Return rows and residual of the recordings set aside, and the equations by which an effect is
    judged, or None if these recordings cannot show the effect.
    """
    own = next((e for e in joint.effects if e.term.name == name), None)
    if own is None or own.term.place is not None or not case.aside:
        return None
    found = validation_residual(joint, case.aside, case.unit)
    return None if found is None else (*found, judging_equations(joint, own.term))


def dropped_effects(found: Search) -> tuple[str, ...]:
    """Return a warning for each effect that was dropped (:func:`validated_effects`)."""
    kept = {e.term.name for e in found.final.effects}
    return tuple(
        f"{title(s.name)} explains part of the fitted recordings but is not identified: {s.note}"
        for s in found.steps
        if s.action == DROPPED and s.name not in kept
    )


class _Case(NamedTuple):
    """Inputs of the test: fitted recordings, recordings set aside, the unit of the torque, and the
    fit of the nominal model within its limits.
    """

    here: Sequence[View]
    aside: Sequence[View]
    unit: str
    baseline: Joint


def _step(
    action: str, name: str, gain: float, worth: float, case: _Case, alone: bool = False
) -> Step:
    if alone:
        note = "the effect occurs in one recording only, so that no other recording can test it"
        return Step(action, name, None, gain, note)
    judges = "recordings set aside" if case.aside else "parts predicted from the other parts"
    if math.isinf(worth):
        return Step(action, name, None, gain, f"explains most of the error on {judges}")
    change = "smaller" if worth >= 0.0 else "larger"
    note = f"on {judges} the effect makes the error {change} by {abs(worth):.1f} standard errors"
    if action == DROPPED:
        least = f"{RULES.rejected:.2f} standard errors"
        note += f", and an identified effect must reduce this error by at least {least}"
    return Step(action, name, None, gain, note)


def _fit_with_rival(case: _Case, joint: Joint, rival: Contender) -> Joint | None:
    """Return the fit with a rival added to the accepted effects, or None if this fit is
    implausible.
    """
    added = rival.joint.effects[-1]
    if (
        rival.beyond
        or rival.preference >= RULES.rejected
        or any(e.term.name == rival.name for e in joint.effects)
    ):
        return None
    tried = fit(case.here, case.unit, joint.nominal, (*joint.effects, added), case.baseline)
    return None if implausible(tried) else within_limits(case.here, case.unit, tried)


def _fit_without(case: _Case, joint: Joint, effect: Added) -> Joint:
    rest = tuple(e for e in joint.effects if e is not effect)
    if not rest:
        return case.baseline
    tried = fit(case.here, case.unit, joint.nominal, rest, case.baseline)
    return within_limits(case.here, case.unit, tried)


def _error_reduction(case: _Case, joint: Joint, without: Joint, effect: Added) -> float:
    """Return by how many standard errors, computed from blocks of time, an effect reduces the error
    in the equations by which it is judged.
    """
    names = judging_equations(joint, effect.term)
    # An unknown initial state is fitted to the recordings set aside, for the fit with and for the
    # fit without the effect.
    unseen = [
        found
        for j, starts in ((joint, ()), (without, (effect,)))
        if case.aside
        and (found := validation_residual(j, case.aside, case.unit, starts)) is not None
    ]
    if len(unseen) == 2:
        stack, left = unseen[1][0], [rows for _, rows in unseen]
        less = reduction(stack, left, names)
        if less >= RULES.rejected or (
            _can_show(stack, left, effect, names)
            and (_beyond_noise(stack, left[1], names) or less < -RULES.rejected)
        ):
            return less
    # No recording is set aside, or the recordings set aside cannot show the effect.
    parts = folds(joint)
    left = [cross_validation_residual(j, parts) for j in (joint, without)]
    return reduction(joint.stack, left, names)


def _can_show(stack: Stack, left: Sequence[Array], effect: Added, names: Sequence[str]) -> bool:
    """Whether an effect changes the prediction of recordings set aside.

    An effect does not change the prediction if one of its parameters is unknown in recordings set
    aside, such as a phase that differs between recordings, or if parameters that are fitted to the
    recordings set aside compensate the effect.
    """
    columns = stack.columns(effect.term, effect.shape).values()
    change = judged_rows(stack, left[0] - left[1], names)
    return any(np.any(c) for c in columns) and (
        not len(change) or float(np.mean(change**2)) >= RULES.least_share
    )


def _beyond_noise(stack: Stack, left: Array, names: Sequence[str]) -> bool:
    """Whether the mean square of a residual over the named equations together exceeds the noise;
    otherwise no effect can reduce the residual.
    """
    rows = judged_rows(stack, left, names)
    return bool(len(rows) and float(np.mean(rows**2)) > RULES.tested_from)


def folds(joint: Joint) -> Array:
    """Return the number of the cross-validation part of each row.

    Each recording is a part. If one recording alone determines a parameter, such as the only loaded
    recording, parts consist of blocks of time instead. If one such part alone determines a
    parameter, its rows are in no part (-1), because a fit to the other parts cannot predict them.
    """
    stack = joint.stack
    squares = parameter_derivatives(joint) ** 2
    owner = np.concatenate([e.owner for e in stack.equations])
    if len(np.unique(owner)) > 1 and not np.any(_sole_parts(squares, owner)):
        return owner
    parts = stack.block % RULES.parts
    return np.where(np.isin(parts, np.unique(parts)[_sole_parts(squares, parts)]), -1, parts)


def _sole_parts(squares: Array, parts: Array) -> Array:
    """Return a mask of the parts that alone determine a parameter, because nearly all squares of
    the derivative with respect to this parameter are in the part, shape (parts,).
    """
    energy = np.array([np.sum(squares[parts == part], axis=0) for part in np.unique(parts)])
    return np.asarray(np.any(energy > RULES.sole_share * np.sum(energy, axis=0), axis=1))
