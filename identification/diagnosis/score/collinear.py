"""Finds effects that are collinear with the nominal model, so that recordings with these loads and
channels cannot show them.

For example, if friction is the only load, a gear with 80 % efficiency is equivalent to nominal
parameters that are larger by 1/0.8.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.rules import RULES
from identification.effects.effect import Context, Effect


def collinear_effects(baseline: Joint, terms: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names of effects that are collinear with the nominal tangent, whatever their size.

    Only effects without nonlinear parameters are tested, because an effect with several trial
    parameters is not collinear at all of them. The breakaway equation is not used, because its
    tangent includes the delay of the breakaway.

    Args:
        baseline: Fit of the nominal model.
        terms: Terms of the effects that were tried.
    """
    context = Context(baseline.equations[0].views, baseline.nominal)
    stack = baseline.stack
    judging = np.ones(len(stack.residual), dtype=bool)
    for equation in stack.equations:
        judging[stack.part(equation.name)] = equation.judges
    found = []
    for term in terms:
        shapes = list(term.shapes(context))
        columns = stack.columns(term, shapes[0]) if len(shapes) == 1 else {}
        if not columns:
            continue
        whole = stack.whitened(columns)
        before, after = (
            np.linalg.norm(rows[judging], axis=0) for rows in (whole, stack.projected(whole))
        )
        if np.all(before > 0.0) and np.all(after < RULES.collinear_below * before):
            found.append(term.name)
    return tuple(found)
