"""Removes and replaces effects, by the squares that each adds, and by comparison with rivals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from scipy import stats

from identification.diagnosis.comparison import (
    Contender,
    Round,
    advantage,
    contains,
    implausible,
    parameter_count,
    preference,
    preferred,
    simplest,
)
from identification.diagnosis.joint import Added, Joint
from identification.diagnosis.result import Step
from identification.diagnosis.rows import AT_INSTANTS
from identification.diagnosis.rules import RULES
from identification.diagnosis.stack import Candidate
from identification.diagnosis.within_limits import feasible_or_first, infeasible
from identification.effects.effect import EXACT, ROUGH, Effect

LEAST_FURTHER = RULES.shape_errors * ROUGH
"""Gain of an effect, relative to the gain of another effect, below which the first gain may be due
to an error of the other effect's regressors.
"""
MOST_CONTESTS = 3
"""Greatest number of times that all effects are compared with their rivals in turn."""
SIGNIFICANT = float(stats.norm.isf(0.01))
"""Least preference, in standard errors, for an effect without which no mismatch beyond the noise
remains. The gain of the effect must then also be `shape_errors` times the error of the regressors
of the other effects, unless these regressors are exact; errors of regressors are below both limits.
"""


def with_needed_effects(
    baseline: Joint, joint: Joint, rounds: list[Round], steps: list[Step]
) -> tuple[Joint, list[Round]]:
    """Remove effects that explain too little of the mismatch that remains without them, beginning
    with the effect that explains least; return the fit and the selection rounds.
    """
    while len(joint.effects) > 1:
        trials = []
        for effect in joint.effects:
            rest = tuple(e for e in joint.effects if e is not effect)
            without = feasible_or_first(baseline.again(joint.nominal, rest))
            share, needed = _explained_share(baseline, without, joint, effect.term)
            trials.append((share / needed, share, needed, effect.term.name, without))
        worth, share, needed, name, without = min(
            trials, key=lambda trial: (trial[0], trial[-1].cost)
        )
        if worth >= 1.0:
            break
        steps.append(
            Step("remove", name, None, without.cost - joint.cost, _why_removed(share, needed))
        )
        joint = without
        rounds = [r for r in rounds if r.name != name]
    return joint, rounds


def _why_removed(share: float, needed: float) -> str:
    """Return the reason of a removal from the explained and the needed share."""
    explains = (
        f"explains {100.0 * share:.0f} % of the mismatch beyond the noise that remains without it"
    )
    if math.isinf(needed):
        return (
            f"{explains}, which may be due to chance or to errors of the other effects' regressors"
        )
    return f"{explains}; one more effect must explain at least {100.0 * needed:.0f} %"


def _explained_share(
    baseline: Joint, without: Joint, joint: Joint, term: Effect
) -> tuple[float, float]:
    """Return the share of the mismatch that one effect explains, and the share it must explain."""
    parts = _judging_rows(joint, term)
    gain = _squares(without, parts) - _squares(joint, parts)
    others = gain / max(_squares(baseline, parts) - _squares(without, parts), 1e-300)
    needed = needed_share(others, _regressor_error(without, term))
    left = _beyond_noise(without, parts)
    if left <= 1.0 and (
        others < _least_gain(without, term) or advantage(joint, without) < SIGNIFICANT
    ):
        needed = math.inf
    return gain / left, needed


def would_be_removed(baseline: Joint, joint: Joint, term: Effect, candidate: Candidate) -> bool:
    """Whether one more effect would be removed again after its fit, by its predicted gain.

    An effect would be removed if no mismatch beyond the noise remains in its equations, and if it
    explains less than the regressor error of the earlier effects or is not significant.
    """
    parts = _judging_rows(joint, term)
    if _beyond_noise(joint, parts) > 1.0:
        return False
    explained = _squares(baseline, parts) - _squares(joint, parts)
    return (
        RULES.gain_ratio * candidate.gain < _least_gain(joint, term) * explained
        or candidate.preference < SIGNIFICANT
    )


def _least_gain(beside: Joint, term: Effect) -> float:
    """Return the relative gain that errors of the other effects' regressors may cause."""
    error = _regressor_error(beside, term)
    return RULES.shape_errors * error if error > EXACT else error


def _regressor_error(beside: Joint, term: Effect) -> float:
    """Return the error of the other effects' regressors, relative to their gain."""
    return max(
        (e.term.shape_error for e in beside.effects if share_equation(e.term, term)), default=EXACT
    )


