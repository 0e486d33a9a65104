"""Whether a fit's constants keep what it promises.

A fit is worth what is left once everything that the torque is linear in is free, to first order.
Constants have limits, and friction may not rise where it falls: what such a step promises is then
nobody's prediction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.diagnosis.linear import Added
from identification.diagnosis.stack import Stack
from identification.model.parameters import STRIBECK_TERMS
from identification.recording import Array

UNKEPT = 1.5
"""Mean square of the torque's mismatch with the constants that a fit ended at over that which it
promises, from which on it is no model. With right names it was 1.00 to 1.03 on eight simulated
rigs; 490 000 where friction had to rise.
"""


def promise(stack: Stack, effects: Sequence[Added], residual: Array) -> tuple[float, float]:
    """Return the mean square of the torque's mismatch over the noise's, as promised and as kept.

    Args:
        stack: At the nominal values that the fit ended at.
        effects: With their coefficients.
        residual: Whitened rows that the fit leaves with the constants free, shape (n,).
    """
    equation = next(e for e in stack.equations if e.name == "torque")
    rest = equation.residual.copy()
    for effect in effects:
        columns = stack.columns(effect.term, effect.shape).get("torque")
        if columns is not None:
            rest -= columns @ np.array(effect.coefficients)
    # The rotor's share of the inertia is no constant of the model.
    other = equation.tangent[:, [name not in stack.nominal.free for name in equation.names]]
    rest -= other @ np.linalg.lstsq(other, rest, rcond=None)[0]
    return float(np.mean(residual[stack.part("torque")] ** 2)), float(
        np.mean(rest**2)
    ) / equation.sigma**2


def risen(stack: Stack, effects: Sequence[Added]) -> float:
    """Return the mean square of the torque's mismatch over the noise's with the rises of friction
    toward rest held.

    All else that the torque is linear in is free. What real machines do at the slowest speeds asks
    for rises that no bench has, of which the effects named are no part.
    """
    equation = next(e for e in stack.equations if e.name == "torque")
    columns = {name: equation.tangent[:, k] for k, name in enumerate(equation.names)}
    for coulomb, static, speed in STRIBECK_TERMS:
        level, rise = columns.get(coulomb), columns.pop(static, None)
        if level is not None and rise is not None:
            columns[coulomb] = level + rise
        columns.pop(speed, None)
    own = [stack.columns(e.term, e.shape).get("torque") for e in effects]
    design = np.column_stack([*columns.values(), *(c for c in own if c is not None)])
    left = equation.residual - design @ np.linalg.lstsq(design, equation.residual, rcond=None)[0]
    return float(np.mean(left**2)) / equation.sigma**2


def unkept(promised: float, kept: float) -> bool:
    """Whether what the constants keep falls short of what was promised; never where it is hardly
    more than noise.
    """
    return kept > UNKEPT * max(promised, 1.0)
