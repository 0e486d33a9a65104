"""Computes the estimating equation of the inertia, with all other unknowns eliminated (M30-M32).

The instrument of the inertia is made orthogonal to the instruments of all other unknowns, so that
errors of these unknowns have an effect of second order only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimate.inertia.half_cycles import Replicate
from identification.estimate.inertia.instruments import instruments, replicate_instruments
from identification.filter.likelihood import Point
from identification.filter.noise_level import HUBER_THRESHOLD
from identification.model.parameters import INERTIA
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.levenberg_marquardt import huber_weight


@dataclass(frozen=True)
class Equation:
    """The linearised estimating equation of the inertia, as a sum of contributions of the
    residuals.

    Attributes:
        influence: Decrease of the logarithm of the inertia per unit of each residual, shape (r,).
        parts: Decrease of the logarithm of the inertia due to each residual: directly, and by its
            effect on the instruments of other segments, shape (r,).
    """

    influence: Array
    parts: Array


def influence_on_inertia(
    point: Point, z: BlockArrow, jacobian: BlockArrow, residual: Array
) -> Array:
    """Return the decrease of the logarithm of the inertia per unit of each residual (M30), shape
    (r,).
    """
    return z.along(_mixture(point, z, jacobian, residual))


def _mixture(point: Point, z: BlockArrow, jacobian: BlockArrow, residual: Array) -> Array:
    """Return the weights of the combination of instruments whose estimating equation depends on the
    inertia only, and has unit slope in the logarithm of the inertia, shape (p + m,).
    """
    j = point.free.index(INERTIA)
    power = z.product()
    others = np.delete(power, j, axis=0)
    taken = np.linalg.pinv(np.delete(others, j, axis=1), hermitian=True) @ others[:, j]
    alone = np.insert(-taken, j, 1.0)
    return alone / float(
        z.along(alone) @ (jacobian.parameters[:, j] * huber_weight(residual, HUBER_THRESHOLD))
    )


def equation(point: Point, z: BlockArrow, jacobian: BlockArrow, residual: Array) -> Equation:
    """Return the estimating equation of the inertia with instruments that do not depend on the
    residuals.
    """
    influence = influence_on_inertia(point, z, jacobian, residual)
    return Equation(influence, influence * residual * huber_weight(residual, HUBER_THRESHOLD))


def equation_of_half_cycles(
    point: Point, z: BlockArrow, jacobian: BlockArrow, residual: Array
) -> Equation:
    """Return the estimating equation of the inertia with instruments from matching half cycles; the
    equation is a sum over pairs of segments.

    Each segment adds two terms to the equation: one with its residuals, and one with its
    sensitivities, because the sensitivities of a segment are part of the instruments of other
    segments (Hoeffding, Annals of Mathematical Statistics 19 (1948) 293).
    """
    j = point.free.index(INERTIA)
    first = equation(point, z, jacobian, residual)
    weighted = residual * huber_weight(residual, HUBER_THRESHOLD)
    columns = np.zeros_like(jacobian.parameters)
    columns[:, j] = weighted
    carrier = replace(jacobian, parameters=columns, own=np.zeros_like(weighted))
    mixed = _mixture(point, z, jacobian, residual)
    second = jacobian.along(mixed) * instruments(point, carrier).parameters[:, j]
    second[len(second) - point.breakaways :] = 0.0
    return replace(first, parts=first.parts + second)


def least_variance(one: Equation, other: Equation) -> Equation:
    """Return the weighted mean of two equations for one unknown that has the least variance (M32),
    with nonnegative weights.
    """
    a, b = one.influence, other.influence
    away = a - b
    share = float(np.clip(-(b @ away) / max(float(away @ away), 1e-300), 0.0, 1.0))
    return Equation(b + share * away, other.parts + share * (one.parts - other.parts))


def combined_equation(
    point: Point,
    z: BlockArrow,
    jacobian: BlockArrow,
    residual: Array,
    replicates: Sequence[Replicate],
) -> Equation:
    """Return the least-variance combination of two estimating equations of the inertia: with
    instruments from matching half cycles, and with instruments from replicates (M32).

    Args:
        point: Point at which the sensitivities are computed.
        z: Instruments from matching half cycles.
        jacobian: d residuals / d x at the point.
        residual: Residuals at the point.
        replicates: Replicates; empty to use matching half cycles alone.
    """
    half_cycles = equation_of_half_cycles(point, z, jacobian, residual)
    if not replicates:
        return half_cycles
    other = replicate_instruments(point, z, replicates)
    return least_variance(half_cycles, equation(point, other, jacobian, residual))
