"""Tests whether a fit is feasible: compares the predicted with the attained residual.

Effects are compared by the residual that the linear step of a fit predicts. Nominal parameters have
limits, and static friction may not be below Coulomb friction: a residual that is predicted for
values beyond these limits cannot be attained.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.diagnosis.fit.linear import Added
from identification.diagnosis.fit.stack import Stack
from identification.diagnosis.rules import RULES
from identification.model.parameters import STRIBECK_TERMS
from identification.recording import Array


def predicted_and_attained(
    stack: Stack, effects: Sequence[Added], residual: Array
) -> tuple[float, float]:
    """Return the predicted and the attained mean-square torque mismatch, relative to the mean
    square of the noise.

    Args:
        stack: Stack at the nominal values at the end of the fit.
        effects: Effects with their coefficients.
        residual: Whitened residual of the fit with the nominal parameters free, shape (n,).
    """
    equation = next(e for e in stack.equations if e.name == "torque")
    rest = equation.residual.copy()
    for effect in effects:
        columns = stack.columns(effect.term, effect.shape).get("torque")
        if columns is not None:
            rest -= columns @ np.array(effect.coefficients)
    # The rotor's share of the inertia is not a nominal parameter.
    other = equation.tangent[:, [name not in stack.nominal.free for name in equation.names]]
    rest -= other @ np.linalg.lstsq(other, rest, rcond=None)[0]
    return float(np.mean(residual[stack.part("torque")] ** 2)), float(
        np.mean(rest**2)
    ) / equation.sigma**2


def with_rises_held(stack: Stack, effects: Sequence[Added]) -> float:
    """Return the mean-square torque mismatch, relative to the mean square of the noise, of a fit
    with fixed rises of static over Coulomb friction.

    All other parameters in which the torque is linear are free. The rises are fixed, because the
    friction of real machines at the slowest speeds may require rises below zero, whatever effects
    are identified.
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


def is_infeasible(predicted: float, attained: float) -> bool:
    """Whether a fit is infeasible: the attained mean-square mismatch is more than `infeasible`
    times the predicted mean-square mismatch, and more than `infeasible` times that of the noise.
    """
    return attained > RULES.infeasible * max(predicted, 1.0)
