"""Computes the uncertainty of a joint fit: intervals of effects from blocks of time, and
identifiability of nominal parameters.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.linear import (
    DERIVATIVE_STEP,
    Added,
    effect_derivatives,
    moved_parameters,
)
from identification.diagnosis.fit.stack import stack_of
from identification.diagnosis.result import Estimate
from identification.effects.effect import Context
from identification.estimate.parameter_table import WIDEST
from identification.numerics.spread import CONFIDENCE

APPROXIMATION_SHARE, APPROXIMATION_RAD = 0.02, 0.01
"""Half widths of the 90 % interval of the errors that approximate regressors cause in simulated
trials: as a share of a size, and of an angle, rad.
"""


def estimates(joint: Joint) -> tuple[dict[str, Estimate], ...]:
    """Return the parameters of each effect with 90 % intervals, from the scatter of the scores over
    blocks of time.

    The intervals include the errors due to approximate regressors, which are not in this scatter. A
    parameter that the fit selects from a list, such as a number of periods per turn, has an
    interval of zero width.

    The fields for units are empty, because the catalogue states the units.
    """
    if not joint.effects:
        return ()
    context = Context(joint.equations[0].views, joint.nominal)
    stack = stack_of(joint.equations, joint.nominal, joint.stack)
    columns = stack.projected(effect_derivatives(stack, joint.effects))
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    scaled = columns / scale
    bread = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    sums = stack.sums(scaled * joint.residual[:, None])
    covariance = bread @ (sums.T @ sums) @ bread / np.outer(scale, scale)
    wide = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(stack.blocks - columns.shape[1], 3)))
    out, at = [], 0
    for effect in joint.effects:
        moves = _parameters_after_steps(effect, context)
        part = covariance[at : at + len(moves), at : at + len(moves)]
        at += len(moves)
        values = effect.parameters(context)
        slopes = {
            name: np.array([move[name] - values[name] for move in moves]) / DERIVATIVE_STEP
            for name in values
        }
        half = {
            name: math.hypot(
                wide * math.sqrt(max(float(s @ part @ s), 0.0)),
                _approximation_error(name, values[name]),
            )
            if np.any(s != 0.0)
            else 0.0
            for name, s in slopes.items()
        }
        out.append(
            {name: Estimate(v, v - half[name], v + half[name], "") for name, v in values.items()}
        )
    return tuple(out)


def undetermined_size(joint: Joint, k: int) -> tuple[str, Estimate] | None:
    """Return name and estimate of a size of effect ``k`` whose interval contains zero, or None if
    there is no such size.

    Sizes are the parameters that are proportional to a coefficient of the effect, or to the
    reciprocal of a coefficient, such as a stiffness.
    """
    effect, sizes = joint.effects[k], estimates(joint)[k]
    if effect.term.size is not None:
        return None
    context = Context(joint.equations[0].views, joint.nominal)
    twice = effect.term.read(2.0 * np.array(effect.coefficients), effect.shape, context)
    for name, size in sizes.items():
        # The mass of a wrong weight and an efficiency change with the coefficient too, but are not
        # zero without the effect.
        ratio = twice[name] / size.value if size.value else 1.0
        sized = math.isclose(ratio, 2.0) or math.isclose(ratio, 0.5)
        if sized and size.low <= 0.0 <= size.high:
            return name, size
    return None


def _approximation_error(name: str, value: float) -> float:
    """Return the error of a parameter due to an approximate regressor, as a half width of 90 %."""
    return (
        APPROXIMATION_RAD
        if name.split("_")[0] in ("phase", "center", "zero", "rest")
        else APPROXIMATION_SHARE * abs(value)
    )


def identifiable(joint: Joint, name: str) -> bool:
    """Whether a nominal parameter is identifiable: its 90 % half width is below half its value (for
    a static level, half its rise; for a Stribeck speed, 0.5 in the logarithm).
    """
    nominal = joint.nominal
    torque = next(e for e in joint.equations if e.name == "torque")
    if name not in nominal.free:
        return True
    scale = np.linalg.norm(torque.tangent, axis=0)
    if not scale[nominal.free.index(name)] > 0.0:
        return False
    scaled = torque.tangent / np.where(scale > 0.0, scale, 1.0)
    spread = np.sqrt(
        np.maximum(np.diag(np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)), 0.0)
    )
    spread /= np.where(scale > 0.0, scale, 1.0)
    rows = joint.residual[joint.stack.part("torque")]
    noise = torque.sigma * max(1.0, float(np.sqrt(np.mean(rows**2))))
    half = (
        float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
        * noise
        * float(spread[nominal.free.index(name)])
    )
    if name in ("omega_sf", "omega_sL"):
        return half < WIDEST
    base = {"Ms": "Mc", "mu_s": "mu_c"}.get(name)
    size = nominal.get(name) - (nominal.get(base) if base else 0.0)
    return half < WIDEST * abs(size) or name == "offset"


def _parameters_after_steps(effect: Added, context: Context) -> list[dict[str, float]]:
    """Return the parameters of the effect after a small step along each column of
    :func:`effect_derivatives`.
    """
    moves = []
    coefficients = np.array(effect.coefficients)
    if effect.term.size is None:
        here = effect.term.read(coefficients, effect.shape, context)
        scale = float(np.max(np.abs(coefficients))) or 1.0
        for k in range(len(coefficients)):
            step = np.zeros(len(coefficients))
            step[k] = DERIVATIVE_STEP * scale
            there = effect.term.read(coefficients + step, effect.shape, context)
            moves.append(
                {name: value + (there[name] - value) / scale for name, value in here.items()}
            )
    for index, reach in effect.term.refine.items():
        moves.append(
            dict(
                effect.term.read(
                    coefficients,
                    moved_parameters(effect.shape, index, reach, DERIVATIVE_STEP),
                    context,
                )
            )
        )
    return moves
