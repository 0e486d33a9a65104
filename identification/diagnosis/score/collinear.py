"""Effects that are collinear with the nominal model, so that no recording of this kind can show
them.

For example, if friction is the only load, a gear with 80 % efficiency is equivalent to constants
larger by 1/0.8.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.stack import ABSORBED
from identification.diagnosis.terms.term import Context, Term


def taken_up(baseline: Joint, terms: Sequence[Term]) -> tuple[str, ...]:
    """Return the names of effects that the nominal tangent absorbs completely, whatever their size.

    Only effects with one shape are tested; of several shapes, not all can be collinear with the
    nominal model. Breakaways are not tested, since their tangent includes lateness.

    Args:
        baseline: Fit of the nominal model.
        terms: Terms of the effects that were tried.
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
