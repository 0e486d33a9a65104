"""Finds effects that these recordings cannot distinguish from an identified effect, even if the
preference of the data is for one of them.

If the regressors of another effect explain all but a hundredth of the contribution of the
identified effect, the two fits differ by this hundredth only. On real machines the error of a
regressor is greater.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.diagnosis.fit.joint import Joint, nominal_after_effects
from identification.diagnosis.fit.linear import effect_derivatives
from identification.diagnosis.fit.stack import Stack, with_effect_basis
from identification.diagnosis.selection.comparison import Contender, Round, parameter_count
from identification.diagnosis.selection.crossing import distinguished_by_crossings
from identification.diagnosis.selection.removal import LEAST_FURTHER
from identification.diagnosis.selection.search import Search
from identification.effects.effect import Context, Effect
from identification.recording import Array


def with_indistinct_effects(found: Search, terms: Sequence[Effect]) -> Search:
    """Return the search with effects that these recordings cannot distinguish from an identified
    effect as further rivals. Such a rival is open, that is, not rejected.

    Args:
        found: The search.
        terms: Effects that were searched for.
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
    views, own = final.equations[0].views, final.effects[place]
    alike += own.term.indistinct(own.parameters(Context(views, final.nominal)), views)
    tested = {r.name for r in taken.rivals}
    rivals = [
        replace(r, preference=min(r.preference, 0.0)) if r.name in alike else r
        for r in taken.rivals
    ]
    rivals += [Contender(name, final, 0.0, "") for name in alike if name not in tested]
    return Round(taken.name, tuple(rivals))


def _indistinct_effects(final: Joint, place: int, terms: Sequence[Effect]) -> list[str]:
    """Return the effects that have no more parameters than an identified effect, and whose
    regressors, at one set of trial parameters, contain the contribution of the identified effect.

    A gap and a loop are distinguished by the torque during crossings, which no regressor contains.
    """
    own = final.effects[place]
    stack = _stack_of_one_effect(final, place)
    columns = stack.columns(own.term, own.shape)
    if not columns:
        return []
    made = stack.projected(stack.whitened(columns) @ np.array(own.coefficients)[:, None])[:, 0]
    others = [e for k, e in enumerate(final.effects) if k != place]
    # Regressors that depend on the drive's torque must not contain the torque of the identified
    # effect.
    without = replace(stack, nominal=nominal_after_effects(final.nominal, others), own={})
    context = Context(final.equations[0].views, without.nominal)
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
            if _unexplained_share(stack, made, its) <= LEAST_FURTHER:
                found.append(term.name)
                break
    return found


def _stack_of_one_effect(final: Joint, place: int) -> Stack:
    """Return the stack with the nominal tangent and all effects except one projected out."""
    bare = replace(final.stack, effect_basis=np.zeros((len(final.stack.residual), 0)))
    others = [e for k, e in enumerate(final.effects) if k != place]
    return with_effect_basis(bare, effect_derivatives(bare, others)) if others else bare


def _unexplained_share(stack: Stack, made: Array, columns: Mapping[str, Array]) -> float:
    """Return the share of the squares of a contribution, shape (n,), that regressors do not
    explain. The nominal tangent and the effect basis are projected out of contribution and
    regressors.
    """
    whole = stack.whitened(columns)
    square = whole.T @ whole
    for equation, basis in zip(stack.equations, stack.basis, strict=True):
        if equation.name in columns:
            along = basis.T @ whole[stack.part(equation.name)]
            square -= along.T @ along
    along = stack.effect_basis.T @ whole
    square -= along.T @ along
    score = whole.T @ made
    contained = float(score @ np.linalg.pinv(square, rcond=1e-9, hermitian=True) @ score)
    return 1.0 - contained / max(float(made @ made), 1e-300)
