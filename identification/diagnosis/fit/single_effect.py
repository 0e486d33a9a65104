"""The part of a fit that is due to one of its effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.linear import effect_derivatives
from identification.diagnosis.fit.stack import Stack, with_effect_basis
from identification.recording import Array


def contribution(joint: Joint, k: int) -> Array:
    """Return the whitened contribution of effect ``k``, shape (n,)."""
    effect, stack = joint.effects[k], joint.stack
    columns = stack.whitened(stack.columns(effect.term, effect.shape))
    return np.asarray(columns @ np.array(effect.coefficients))


def without_effect(joint: Joint, k: int) -> Stack:
    """Return the stack of a fit whose residual contains the contribution of effect ``k``; the
    nominal tangent and the other effects are projected out.
    """
    n = len(joint.residual)
    bare = replace(joint.stack, effect_basis=np.zeros((n, 0)))
    others = tuple(e for j, e in enumerate(joint.effects) if j != k)
    left = bare.projected((joint.residual + contribution(joint, k))[:, None])[:, 0]
    return with_effect_basis(replace(bare, residual=left), effect_derivatives(bare, others))
