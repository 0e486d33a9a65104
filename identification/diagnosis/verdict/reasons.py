"""Reasons why effects do not explain a mismatch, or why the verdict is *nothing missing* in spite
of a mismatch.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from identification.diagnosis.fit.within_limits import infeasible
from identification.diagnosis.rules import RULES
from identification.diagnosis.selection.search import Search
from identification.diagnosis.verdict.cancelling import cancelling_effects
from identification.diagnosis.verdict.excess import hysteretic_remainder, insufficient
from identification.diagnosis.verdict.one_direction import direction_dependent


class Kind(Enum):
    """Kinds of reasons."""

    NO_EFFECT = "no effect was accepted"
    ONE_DIRECTION = "an effect needs a different size in each direction of motion"
    CANCELLING = "two effects nearly cancel"
    INFEASIBLE = "nominal parameters would be outside their physical limits"
    TOO_LITTLE = "the effects explain too little of the mismatch"
    BETWEEN_SAMPLES = "values between the samples may cause the mismatch"
    REVERSALS = "the remaining mismatch depends on travel or time since each reversal"


@dataclass(frozen=True)
class Reason:
    """Reason why the effects of a search do not explain the mismatch, or why the verdict is
    *nothing missing* in spite of a mismatch.

    Attributes:
        kind: Kind of the reason.
        search: The search whose effects the reason concerns.
        effects: Names of the effects; empty if no effect was accepted.
        needed: Share of the mismatch beyond the noise that the effects must explain.
    """

    kind: Kind
    search: Search
    effects: tuple[str, ...] = ()
    needed: float = RULES.adequate


def reason_outside(found: Search, searched: Search) -> Reason | None:
    """Return the first reason why the effects do not explain the mismatch, or None if they explain
    it.

    Args:
        found: The search with its fits within their limits and the accepted effects.
        searched: The search before effects were dropped. The effects before and after dropping must
            explain enough of the mismatch.
    """
    names, before = _names(found), _names(searched)
    if not names:
        return Reason(Kind.NO_EFFECT, found)
    for kind, of in (
        (Kind.ONE_DIRECTION, direction_dependent),
        (Kind.CANCELLING, cancelling_effects),
    ):
        concerned = of(found.final)
        if concerned:
            return Reason(kind, found, concerned)
    if infeasible(searched.final):
        return Reason(Kind.INFEASIBLE, searched, before)
    if insufficient(searched):
        return Reason(Kind.TOO_LITTLE, searched, before)
    least = RULES.adequate_after_removal
    if set(names) != set(before) and insufficient(found, least):
        return Reason(Kind.TOO_LITTLE, found, names, least)
    if hysteretic_remainder(searched):
        return Reason(Kind.REVERSALS, searched, before)
    return None


def _names(found: Search) -> tuple[str, ...]:
    """Return the names of a search's effects."""
    return tuple(e.term.name for e in found.final.effects)
