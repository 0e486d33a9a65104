"""Tests whether an effect reduces the error on recordings that were not used in its fit.

If recordings are set aside, the error is that of their prediction. Otherwise each part of the
recordings is predicted from a fit to all other parts, with nonlinear parameters and Stribeck speeds
fixed (cross-validation: Stone, Journal of the Royal Statistical Society B 36 (1974) 111).

The oracle of a proof is the error of a model with the true effects: their names are given, all
parameters are estimated from the fitted recordings alone, as in a diagnosis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from identification.diagnosis.comparison import (
    Contender,
    Round,
    implausible,
    parameter_count,
    preference,
)
from identification.diagnosis.crossing import distinguished_by_crossings
from identification.diagnosis.joint import Joint, fit, nominal_after_effects, undetermined_size
from identification.diagnosis.linear import Added, effect_derivatives
from identification.diagnosis.removal import (
    LEAST_FURTHER,
    judging_equations,
    share_equation,
    with_best_rivals,
)
from identification.diagnosis.result import Step
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Search, best_of_each
from identification.diagnosis.significance import trial_candidates
from identification.diagnosis.stack import Stack, with_effect_basis
from identification.diagnosis.within_limits import (
    cross_validation_residual,
    parameter_derivatives,
    within_limits,
)
from identification.effects import EFFECTS, MOTION
from identification.effects.effect import Context, Effect, title
from identification.prepare import torque_unit
from identification.recording import Array, Dataset
from identification.views.view import View, views


def validation_residual(
    joint: Joint, aside: Sequence[View], starts: Sequence[Added] = ()
) -> tuple[Stack, Array] | None:
    """Return the rows of recordings set aside, and the residual of a fit at these rows, relative to
    the noise of the fitted recordings; None if too few samples are in steady motion.

    No nominal parameter and no effect is fitted to these rows. In equations other than the torque
    equation, constants such as the zero of an encoder are fitted but not reported. Unknown states
    at the start of a recording, of the effects of the fit and of ``starts``, are fitted too.
    """
    stack = joint.unseen(aside)
    if stack is None:
        return None
    left = stack.measured
    for effect in joint.effects:
        # An effect that occurs in one recording only, such as a mislabelled weight, does not occur
        # in recordings set aside.
        columns = stack.columns(effect.term, effect.shape) if effect.term.place is None else {}
        if columns:
            left -= stack.whitened(columns) @ np.array(effect.coefficients)
    left = _with_own_constants(stack, left[:, None])[:, 0]
    return stack, _without_start_states(stack, (*joint.effects, *starts), left)


def _with_own_constants(stack: Stack, rows: Array) -> Array:
    """Return whitened rows after a fit of the parameters of all equations but the torque's."""
    out = rows.copy()
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        if equation.name != "torque":
            part = stack.part(equation.name)
            out[part] -= basis @ (basis.T @ out[part])
    return out


def _without_start_states(stack: Stack, effects: Sequence[Added], left: Array) -> Array:
    """Return rows after a fit of the effects' unknown states at the start of each recording."""
    owner = np.concatenate([e.owner for e in stack.equations])
    for effect in effects:
        if not effect.term.start:
            continue
        begun = effect.term.modified(name=f"start of {effect.term.name}", columns=effect.term.start)
        columns = stack.columns(begun, effect.shape)
        if not columns:
            continue
        whole = stack.whitened(columns)
        own = np.concatenate([whole * (owner == k)[:, None] for k in np.unique(owner)], axis=1)
        own = _with_own_constants(stack, own[:, np.any(own, axis=0)])
        left = left - own @ np.linalg.lstsq(own, left, rcond=None)[0]
    return left


def validation_rms(joint: Joint, aside: Sequence[View]) -> dict[str, float]:
    """Return each equation's rms error on recordings set aside (:func:`validation_residual`)."""
    found = validation_residual(joint, aside) if aside else None
    return {} if found is None else rms_by_equation(*found)


