"""The part of a fit that is due to one of its effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.diagnosis.fit.joint import Joint, nominal_after_effects, start_fit
from identification.diagnosis.fit.linear import Added, effect_derivatives
from identification.diagnosis.fit.stack import Stack, stack_of, with_effect_basis
from identification.diagnosis.rows.equations import equations
from identification.recording import Array
from identification.views.nominal import Nominal

SET_BY_EFFECTS = ("fitted_alpha", "presliding_stiffness", "late_s")
"""Nominal values that an effect sets at the start of a fit (`Effect.begin`)."""


def contribution(stack: Stack, effect: Added) -> Array:
    """Return the whitened contribution of an effect, shape (n,)."""
    columns = stack.whitened(stack.columns(effect.term, effect.shape))
    return np.asarray(columns @ np.array(effect.coefficients))


def without_effect(joint: Joint, k: int) -> Stack:
    """Return the stack of a fit in which effect ``k`` is missing: its residual contains this
    effect; the nominal tangent and the other effects are projected out.
    """
    others = tuple(e for j, e in enumerate(joint.effects) if j != k)
    views, unit = joint.equations[0].views, joint.equations[0].unit
    nominal = nominal_after_effects(_without_own_values(joint.nominal, joint.effects[k]), others)
    rows = equations(views, nominal, unit, joint.stack.equations)
    bare = stack_of(rows, nominal, joint.stack)
    left = np.concatenate([e.residual / e.sigma for e in rows])
    for effect in others:
        left = left - contribution(bare, effect)
    bare = replace(bare, residual=bare.projected(left[:, None])[:, 0])
    return with_effect_basis(bare, effect_derivatives(bare, others))


def _without_own_values(nominal: Nominal, effect: Added) -> Nominal:
    """Return the nominal values without those that the effect has set."""
    bare, _ = start_fit(nominal, ())
    begun, _ = effect.term.begin(bare, effect.shape)
    own = [name for name in SET_BY_EFFECTS if getattr(begun, name) != getattr(bare, name)]
    return replace(nominal, **{name: getattr(bare, name) for name in own})
