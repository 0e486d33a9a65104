"""Selects the effects that are fitted next, also if the mismatch of one equation is far greater,
relative to its noise, than that of another equation.

Encoders resolve a gap a thousand times better than the current resolves friction. The error of an
approximate regressor in the transmission equation then has far larger whitened squares than any
missing effect in the torque equation.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.stack import Candidate
from identification.diagnosis.rules import RULES
from identification.diagnosis.score.significance import beyond_noise
from identification.diagnosis.selection.removal import (
    judging_equations,
    left_beyond_noise,
    would_be_removed,
)
from identification.effects.effect import Context, Effect, Shape

TRIALS = 3
"""Number of trial parameters of an effect without a score; a fit searches within a factor of 4 of
each trial parameter.
"""


def best_of_each(candidates: Sequence[Candidate], terms: Mapping[str, Effect]) -> list[Candidate]:
    """Return the best candidate of each effect that is not negligible, best first.

    Args:
        candidates: Candidates of all effects.
        terms: Terms of the candidates, by name.
    """
    each: dict[str, list[Candidate]] = {}
    for candidate in candidates:
        each.setdefault(candidate.name, []).append(candidate)
    best = [max(c, key=lambda c: _rank(c, terms[c.name])) for c in each.values()]
    return sorted(
        (c for c in best if c.score > 0.0 and c.share > RULES.least_share),
        key=lambda c: -c.score,
    )


def _rank(candidate: Candidate, term: Effect) -> float:
    """Return by what the trials of one effect are compared: the score, and for an effect whose
    nonlinear parameters determine its size, the score at this size.

    The score has a free coefficient, so that all delays far below the time of a motion score alike.
    A fit starts from the trial and searches nearby: it needs the trial of the right size.
    """
    if term.size is None or candidate.score <= 0.0:
        return candidate.score
    short = 1.0 - term.size / float(candidate.coefficients[0])
    return candidate.score - candidate.gain * short**2


def finalist_groups(
    baseline: Joint,
    joint: Joint,
    terms: Mapping[str, Effect],
    ranked: Sequence[Candidate],
    missing: Callable[[str], bool],
) -> Iterator[list[Candidate]]:
    """Yield groups of finalists, to be tried in turn until one effect is selected.

    The finalists for the first effect are selected by their scores alone. For a further effect, the
    first group has those that explain a sufficient share of the mismatch beyond the noise in their
    equations. Effects that appear only in equations without a significant mismatch, and effects
    that would be removed again, are omitted.

    Args:
        baseline: Fit of the nominal model.
        joint: Fit with the effects that were selected so far.
        terms: Terms of the candidates, by name.
        ranked: The best candidate of each effect, best first.
        missing: Function that returns whether physics is missing in the equation of a given name.
    """
    if not joint.effects:
        yield _finalists(ranked)
        return
    seen = {e.name for e in joint.equations if missing(e.name)}
    shown = [
        c
        for c in ranked
        if any(name in seen for name in judging_equations(joint, terms[c.name]))
        and not would_be_removed(baseline, joint, terms[c.name], c)
    ]
    telling = [
        c for c in shown if c.gain >= RULES.further_share * left_beyond_noise(joint, terms[c.name])
    ]
    first = _finalists(telling)
    yield first
    rest = [c for c in shown if c not in first]
    yield _finalists(rest)


def _finalists(ranked: Sequence[Candidate]) -> list[Candidate]:
    return [c for c in ranked if c.score > RULES.rival_share * ranked[0].score][: RULES.finalists]


def unscored(
    joint: Joint, terms: Mapping[str, Effect], scored: Collection[Candidate]
) -> list[Candidate]:
    """Return candidates of the effects without a score whose size is given by a nonlinear
    parameter, in the equations whose mismatch is beyond the noise.

    The regressors of these effects depend on the nominal values. If the nominal values are far from
    the true values, for example without a fall of friction with speed, the score of the right
    effect may be negative.
    """
    names = {c.name for c in scored}
    context = Context(joint.equations[0].views, joint.nominal)
    beyond = beyond_noise(joint)
    out = []
    for name, term in terms.items():
        if name in names or term.size is None or not beyond & {*judging_equations(joint, term)}:
            continue
        shapes = list(term.shapes(context))
        places = {(2 * k + 1) * len(shapes) // (2 * TRIALS) for k in range(TRIALS)}
        out += [_trial(name, shapes[k]) for k in sorted(places) if k < len(shapes)]
    return out


def _trial(name: str, shape: Shape) -> Candidate:
    none = np.zeros((0, 1))
    return Candidate(name, shape, np.ones(1), 0.0, 0.0, 0.0, none, np.zeros((0, 1, 1)), 0.0)
