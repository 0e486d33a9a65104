"""Which of the effects added are kept: what each is worth beside the others, and whether a rival
does as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from scipy import stats

from identification.diagnosis.begin import or_kept
from identification.diagnosis.contest import (
    Contender,
    Round,
    again,
    broken,
    implausible,
    numbers,
    preference,
    simplest,
)
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.result import Step
from identification.diagnosis.rows.view import View
from identification.diagnosis.stack import Candidate
from identification.diagnosis.terms.term import EXACT, ROUGH, Term

EXCESS = 1.5
"""Mean square of the mismatch over that of the noise, up to which the noise may have been taken too
small.
"""
FURTHER_SHARE = 0.4
"""Share of what is left beyond the noise that one more effect must explain; less is the first one's
own shape.
"""
UNCERTAIN = 10.0
"""Gain of one more effect over what is explained already where it shows, over the error of the
others' regressors, below which it is the shape of what came before...
"""
NEARLY_ALL = 0.8
"""... unless it explains this share of what is left beyond the noise; below that error itself
nothing is told.
"""
LEAST_FURTHER = UNCERTAIN * ROUGH
SURE = float(stats.norm.isf(0.01))
"""Standard errors by which an effect must be worth keeping where without it nothing is left beyond
the noise. There it must be worth :data:`UNCERTAIN` times the error of the others as well, unless
they are exact: below that and below the noise is where regressors err.
"""

MOST_GROWN = 3.0
"""Most that a joint fit makes of the gain that an effect's regressors promise, where that is looked
at before.
"""


def pruned(
    views: Sequence[View],
    unit: str,
    baseline: Joint,
    joint: Joint,
    rounds: list[Round],
    steps: list[Step],
) -> tuple[Joint, list[Round]]:
    """Take out effects that explain too little of what is left without them, the least of them
    first.
    """
    while len(joint.effects) > 1:
        trials = []
        for effect in joint.effects:
            rest = tuple(e for e in joint.effects if e is not effect)
            without = or_kept(views, unit, fit(views, unit, joint.nominal, rest, baseline))
            share, needed = _worth(baseline, without, joint, effect.term)
            trials.append((share / needed, share, needed, effect.term.name, without))
        worth, share, needed, name, without = min(
            trials, key=lambda trial: (trial[0], trial[-1].cost)
        )
        if worth >= 1.0:
            break
        note = (
            f"explains {100.0 * share:.0f} % of what is left beyond the noise without it, where "
            f"{100.0 * needed:.0f} % "
            "make one more name"
        )
        steps.append(Step("remove", name, None, without.cost - joint.cost, note))
        joint = without
        rounds = [r for r in rounds if r.name != name]
    return joint, rounds


def _worth(baseline: Joint, without: Joint, joint: Joint, term: Term) -> tuple[float, float]:
    """Return the share of what is left beyond the noise that one effect explains, and the share
    that it must.
    """
    parts = _touched(joint, term)
    gain = _squares(without, parts) - _squares(joint, parts)
    others = gain / max(_squares(baseline, parts) - _squares(without, parts), 1e-300)
    needed = needed_share(others, _error(without, term))
    left = _beyond_noise(without, parts)
    if left <= 1.0 and (others < _least(without, term) or preference(joint, without) < SURE):
        needed = math.inf
    return gain / left, needed


def hopeless(baseline: Joint, joint: Joint, term: Term, candidate: Candidate) -> bool:
    """Whether one more effect would be taken out again after the fit: it is not worth keeping by
    what it promises.

    Nothing is left beyond the noise where it shows, and it explains less than the error of the
    effects before it, or is not sure.
    """
    parts = _touched(joint, term)
    if _beyond_noise(joint, parts) > 1.0:
        return False
    explained = _squares(baseline, parts) - _squares(joint, parts)
    return (
        MOST_GROWN * candidate.gain < _least(joint, term) * explained or candidate.preference < SURE
    )


def _least(beside: Joint, term: Term) -> float:
    """Return the gain, over what others explain, below which an effect is their error where nothing
    else is left.
    """
    error = _error(beside, term)
    return UNCERTAIN * error if error > EXACT else error


def _error(beside: Joint, term: Term) -> float:
    """Return what the regressors of other effects leave to this one, over what they explain."""
    return max((e.term.shape_error for e in beside.effects if alike(e.term, term)), default=EXACT)


def needed_share(others: float, error: float = ROUGH) -> float:
    """Return the share of what is left that one more effect must explain; infinite where nothing
    would do.

    Args:
        others: Its gain over what the others explain in its equations.
        error: Of the others' regressors, over the same.
    """
    if others < error:
        return math.inf
    return NEARLY_ALL if others < UNCERTAIN * error else FURTHER_SHARE


def revisited(
    views: Sequence[View],
    unit: str,
    baseline: Joint,
    joint: Joint,
    rounds: list[Round],
    dropped: Sequence[Added],
    steps: list[Step],
) -> tuple[Joint, list[Round]]:
    """Hold every effect against its rivals again, now that the others are in the model: what was
    missing misled.

    What was taken out again is a rival of all that stayed and show in the same equation.
    """
    for place, taken in enumerate(rounds):
        others = tuple(e for e in joint.effects if e.term.name != taken.name)
        own = next(e for e in joint.effects if e.term.name == taken.name)
        tried = {e.term.name: e for e in (*(r.joint.effects[-1] for r in taken.rivals), *dropped)}
        trials = [(own, joint)]
        for name, added in tried.items():
            if (
                name != own.term.name
                and all(e.term.name != name for e in others)
                and alike(own.term, added.term)
            ):
                trials.append((added, fit(views, unit, joint.nominal, (*others, added), baseline)))
        ranked = sorted(trials, key=lambda trial: trial[1].cost)
        sound = [trial for trial in ranked if trial[0] is own or not implausible(trial[1])]
        chosen, best = sound[simplest([j for _, j in sound], [numbers(e) for e, _ in sound])]
        if chosen is not own:
            note = (
                f"beside the others, preferred to {taken.name} by "
                f"{preference(best, joint):.1f} standard errors"
            )
            steps.append(Step("swap", chosen.term.name, None, joint.cost - best.cost, note))
        rivals = tuple(
            Contender(e.term.name, j, preference(best, j), "" if e is own else implausible(j))
            for e, j in ranked
            if e is not chosen and not broken(j) and not again(e, j, chosen, best)
        )
        joint = best
        rounds = [*rounds[:place], Round(chosen.term.name, rivals), *rounds[place + 1 :]]
    return joint, rounds


def alike(one: Term, other: Term) -> bool:
    """Whether two effects show in the same equation; what shows in another is beside an effect, not
    instead of it.
    """
    return bool((one.columns.keys() & other.columns.keys()) - {"breakaway"})


def left_beyond_noise(joint: Joint, term: Term) -> float:
    """Return the sum of whitened squares beyond the noise that is left where an effect shows."""
    return _beyond_noise(joint, _touched(joint, term))


def judging(joint: Joint, term: Term) -> list[str]:
    """Return the equations by which an effect is judged, of those that it touches.

    A breakaway is one number for a rest, and its noise that of an instant within a sample: it
    judges no model but one that shows nowhere else.
    """
    names = [e.name for e in joint.equations if e.name in term.columns]
    return [name for name in names if name != "breakaway" or len(names) == 1]


def _touched(joint: Joint, term: Term) -> list[slice]:
    """Return the rows of the equations by which an effect is judged."""
    return [joint.stack.part(name) for name in judging(joint, term)]


def _squares(joint: Joint, parts: Sequence[slice]) -> float:
    return sum((float(joint.residual[rows] @ joint.residual[rows]) for rows in parts), 0.0)


def _beyond_noise(joint: Joint, parts: Sequence[slice]) -> float:
    """Return the sum of whitened squares beyond the noise."""
    beyond = [
        max(_squares(joint, [rows]) - EXCESS * (rows.stop - rows.start), 0.0) for rows in parts
    ]
    return 1.0 + float(sum(beyond))