def rms_by_equation(stack: Stack, left: Array) -> dict[str, float]:
    """Return the rms of whitened rows in each equation, in its unit, without rows of priors."""
    return {
        e.name: e.sigma * float(np.sqrt(np.mean(left[stack.part(e.name)][e.owner >= 0] ** 2)))
        for e in stack.equations
    }


def judged_rows(stack: Stack, rows: Array, names: Sequence[str]) -> Array:
    """Return those rows of the whole stack that belong to the named equations."""
    return np.concatenate([rows[:0], *(rows[stack.part(name)] for name in names)])


def reduction(stack: Stack, left: Sequence[Array], names: Sequence[str]) -> float:
    """Return :func:`studentised_reduction`; infinite if the second residual has most of its squares
    beyond the noise in excess of the first residual.

    An effect that occurs in a few blocks, such as an end stop, may explain nearly the whole
    mismatch, although a few blocks are not sufficient for a standard error.
    """
    explained = explained_share(stack, left, names)
    if explained is not None and explained >= RULES.adequate:
        return math.inf
    return studentised_reduction(stack, left, names)


def explained_share(stack: Stack, left: Sequence[Array], names: Sequence[str]) -> float | None:
    """Return the relative reduction of the squares beyond the noise from the second residual to the
    first, over the named equations together, or None if the second residual has no squares beyond
    the noise.
    """
    rows = judged_rows(stack, np.stack(left, axis=1), names)
    within = RULES.excess * len(rows)
    first, second = (max(float(squares), within) for squares in np.sum(rows**2, axis=0))
    return (second - first) / (second - within) if second > within else None


def studentised_reduction(stack: Stack, left: Sequence[Array], names: Sequence[str]) -> float:
    """Return by how many standard errors, over blocks of time, the first residual is smaller than
    the second in the named equations together.

    The rms of each block is compared; with squares, a few blocks would determine the result.
    """
    shown = np.zeros(len(left[0]), dtype=bool)
    for name in names:
        shown[stack.part(name)] = True
    squares = stack.sums(np.stack(left, axis=1) ** 2 * shown[:, None])
    lessened = np.diff(np.sqrt(squares), axis=1)[:, 0]
    scatter = float(np.std(lessened, ddof=1)) if len(lessened) > 1 else 0.0
    spread = scatter * math.sqrt(len(lessened))
    worth = float(np.sum(lessened)) / spread if spread > 0.0 else math.inf
    first, second = np.sum(squares, axis=0)
    return worth if first < second else min(worth, 0.0)


def decisive_reduction(stack: Stack, left: Sequence[Array], names: Sequence[str]) -> float:
    """Return :func:`studentised_reduction`; 0 if there is only one block, or if the two mean
    squares differ by less than the uncertainty of the mean square of the noise.
    """
    rows = judged_rows(stack, np.stack(left, axis=1), names)
    low, high = sorted(float(squares) for squares in np.sum(rows**2, axis=0))
    if stack.blocks < 2 or high <= RULES.tested_from * low:
        return 0.0
    return studentised_reduction(stack, left, names)


DROPPED = "drop"
"""Name of a step that drops an effect because the effect does not reduce the error on unused
recordings, or because the recordings do not determine its size.
"""


def validated_effects(found: Search, aside: Sequence[View], terms: Sequence[Effect] = ()) -> Search:
    """Return a search with fits within their limits, and without effects that do not reduce the
    error on unused recordings significantly, or all of whose sizes may be those without the effect.

    Of the effects that fail the first test, the effect that reduces the error least is dropped
    first; then an effect is dropped if the intervals of all its sizes contain the values without
    the effect. After each drop all effects are compared again with their rivals and with those that
    now score best (:func:`_contested_again`). Finally, the errors on recordings set aside decide
    between each remaining effect and its rivals.
    """
    baseline = within_limits(found.baseline)
    case = _Case(aside, baseline, tuple(terms), set())
    joint = within_limits(found.final)
    rounds, steps = {r.name: r for r in found.rounds}, list(found.steps)
    while joint.effects:
        dropped = _least_useful(case, joint, steps) or _undetermined(case, joint, steps)
        if dropped is None:
            break
        joint = _contested_again(case, joint, *dropped, rounds, steps)
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


