"""Evaluates the nominal model at given values of its parameters, such as those of ``rig identify``,
in the form of a fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.stack import stack_of
from identification.diagnosis.rows.equations import Equation, equations
from identification.recording import Array
from identification.views.view import View


def nominal_at(views: Sequence[View], unit: str, like: Joint, values: Mapping[str, float]) -> Joint:
    """Return the nominal model at given values of its parameters, with the residual of every
    equation.

    Args:
        views: The fitted recordings.
        unit: Unit of the torque.
        like: A fit of the nominal model to these recordings; its noise and its blocks of rows are
            used.
        values: Name to value; nominal parameters that are not named keep their fitted values.
    """
    known = {n: v for n, v in values.items() if n in like.nominal.values}
    nominal = replace(like.nominal, values={**like.nominal.values, **known})
    stack = stack_of(equations(views, nominal, unit, like.stack.equations), nominal, like.stack)
    residual = np.concatenate([_remaining(e, nominal.free) / e.sigma for e in stack.equations])
    return Joint(nominal, (), stack.equations, residual, stack)


def _remaining(equation: Equation, given: Sequence[str]) -> Array:
    """Return the residual of an equation after a linear fit of the parameters that are not given.

    In the torque equation only the rotor's share of the inertia is fitted. In every other equation
    all parameters are fitted, because none of them is a nominal parameter, such as the zero of an
    encoder.
    """
    held = given if equation.name == "torque" else ()
    other = equation.tangent[:, [name not in held for name in equation.names]]
    if not other.shape[1]:
        return equation.residual
    return np.asarray(
        equation.residual - other @ np.linalg.lstsq(other, equation.residual, rcond=None)[0]
    )
