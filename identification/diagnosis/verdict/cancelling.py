"""Tests whether two identified effects nearly cancel each other, so that their small sum resembles
a third effect.

For example, the torques of a linear spring and of a weight of opposite sign add to the torque of a
hardening spring. Each of the two torques is then many times greater than their sum, and the machine
has neither the linear spring nor the weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.rules import RULES
from identification.recording import Array


def cancelling_effects(joint: Joint) -> tuple[str, ...]:
    """Return the names of two effects whose contributions in one equation nearly cancel each other;
    empty if there is no such pair.

    The nominal tangent is projected out of the contributions.
    """
    stack = replace(joint.stack, effect_basis=np.zeros((len(joint.residual), 0)))
    made = []
    for effect in joint.effects:
        columns = stack.whitened(stack.columns(effect.term, effect.shape))
        made.append(stack.projected(columns @ np.array(effect.coefficients)[:, None])[:, 0])
    for equation in joint.equations:
        rows = joint.stack.part(equation.name)
        pair = _cancelling_pair([m[rows] for m in made])
        if pair:
            return tuple(joint.effects[k].term.name for k in pair)
    return ()


def _cancelling_pair(made: Sequence[Array]) -> tuple[int, ...]:
    for k, one in enumerate(made):
        for j in range(k):
            both = float(one @ one + made[j] @ made[j])
            total = one + made[j]
            if float(total @ total) < RULES.cancelled * both:
                return j, k
    return ()