def _least_useful(case: _Case, joint: Joint, steps: list[Step]) -> tuple[Added, Joint] | None:
    """Return the effect that reduces the error on unused recordings least, and the fit without it,
    or None if every effect reduces this error significantly.
    """
    trials = [
        (_error_reduction(case, joint, without, effect), effect, without)
        for effect in joint.effects
        if effect.term.place is None
        for without in [_fit_without(case, joint, effect)]
    ]
    if not trials or min(t[0] for t in trials) >= RULES.rejected:
        return None
    worth, effect, without = min(trials, key=lambda t: t[0])
    steps.append(_step(DROPPED, effect.term.name, without.cost - joint.cost, worth, case))
    return effect, without


def _undetermined(case: _Case, joint: Joint, steps: list[Step]) -> tuple[Added, Joint] | None:
    """Return the last effect all of whose sizes may be those without it, and the fit without it."""
    for k, effect in reversed([*enumerate(joint.effects)]):
        note = undetermined_size(joint, k)
        if note is not None:
            without = _fit_without(case, joint, effect)
            gain = without.cost - joint.cost
            steps.append(Step(DROPPED, effect.term.name, None, gain, note))
            return effect, without
    return None


def _contested_again(
    case: _Case,
    joint: Joint,
    lost: Added,
    without: Joint,
    rounds: dict[str, Round],
    steps: list[Step],
) -> Joint:
    """Return the fit after all names competed again, because the effect ``lost`` was dropped.

    The other effects were selected beside the dropped effect: each is compared with its rivals
    again, and the dropped effect is a rival once. Then the rivals of the dropped effect and the
    effects that now score best compete for its place. The best that reduces the error on unused
    recordings takes it; the level of this test accounts for the number of competitors.
    """
    name = lost.term.name
    taken = rounds.pop(name, Round(name, ()))
    if rounds:
        again = [lost] if name not in case.dropped else []
        still = [
            replace(r, rivals=tuple(c for c in r.rivals if c.name not in case.dropped | {name}))
            for r in rounds.values()
        ]
        raw = case.baseline.again(without.nominal, without.effects)
        raw, kept = with_best_rivals(case.baseline, raw, still, again, steps)
        rounds.clear()
        rounds.update({r.name: r for r in kept})
        without = within_limits(raw)
    case.dropped.add(name)
    fitted = _competitors(case, without, lost, [r.effect for r in taken.rivals])
    needed = float(stats.norm.isf(stats.norm.sf(RULES.rejected) / max(len(fitted), 1)))
    for tried in fitted:
        own = tried.effects[-1]
        # No other recording can test an effect of one recording; other parts of it can.
        judges = case if own.term.place is None else case._replace(aside=())
        worth = _error_reduction(judges, tried, without, own)
        if worth >= needed:
            entered = own.term.name
            steps.append(_step("swap", entered, without.cost - tried.cost, worth, judges))
            others = {name: joint, **{j.effects[-1].term.name: j for j in fitted}}
            rounds[entered] = Round(
                entered,
                tuple(
                    Contender(n, j, preference(tried, j), "")
                    for n, j in others.items()
                    if n != entered and any(e.term.name == n for e in j.effects)
                ),
                unconfirmed=True,
            )
            return tried
    return without