def needed_share(others: float, error: float = ROUGH) -> float:
    """Return the share of the remaining mismatch that one more effect must explain; infinite if no
    share is sufficient.

    Args:
        others: Gain of the effect relative to the gain of the other effects in its equations.
        error: Error of the regressors of the other effects, relative to the gain of these effects.
    """
    if others < error:
        return math.inf
    return RULES.nearly_all if others < RULES.shape_errors * error else RULES.further_share


def with_best_rivals(
    baseline: Joint, joint: Joint, rounds: list[Round], dropped: Sequence[Added], steps: list[Step]
) -> tuple[Joint, list[Round]]:
    """Compare every effect with its rivals again, with all other effects in the model, until no
    rival takes the place of an effect; return the fit and the selection rounds.

    Removed effects are rivals of all kept effects that appear in the same equation, and so is an
    effect that was replaced.
    """
    for _ in range(MOST_CONTESTS):
        names = [r.name for r in rounds]
        joint, rounds = _contested_once(baseline, joint, rounds, dropped, steps)
        if [r.name for r in rounds] == names:
            break
    return joint, rounds


def _contested_once(
    baseline: Joint, joint: Joint, rounds: list[Round], dropped: Sequence[Added], steps: list[Step]
) -> tuple[Joint, list[Round]]:
    """Compare every effect with its rivals once."""
    for place, taken in enumerate(rounds):
        others = tuple(e for e in joint.effects if e.term.name != taken.name)
        own = next(e for e in joint.effects if e.term.name == taken.name)
        tried = {e.term.name: e for e in (*(r.effect for r in taken.rivals), *dropped)}
        trials = [(own, joint)]
        for name, added in tried.items():
            if (
                name != own.term.name
                and all(e.term.name != name for e in others)
                and share_equation(own.term, added.term)
            ):
                trials.append((added, baseline.again(joint.nominal, (*others, added))))
        ranked = sorted(trials, key=lambda trial: trial[1].cost)
        sound = [trial for trial in ranked if trial[0] is own or not implausible(trial[1])]
        chosen, best = sound[
            simplest([j for _, j in sound], [parameter_count(e) for e, _ in sound])
        ]
        if chosen is not own:
            note = (
                "with all other effects in the model, "
                f"{preferred(taken.name, preference(best, joint))}"
            )
            steps.append(Step("swap", chosen.term.name, None, joint.cost - best.cost, note))
        rivals = tuple(
            Contender(e.term.name, j, preference(best, j), "" if e is own else implausible(j))
            for e, j in ranked
            if e is not chosen and not infeasible(j) and not contains(e, j, chosen, best)
        )
        joint = best
        kept = replace(taken, rivals=rivals) if chosen is own else Round(chosen.term.name, rivals)
        rounds = [*rounds[:place], kept, *rounds[place + 1 :]]
    return joint, rounds


def share_equation(one: Effect, other: Effect) -> bool:
    """Whether two effects appear in the same equation and so can replace each other."""
    return bool((one.columns.keys() & other.columns.keys()) - AT_INSTANTS)


def left_beyond_noise(joint: Joint, term: Effect) -> float:
    """Return the whitened squares beyond the noise that remain in the equations of an effect."""
    return _beyond_noise(joint, _judging_rows(joint, term))


def judging_equations(joint: Joint, term: Effect) -> list[str]:
    """Return the names of the equations by which an effect is judged.

    An equation at instants judges only effects that appear in no other equation.
    """
    names = [e.name for e in joint.equations if e.name in term.columns]
    return [name for name in names if name not in AT_INSTANTS or len(names) == 1]


def _judging_rows(joint: Joint, term: Effect) -> list[slice]:
    """Return the rows of the equations by which an effect is judged."""
    return [joint.stack.part(name) for name in judging_equations(joint, term)]


def _squares(joint: Joint, parts: Sequence[slice]) -> float:
    return sum((float(joint.residual[rows] @ joint.residual[rows]) for rows in parts), 0.0)


def _beyond_noise(joint: Joint, parts: Sequence[slice]) -> float:
    """Return the sum of whitened squares beyond the noise."""
    beyond = [
        max(_squares(joint, [rows]) - RULES.excess * (rows.stop - rows.start), 0.0)
        for rows in parts
    ]
    return 1.0 + float(sum(beyond))
