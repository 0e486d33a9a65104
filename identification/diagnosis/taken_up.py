"""Effects that the nominal constants take up whole, so that no recording of this kind can show
them.

A gear that passes 80 % of the torque, and friction is all its load, is a bench whose constants are
all 1/0.8 as large.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.diagnosis.joint import Joint
from identification.diagnosis.stack import ABSORBED
from identification.diagnosis.terms.term import Context, Term


def taken_up(baseline: Joint, terms: Sequence[Term]) -> tuple[str, ...]:
    """Return the names of effects of which the nominal tangent leaves nothing, whatever their size.

    Only effects of one shape are asked: what has several does not fit into the nominal model's with
    all of them. Breakaways are not: their tangent allows for lateness, which no effect does.

    Args:
        baseline: The nominal model's fit.
        terms: Of the effects that were sought.
    """
    context = Context(baseline.equations[0].views, baseline.nominal)
    stack = baseline.stack
    judging = np.ones(len(stack.residual), dtype=bool)
    judging[stack.part("breakaway")] = False
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
        if np.all(before > 0.0) and np.all(after < ABSORBED * before):
            found.append(term.name)
    return tuple(found)