def _competitors(case: _Case, without: Joint, lost: Added, rivals: Sequence[Added]) -> list[Joint]:
    """Return the fits with one more effect in place of the dropped effect, best first: of the
    rivals and of the effects that score best, if their parameters are plausible and their sizes
    determined.
    """
    context = Context(without.views, without.nominal)
    alike = [t for t in case.terms if share_equation(t, lost.term)]
    scored = best_of_each(
        [*trial_candidates(without.stack, context, alike)], {t.name: t for t in alike}
    )
    by_name, started = {t.name: t for t in alike}, {e.term.name: e for e in rivals}
    entrants = {
        c.name: started.get(c.name, Added(by_name[c.name], c.shape, tuple(c.coefficients.tolist())))
        for c in scored
    }
    out, beside = [], {e.term.name for e in without.effects}
    # An effect without a score has been a rival.
    names = [n for n in (entrants | started) if n not in case.dropped | beside]
    for name in names[: RULES.finalists]:
        added = entrants.get(name) or started[name]
        tried = case.baseline.again(without.nominal, (*without.effects, added))
        if implausible(tried):
            continue
        tried = within_limits(tried)
        if undetermined_size(tried, len(tried.effects) - 1) is None:
            out.append(tried)
    return sorted(out, key=lambda j: j.cost)


