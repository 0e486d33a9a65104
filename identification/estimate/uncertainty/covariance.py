"""Computes the covariance of the likelihood estimate and its Cramer-Rao bound (M38-M41)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.inertia.half_cycles import Replicate
from identification.estimate.inertia.inertia_equation import combined_equation
from identification.estimate.inertia.instruments import instruments
from identification.estimate.uncertainty.cramer_rao import (
    bound,
    matching_means,
    replicate_bound,
    replicate_information,
)
from identification.filter.likelihood import Point
from identification.filter.noise_level import HUBER_THRESHOLD
from identification.model.parameters import INDEX, INERTIA, LOGARITHMIC
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.least_squares import equilibrated
from identification.numerics.levenberg_marquardt import huber_weight
from identification.numerics.two_threads import each

_PRIOR, _REPLICATE_PRIOR = 1.0, 16.0
"""Weight of the prior of the scatter (M41), as a number of segments: without and with
replicates.
"""
_FARTHEST = 1.0
"""Change of the logarithm of a parameter above which the parameter is not changed together with the
inertia: the linearisation is invalid, because the parameter is not identifiable (for example a
Stribeck speed below all sampled speeds).
"""


@dataclass(frozen=True)
class Covariances:
    """Covariance of the free parameters and its Cramer-Rao bound, in the units of the free vector,
    shape (p, p).

    Attributes:
        achieved: Covariance with the inertia at the solution of its estimating equation.
        floor: Cramer-Rao bound.
        step: Step of the free parameters to the solution of this equation; the other parameters
            change with the inertia, shape (p,).
    """

    achieved: Array
    floor: Array
    step: Array


def covariances(point: Point, replicates: Sequence[Replicate] = ()) -> Covariances:
    """Return the achieved covariance of the free parameters and its Cramer-Rao bound at a point.

    The variance of the inertia is that of its estimating equation; the other parameters change with
    the inertia (M39). The standard deviation of each parameter is scaled by the scatter of its
    scores from segment to segment (M40, M41, and Liang and Zeger, Biometrika 73 (1986) 13); the
    scaling never reduces the variance of the inertia.

    Args:
        point: Point at the estimate.
        replicates: Replicates of the experiment at the estimate, for the bound, the prior of the
            scatter, and instruments of the inertia.
    """
    x = point.origin()
    held = point.weighted()
    residual = held.residuals(x)
    jacobian = held.jacobian(x, residual)
    z = instruments(point, jacobian)
    count = len(point.free)
    least = bound(matching_means(jacobian, z, point.experiment.matching_count))[:count, :count]
    reached, floor = _replicate_bounds(point, jacobian, replicates) or (least, least)
    units = np.array([point.vector[k] if k in LOGARITHMIC else 1.0 for k in point.free])
    scale = np.outer(units, units)
    step = np.zeros(count)
    if INERTIA not in point.free:
        spread, achieved = _spread(jacobian, residual, [r.inflated() for r in replicates]), reached
    else:
        j = point.free.index(INERTIA)
        equation = combined_equation(point, z, jacobian, residual, replicates)
        influence, weighted = equation.influence, residual * huber_weight(residual, HUBER_THRESHOLD)
        step = -float(influence @ weighted) * least[:, j] / least[j, j]
        step[
            [k in LOGARITHMIC and abs(s) > _FARTHEST for k, s in zip(point.free, step, strict=True)]
        ] = 0.0
        variance = float(influence @ influence) * max(float(np.mean(residual**2)), 1.0)
        achieved = _beside_inertia(reached, j, variance)
        inflated = [
            (slopes.without(j), errors) for slopes, errors in (r.inflated() for r in replicates)
        ]
        spread = _spread(jacobian.without(j), residual, inflated)
        scatter = np.linalg.norm(np.bincount(point.owners, equation.parts)) / np.linalg.norm(
            influence * weighted
        )
        spread = np.insert(spread, j, max(float(scatter), 1.0))
    return Covariances(achieved * np.outer(spread, spread) * scale, floor * scale, step)


def _replicate_bounds(
    point: Point, jacobian: BlockArrow, replicates: Sequence[Replicate]
) -> tuple[Array, Array] | None:
    """Return the Cramer-Rao bound with and without variance inflation, shape (p, p) each, or None
    if the information from the replicates is singular.

    The floor (M38) is the bound without variance inflation, which is a choice of the estimator.
    """
    if not replicates:
        return None
    uninflated = jacobian.scaled(point.inflation[point.owners])
    matching = matching_means(
        uninflated, instruments(point, uninflated), point.experiment.matching_count
    )
    information = replicate_information(point, matching, replicates)
    inflated, plain = (
        replicate_bound(information / f[:, None, None] ** 2)
        for f in (point.inflation, np.ones(len(information)))
    )
    return None if inflated is None or plain is None else (inflated, plain)


def _beside_inertia(floor: Array, j: int, variance: float) -> Array:
    """Return the least-squares covariance with the given variance of the ``j``-th parameter, the
    inertia (M39).
    """
    others = [k for k in range(len(floor)) if k != j]
    known = np.ix_(others, others)
    follow = floor[others, j] / floor[j, j]
    out = np.empty_like(floor)
    out[known] = floor[known] + np.outer(follow, follow) * (variance - floor[j, j])
    out[others, j] = out[j, others] = follow * variance
    out[j, j] = variance
    return out


def _spread(
    jacobian: BlockArrow, residual: Array, replicates: Sequence[tuple[BlockArrow, Array]]
) -> Array:
    """Return the ratio of the standard deviation of the scores between segments to the standard
    deviation by the noise model, shape (p,) (M41).

    A recording has few segments; therefore the ratio is combined with its mean over replicates, or
    with one if there are no replicates. The ratio may be below one, because the drive's loop
    compensates part of the current noise within a segment.

    Args:
        jacobian: Jacobian of the residuals.
        residual: Residuals, shape (r,).
        replicates: Jacobian and residuals of each replicate.
    """
    ratio, segments = _scatter(jacobian, residual)
    prior, worth = np.ones_like(ratio), _PRIOR
    if replicates:
        ratios = each(lambda replicate: _scatter(*replicate)[0], replicates)
        prior, worth = np.mean(ratios, axis=0), _REPLICATE_PRIOR
    return np.asarray(np.sqrt((worth * prior + segments * ratio) / (worth + segments)))


def _scatter(jacobian: BlockArrow, residual: Array) -> tuple[Array, Array]:
    """Return for each parameter the ratio of the variance of its estimate from the scatter of the
    segments' scores to the variance by the noise model, and the effective number of segments, shape
    (p,) each (M40).

    The mean of the scores is subtracted, so that a distance of the point from the least-squares
    estimate does not count as scatter.
    """
    weight = huber_weight(residual, HUBER_THRESHOLD)
    normal, scale = equilibrated(jacobian.product(weight))
    # The information of a segment on its breakaway time may be zero.
    inverse = np.linalg.pinv(normal, hermitian=True) / scale[:, None]
    influence = jacobian.along(inverse[:, : jacobian.parameters.shape[1]])
    plain = jacobian.by_block(np.ones(len(residual)), influence**2)
    sums = jacobian.by_block(residual * weight, influence)
    total = np.maximum(np.sum(plain, axis=0), 1e-300)
    sums -= plain / total * np.sum(sums, axis=0)
    segments = total**2 / np.maximum(np.sum(plain**2, axis=0), 1e-300)
    ratio = np.sum(sums**2, axis=0) / total * segments / np.maximum(segments - 1.0, 1.0)
    return ratio, segments


def named_covariances(
    found: Covariances, joint: Point, names: Sequence[str]
) -> tuple[Array, Array]:
    """Return the achieved covariance and its Cramer-Rao bound in the order of ``names``, with
    static levels in place of rises, shape (p, p) each; no achieved variance is below its bound.
    """
    order = [joint.free.index(INDEX[n]) for n in names]
    turn = rise_to_static(names)
    achieved, floor = (
        turn @ c[np.ix_(order, order)] @ turn.T for c in (found.achieved, found.floor)
    )
    return not_below(achieved, floor), floor


def not_below(achieved: Array, floor: Array) -> Array:
    """Return a covariance whose variances are at least those of a Cramer-Rao bound, shape (p, p);
    the variance of no linear combination is reduced.

    The scatter of few segments may by chance be less than their noise.

    Args:
        achieved: Covariance, shape (p, p).
        floor: Cramer-Rao bound, shape (p, p).
    """
    missing = np.maximum(np.diag(floor) - np.diag(achieved), 0.0)
    return np.asarray(achieved + np.diag(missing))


def rise_to_static(names: Sequence[str]) -> Array:
    """Return the matrix of the transformation from (Coulomb level, rise) to (Coulomb level, static
    level), shape (p, p).
    """
    turn = np.eye(len(names))
    for coulomb, static in (("Mc", "Ms"), ("mu_c", "mu_s")):
        if coulomb in names and static in names:
            turn[names.index(static), names.index(coulomb)] = 1.0
    return turn
