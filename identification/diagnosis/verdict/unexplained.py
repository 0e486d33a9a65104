"""Texts on what the effects leave unexplained."""

from __future__ import annotations

import math

import numpy as np

from identification.diagnosis.catalogue.entry import title
from identification.diagnosis.fit.within_limits import infeasible
from identification.diagnosis.result import Verdict
from identification.diagnosis.rules import RULES
from identification.diagnosis.selection.search import Search
from identification.diagnosis.verdict.cancelling import cancelling_effects
from identification.diagnosis.verdict.judgement import (
    effects_of,
    equations_of_effects,
    excess_of,
    hysteretic_remainder,
    little_unseen,
    main_equation,
)
from identification.diagnosis.verdict.one_direction import direction_dependent


def unexplained(found: Search, verdict: Verdict, rng: np.random.Generator) -> tuple[str, ...]:
    """Return all texts on what the effects leave unexplained.

    Args:
        found: The search.
        verdict: Its verdict.
        rng: Random generator for the bands of the maps.
    """
    return (*_insufficient_effects(found, verdict, rng), *unexplained_equations(found, verdict))


def _insufficient_effects(
    found: Search, verdict: Verdict, rng: np.random.Generator
) -> tuple[str, ...]:
    """Return texts on effects that explain only a part of a mismatch outside the catalogue, or only
    one direction of motion.
    """
    if verdict is not Verdict.OUTSIDE_CATALOGUE or not found.final.effects:
        return ()
    lopsided = direction_dependent(found.final)
    if lopsided:
        return tuple(
            f"{title(n)} would explain the mismatch only with a different size in each "
            "direction of motion"
            for n in lopsided
        )
    cancelling = cancelling_effects(found.final)
    if cancelling:
        one, other = (title(n) for n in cancelling)
        return (
            f"{one} and {other.lower()} would explain the mismatch only if each is at "
            "least about twice their sum: they nearly cancel",
        )
    if infeasible(found.final):
        return ()
    share = next(e.explained for e in excess_of(found) if e.equation == main_equation(found).name)
    words = "; and ".join(e.statement for e in effects_of(found, rng))
    if share >= RULES.adequate:
        if not hysteretic_remainder(found):
            return ()
        return (
            f"{100.0 * share:.0f} % of the mismatch beyond the noise would be explained, if "
            f"{words}; but the rest depends on the travel or time since each reversal, which these "
            "effects do not",
        )
    return (
        f"the catalogue explains only {100.0 * share:.0f} % of the mismatch beyond the noise (at "
        f"least {100.0 * RULES.adequate:.0f} % are needed), if {words}",
    )


def unexplained_equations(found: Search, verdict: Verdict) -> tuple[str, ...]:
    """Return texts on equations in which more than noise is left and no identified effect acts, and
    on recordings set aside in which the effects explain too little.
    """
    if verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
        return ()
    acting = equations_of_effects(found)
    of = {e.name: e for e in found.final.equations}
    unseen = (
        f"on recordings set aside only {100.0 * (found.unseen_share or 0.0):.0f} % of the mismatch "
        "beyond the noise is explained"
    )
    return (
        *((unseen,) if little_unseen(found) else ()),
        *(
            f"the {e.equation} equation has a further mismatch that no effect explains: "
            f"{math.sqrt(e.after) * of[e.equation].sigma:.3g} {of[e.equation].unit} rms; "
            f"noise floor {of[e.equation].sigma:.3g}"
            for e in excess_of(found)
            if e.equation not in ("breakaway", *acting) and e.after > RULES.excess
        ),
    )
