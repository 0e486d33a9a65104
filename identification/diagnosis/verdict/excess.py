"""Compares the mismatch of each equation by the nominal and by the corrected model, and judges
whether the effects explain enough of the mismatch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.diagnosis.rows.equations import AT_INSTANTS
from identification.diagnosis.rules import RULES
from identification.diagnosis.score.significance import greatest_mean_square, level
from identification.diagnosis.selection.search import Search
from identification.diagnosis.verdict.hysteretic import is_hysteretic


@dataclass(frozen=True)
class Excess:
    """Mean square of an equation's whitened mismatch, by the nominal and by the corrected model."""

    equation: str
    before: float
    after: float

    @property
    def explained(self) -> float:
        """Share of the power beyond the noise that the effects explain."""
        beyond = max(self.before - 1.0, 1e-12)
        return min(1.0, max(0.0, (self.before - max(self.after, 1.0)) / beyond))


def excess_of(found: Search) -> list[Excess]:
    """Return the mean-square mismatch of each equation by the nominal and by the corrected
    model.
    """
    stack = found.baseline.stack
    out = []
    for equation in found.baseline.equations:
        rows = stack.part(equation.name)
        before, after = (
            float(np.mean(j.residual[rows] ** 2)) for j in (found.baseline, found.final)
        )
        out.append(Excess(equation.name, before, after))
    return out


def explains_nearly_all(found: Search) -> bool:
    """Whether the effects explain at least the share of the mismatch beyond the noise that right
    effects explain (`nearly_complete`).
    """
    return judged_equation(found).explained >= RULES.nearly_complete


def equations_of_effects(found: Search) -> set[str]:
    """Return the names of the equations in which the accepted effects appear."""
    return {name for effect in found.final.effects for name in effect.term.columns}


def judged_equation(found: Search) -> Excess:
    """Return the equation with the greatest mismatch beyond the noise.

    Only the torque equation and the equations in which an accepted effect appears are compared, if
    one of them has a mismatch. A mismatch in any other equation has another cause, and is reported
    in addition to the identified effects.
    """
    judges = [e for e in excess_of(found) if e.equation not in AT_INSTANTS]
    acting = equations_of_effects(found) | {"torque"}
    judges = [e for e in judges if e.equation in acting] or judges
    return max(judges, key=lambda e: (e.before - 1.0) * _rows(found, e.equation))


def insufficient(found: Search, share: float = RULES.adequate) -> bool:
    """Whether the effects explain less than ``share`` of the mismatch beyond the noise."""
    worst = judged_equation(found)
    equation = next(e for e in found.final.equations if e.name == worst.equation)
    left = (
        worst.after > RULES.excess * level(equation)
        or greatest_mean_square(found.final, equation) > RULES.excess_of_one
    )
    return worst.explained < share and left


def _rows(found: Search, equation: str) -> int:
    rows = found.baseline.stack.part(equation)
    return int(rows.stop - rows.start)


def hysteretic_remainder(found: Search) -> bool:
    """Whether the effects explain less of the torque mismatch than right effects would
    (`nearly_complete`), and the remaining mismatch is hysteretic.
    """
    torque = next(e for e in excess_of(found) if e.equation == "torque")
    return torque.explained < RULES.nearly_complete and is_hysteretic(found.final)
