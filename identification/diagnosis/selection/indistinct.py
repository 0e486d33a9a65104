"""Effects that these recordings cannot distinguish from an identified one, whatever the fit says.

An effect whose regressors contain all but a hundredth of the identified effect's contribution can
lose only by that hundredth, and regressors of real machines are not that exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.diagnosis.fit.joint import Joint, told
from identification.diagnosis.fit.linear import directions
from identification.diagnosis.fit.stack import Stack, granting
from identification.diagnosis.selection.comparison import Contender, Round, numbers
from identification.diagnosis.selection.crossing import PAIR
from identification.diagnosis.selection.removal import LEAST_FURTHER
from identification.diagnosis.selection.search import Search
from identification.diagnosis.terms.term import Context, Term
from identification.recording import Array


def opened(found: Search, terms: Sequence[Term]) -> Search:
    """Return a search in which no effect is preferred to one from which these recordings cannot
    distinguish it.

    Args:
        found: The search.
        terms: Effects that were sought.
    """
    places = {e.term.name: k for k, e in enumerate(found.final.effects)}
    rounds = tuple(
        _opened(found.final, places[r.name], r, terms) if r.name in places else r
        for r in found.rounds
    )
    return replace(found, rounds=rounds)


def _opened(final: Joint, place: int, taken: Round, terms: Sequence[Term]) -> Round:
    alike = _indistinct(final, place, terms)
    tested = {r.name for r in taken.rivals}
    rivals = [
        replace(r, preference=min(r.preference, 0.0)) if r.name in alike else r
        for r in taken.rivals
    ]
    rivals += [Contender(name, final, 0.0, "") for name in alike if name not in tested]
    return Round(taken.name, tuple(rivals))


def _indistinct(final: Joint, place: int, terms: Sequence[Term]) -> list[str]:
    """Return the effects with no more numbers than an identified one whose regressors, at one of
    their trial shapes, contain its contribution.

    The torque of a crossing, by which a gap and a loop are distinguished, is in no regressor.
    """
    own = final.effects[place]
    stack = _beside_others(final, place)
    columns = stack.columns(own.term, own.shape)
    if not columns:
        return []
    made = stack.projected(stack.whitened(columns) @ np.array(own.coefficients)[:, None])[:, 0]
    others = [e for k, e in enumerate(final.effects) if k != place]
    # Regressors that follow the drive's torque must not contain the effect's own torque.
    without = replace(stack, nominal=told(final.nominal, others), own={})
    context = Context(final.equations[0].views, without.nominal)
    found = []
    for term in terms:
        if term.name == own.term.name or {own.term.name, term.name} == set(PAIR):
            continue
        if not columns.keys() & term.columns.keys():
            continue
        for shape in term.shapes(context):
            its = without.columns(term, shape)
            width = max((c.shape[1] for c in its.values()), default=0)
            if not width or term.freedom + width > numbers(own):
                continue
            if _left(stack, made, its) <= LEAST_FURTHER:
                found.append(term.name)
                break
    return found


def _beside_others(final: Joint, place: int) -> Stack:
    """Return the stack with the nominal tangent and all effects but one projected out."""
    bare = replace(final.stack, granted=np.zeros((len(final.stack.residual), 0)))
    others = [e for k, e in enumerate(final.effects) if k != place]
    return granting(bare, directions(bare, others)) if others else bare


def _left(stack: Stack, made: Array, columns: Mapping[str, Array]) -> float:
    """Return the share of the squares of a contribution, shape (n,), that regressors do not
    contain; the nominal tangent and the granted columns are projected out of both.
    """
    whole = stack.whitened(columns)
    square = whole.T @ whole
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        if equation.name in columns:
            along = basis.T @ whole[stack.part(equation.name)]
            square -= along.T @ along
    along = stack.granted.T @ whole
    square -= along.T @ along
    score = whole.T @ made
    contained = float(score @ np.linalg.pinv(square, rcond=1e-9, hermitian=True) @ score)
    return 1.0 - contained / max(float(made @ made), 1e-300)