def _unseen_share(case: _Case, joint: Joint) -> float | None:
    """Return the share of the mismatch beyond the noise on recordings set aside that all effects
    together explain, in the equations by which the effects are judged. The result is None if there
    is no such mismatch, or if a parameter of an effect is unknown in recordings set aside, such as
    a phase that differs between recordings.
    """
    names = {name for e in joint.effects for name in judging_equations(joint, e.term)}
    before, after = (
        validation_residual(j, case.aside, starts) if case.aside else None
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
    if _seen_aside(case, joint, taken.name) is None:
        return joint, taken
    rivals, better, limited = [], [], {}
    for rival in taken.rivals:
        tried = limited[rival.name] = within_limits(rival.joint)
        worse = _worse_aside(case, joint, taken.name, tried, rival.name)
        if worse >= RULES.rejected:
            rival = replace(rival, preference=max(rival.preference, worse))
        elif worse <= -RULES.rejected:
            place = [e.term.name for e in tried.effects].index(rival.name)
            if rival.open and undetermined_size(tried, place) is None:
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
    others = []
    for r in rivals:
        if r.name != rival.name:
            fitted = preference(tried, limited[r.name])
            aside = _worse_aside(case, tried, rival.name, limited[r.name], r.name)
            rejects = aside >= RULES.rejected
            others.append(replace(r, preference=max(fitted, aside) if rejects else fitted))
    return tried, Round(rival.name, (former, *others), unconfirmed=True)


def _worse_aside(case: _Case, joint: Joint, name: str, other: Joint, rival: str) -> float:
    """Return by how many standard errors the rival's fit is worse than ``joint`` on the recordings
    set aside; 0 if these recordings cannot compare the two fits.
    """
    seen, there = _seen_aside(case, joint, name), _seen_aside(case, other, rival)
    if seen is None or there is None:
        return 0.0
    own, its = (
        next(e.term for e in j.effects if e.term.name == n)
        for j, n in ((joint, name), (other, rival))
    )
    # The torque during crossings has already decided between a gap and a loop.
    if distinguished_by_crossings(own, its):
        return 0.0
    if _others(other, rival) != _others(joint, name):
        return 0.0
    stack, left, names = seen
    return decisive_reduction(stack, [left, _in_noise_of(joint, other, there[:2])], names)


def _in_noise_of(joint: Joint, other: Joint, seen: tuple[Stack, Array]) -> Array:
    """Return the residual of another fit relative to the noise of ``joint``.

    The noises of the two fits differ if the noise of one fit was estimated again
    (:func:`identification.diagnosis.joint.with_lower_noise`).
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
    """Return rows, residual and judging equations of recordings that show the effect, or None."""
    own = next((e for e in joint.effects if e.term.name == name), None)
    if own is None or own.term.place is not None or not case.aside:
        return None
    found = validation_residual(joint, case.aside)
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
    """Recordings set aside, the fit of the nominal model within its limits, the effects that were
    searched for, and the names of dropped effects.
    """

    aside: Sequence[View]
    baseline: Joint
    terms: tuple[Effect, ...]
    dropped: set[str]


def _step(action: str, name: str, gain: float, worth: float, case: _Case) -> Step:
    judges = "recordings set aside" if case.aside else "parts predicted from the other parts"
    if math.isinf(worth):
        return Step(action, name, None, gain, f"explains most of the error on {judges}")
    change = "smaller" if worth >= 0.0 else "larger"
    note = f"on {judges} the effect makes the error {change} by {abs(worth):.1f} standard errors"
    if action == DROPPED:
        least = f"{RULES.rejected:.2f} standard errors"
        note += f", and an identified effect must reduce this error by at least {least}"
    return Step(action, name, None, gain, note)


def _fit_without(case: _Case, joint: Joint, effect: Added) -> Joint:
    rest = tuple(e for e in joint.effects if e is not effect)
    if not rest:
        return case.baseline
    return within_limits(case.baseline.again(joint.nominal, rest))


def _error_reduction(case: _Case, joint: Joint, without: Joint, effect: Added) -> float:
    """Return by how many standard errors over blocks an effect reduces the error."""
    names = judging_equations(joint, effect.term)
    # An unknown initial state is fitted to the recordings set aside, for the fit with and for the
    # fit without the effect.
    unseen = [
        found
        for j, starts in ((joint, ()), (without, (effect,)))
        if case.aside and (found := validation_residual(j, case.aside, starts)) is not None
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
    """Whether the mean square exceeds the noise; otherwise no effect can reduce it."""
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
    if len(np.unique(owner[owner >= 0])) > 1 and not np.any(_sole_parts(squares, owner)):
        return owner
    parts = stack.block % RULES.parts
    return np.where(np.isin(parts, np.unique(parts)[_sole_parts(squares, parts)]), -1, parts)


def _sole_parts(squares: Array, parts: Array) -> Array:
    """Return a mask of the parts with nearly all squares of a parameter's derivative."""
    known = np.unique(parts[parts >= 0])
    energy = np.array([np.sum(squares[parts == part], axis=0) for part in known])
    return np.asarray(np.any(energy > RULES.sole_share * np.sum(energy, axis=0), axis=1))


def with_indistinct_effects(found: Search, terms: Sequence[Effect]) -> Search:
    """Return the search with effects that these recordings cannot distinguish from an identified
    effect as further rivals. Such a rival is open unless its parameters are implausible.
    """
    places = {e.term.name: k for k, e in enumerate(found.final.effects)}
    rounds = tuple(
        _with_indistinct_rivals(found.final, places[r.name], r, terms) if r.name in places else r
        for r in found.rounds
    )
    return replace(found, rounds=rounds)


def _with_indistinct_rivals(
    final: Joint, place: int, taken: Round, terms: Sequence[Effect]
) -> Round:
    alike = _indistinct_effects(final, place, terms)
    views, own = final.views, final.effects[place]
    alike += own.term.indistinct(own.parameters(Context(views, final.nominal)), views)
    tested = {r.name for r in taken.rivals}
    rivals = [
        replace(r, preference=min(r.preference, 0.0)) if r.name in alike else r
        for r in taken.rivals
    ]
    rivals += [Contender(name, final, 0.0, "") for name in alike if name not in tested]
    return replace(taken, rivals=tuple(rivals))


def _indistinct_effects(final: Joint, place: int, terms: Sequence[Effect]) -> list[str]:
    """Return the effects that have no more parameters than an identified effect, and whose
    regressors, at one set of trial parameters, contain the contribution of the identified effect.

    A gap and a loop are distinguished by the torque during crossings, which no regressor contains.
    """
    own = final.effects[place]
    stack = replace(final.stack, effect_basis=np.zeros((len(final.stack.residual), 0)))
    others = [e for k, e in enumerate(final.effects) if k != place]
    if others:
        stack = with_effect_basis(stack, effect_derivatives(stack, others))
    columns = stack.columns(own.term, own.shape)
    if not columns:
        return []
    made = stack.projected(stack.whitened(columns) @ np.array(own.coefficients)[:, None])[:, 0]
    white = all(e.white for e in stack.equations)
    # In white noise the expected preference is half the norm of the difference.
    least = (2.0 * RULES.rejected) ** 2 / float(made @ made) if white else LEAST_FURTHER
    # Regressors that depend on the drive's torque must not contain the torque of the identified
    # effect.
    without = replace(stack, nominal=nominal_after_effects(final.nominal, others), own={})
    context = Context(final.views, without.nominal)
    found = []
    for term in terms:
        if term.name == own.term.name or distinguished_by_crossings(own.term, term):
            continue
        if not columns.keys() & term.columns.keys():
            continue
        for shape in term.shapes(context):
            its = without.columns(term, shape)
            width = max((c.shape[1] for c in its.values()), default=0)
            if not width or term.freedom + width > parameter_count(own):
                continue
            unexplained, coefficients = _unexplained_share(stack, made, its)
            if unexplained <= least and not term.impossible(coefficients, without.nominal):
                found.append(term.name)
                break
    return found


def _unexplained_share(
    stack: Stack, made: Array, columns: Mapping[str, Array]
) -> tuple[float, tuple[float, ...]]:
    """Return the share of a contribution that regressors leave, and their coefficients."""
    whole = stack.whitened(columns)
    square = whole.T @ whole
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        if equation.name in columns:
            along = basis.T @ whole[stack.part(equation.name)]
            square -= along.T @ along
    along = stack.effect_basis.T @ whole
    square -= along.T @ along
    score, least = whole.T @ made, 1e-9
    if not np.max(np.diag(square)) > np.finfo(float).smallest_normal / least:
        return 1.0, (0.0,) * len(score)
    fitted = np.linalg.pinv(square, rcond=least, hermitian=True) @ score
    share = 1.0 - float(score @ fitted) / max(float(made @ made), 1e-300)
    return share, tuple(fitted.tolist())


@dataclass(frozen=True)
class HeldOut:
    """Rms errors on recordings set aside, in the equation in which the true effects help most."""

    equation: str  # name of the equation
    baseline_rms: float  # error of the nominal model alone, in the unit of the equation
    oracle_rms: float  # error with the true effects, in the unit of the equation
    noise_rms: float  # noise of one row, in the unit of the equation


def oracle(
    dataset: Dataset, first: Joint, names: Sequence[str], bandwidth_Hz: float
) -> HeldOut | None:
    """Fit the effects with the given names, and compute the errors on the recordings set aside.

    The result is None if these recordings have no row of any equation, or if an effect is collinear
    with the nominal model or its fitted coefficient has an unphysical sign.
    """
    fitted, held = dataset.part("fit"), dataset.part("validate")
    if not held:
        return None
    gives = any(EFFECTS[name].flexible for name in names)
    here = views(fitted, bandwidth_Hz, gives, dataset.recordings)
    baseline = fit(here, torque_unit(fitted[0]), first.nominal)
    left = {
        t.name: t for t in (e.on_the_joint() if gives else e for e in MOTION) if t.name in names
    }
    joint = baseline
    while left:
        trials = trial_candidates(
            joint.stack, Context(joint.views, joint.nominal), list(left.values())
        )
        best = max(trials, key=lambda c: c.score, default=None)
        if best is None:
            return None
        added = Added(left.pop(best.name), best.shape, tuple(float(c) for c in best.coefficients))
        joint = baseline.again(joint.nominal, (*joint.effects, added))
    aside = views((*fitted, *held), bandwidth_Hz, gives, dataset.recordings)[len(fitted) :]
    before, after = validation_rms(baseline, aside), validation_rms(joint, aside)
    noise = {e.name: e.sigma for e in baseline.equations if e.name in before and e.judges}
    if not noise:
        return None
    where = max(noise, key=lambda name: (before[name] ** 2 - after[name] ** 2) / noise[name] ** 2)
    return HeldOut(where, before[where], after[where], noise[where])
