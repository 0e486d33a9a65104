"""How sure the refined estimate is: its covariance, the bound's, and where the inertia's equation is solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimate.inertia.half_cycles import Rehearsal
from identification.estimate.inertia.inertia_equation import with_rehearsals
from identification.estimate.inertia.instruments import instruments
from identification.estimate.uncertainty.cramer_rao import (
    bound,
    means_alike,
    rehearsed_bound,
    rehearsed_information,
)
from identification.filter.likelihood import Problem
from identification.filter.noise_level import CLIP
from identification.model.parameters import INDEX, INERTIA, LOGARITHMIC
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.least_squares import equilibrated
from identification.numerics.levenberg_marquardt import huber_weight

_PRIOR, _REHEARSED_PRIOR = 1.0, 16.0
"""Stretches that the noise model is worth beside the scatter of the scores from stretch to stretch, and rehearsals."""
_FARTHEST = 1.0
"""Change of a logarithm beyond which a parameter does not follow the inertia: it is one that nothing tells, as a
Stribeck speed that no sample resolves, and where a straight line takes it says nothing."""


@dataclass(frozen=True)
class Covariances:
    """Covariance of the free parameters as estimated, and the least possible, in their own units, shape (p, p).

    Attributes:
        achieved: With the inertia where its equation is solved.
        floor: The bound.
        step: Of the free vector's parameters, to there, all else following the inertia, (p,).
    """

    achieved: Array
    floor: Array
    step: Array


def covariances(problem: Problem, rehearsals: Sequence[Rehearsal] = ()) -> Covariances:
    """Return the achieved covariance of the free parameters and its floor at the problem's start.

    The inertia has the variance of the estimating equation. The others have what least squares reach with the inertia
    known, at the bound for single stretches doubted as they are, as their scores scatter from stretch to stretch (Liang
    and Zeger, Biometrika 73 (1986) 13), and what its error does to them. The inertia's variance is not lowered by its
    scores' scatter.

    Args:
        problem: At the estimate.
        rehearsals: Of its experiment there, for the bound, for how scores are to scatter, and for instruments of the
            inertia beside strokes alike.
    """
    x = problem.origin()
    problem.weigh()
    residual = problem.residuals(x)
    jacobian = problem.jacobian(x, residual)
    z = instruments(problem, jacobian)
    count = len(problem.free)
    least = bound(means_alike(jacobian, z, problem.siblings))[:count, :count]
    reached, floor = _rehearsed_bounds(problem, jacobian, rehearsals) or (least, least)
    units = np.array([problem.start[k] if k in LOGARITHMIC else 1.0 for k in problem.free])
    scale = np.outer(units, units)
    step = np.zeros(count)
    if INERTIA not in problem.free:
        spread, achieved = _spread(jacobian, residual, [r.believed() for r in rehearsals]), reached
    else:
        j = problem.free.index(INERTIA)
        equation = with_rehearsals(problem, z, jacobian, residual, rehearsals)
        influence, weighted = equation.influence, residual * huber_weight(residual, CLIP)
        step = -float(influence @ weighted) * least[:, j] / least[j, j]
        step[[k in LOGARITHMIC and abs(s) > _FARTHEST for k, s in zip(problem.free, step, strict=True)]] = 0.0
        variance = float(influence @ influence) * max(float(np.mean(residual**2)), 1.0)
        achieved = _beside_inertia(reached, j, variance)
        believed = [(slopes.without(j), errors) for slopes, errors in (r.believed() for r in rehearsals)]
        spread = _spread(jacobian.without(j), residual, believed)
        scatter = np.linalg.norm(np.bincount(problem.owners, equation.parts)) / np.linalg.norm(influence * weighted)
        spread = np.insert(spread, j, max(float(scatter), 1.0))
    return Covariances(achieved * np.outer(spread, spread) * scale, floor * scale, step)


def _rehearsed_bounds(
    problem: Problem, jacobian: BlockArrow, rehearsals: Sequence[Rehearsal]
) -> tuple[Array, Array] | None:
    """Return the bound with single stretches doubted, and without, (p, p) each; None where nothing tells them.

    The doubt (bounded influence) is the estimate's own affair: it is no part of the floor.
    """
    if not rehearsals:
        return None
    believed = jacobian.scaled(problem.doubt[problem.owners])
    alike = means_alike(believed, instruments(problem, believed), problem.siblings)
    told = rehearsed_information(problem, alike, rehearsals)
    doubted, plain = (rehearsed_bound(told / d[:, None, None] ** 2) for d in (problem.doubt, np.ones(len(told))))
    return None if doubted is None or plain is None else (doubted, plain)


def _beside_inertia(floor: Array, j: int, variance: float) -> Array:
    """Return the covariance of least squares beside the ``j``-th, an inertia found with this variance."""
    others = [k for k in range(len(floor)) if k != j]
    known = np.ix_(others, others)
    follow = floor[others, j] / floor[j, j]
    out = np.empty_like(floor)
    out[known] = floor[known] + np.outer(follow, follow) * (variance - floor[j, j])
    out[others, j] = out[j, others] = follow * variance
    out[j, j] = variance
    return out


def _spread(jacobian: BlockArrow, residual: Array, rehearsals: Sequence[tuple[BlockArrow, Array]]) -> Array:
    """Return by how much the scores scatter more from stretch to stretch than their noise model says, shape (p,).

    A recording has some ten strokes a stage, whose scatter is hardly known. So it is drawn toward that of the
    rehearsals, slopes and residuals each, and where there are none toward one. It may be below one: the drive's loop
    takes a part of the current's noise out again, and what errs at the beginning of a stretch is made good by its end.
    """
    ratio, stretches = _scatter(jacobian, residual)
    prior, worth = np.ones_like(ratio), _PRIOR
    if rehearsals:
        prior, worth = np.mean([_scatter(*r)[0] for r in rehearsals], axis=0), _REHEARSED_PRIOR
    return np.asarray(np.sqrt((worth * prior + stretches * ratio) / (worth + stretches)))


def _scatter(jacobian: BlockArrow, residual: Array) -> tuple[Array, Array]:
    """Return the ratio of the clustered to the plain variance of each parameter of least squares, shape (p,).

    And the stretches that it rests on, as many alike as would scatter so, shape (p,). Scores are taken about their
    mean, so that an estimate beside the least squares' own does not count as scatter.
    """
    weight = huber_weight(residual, CLIP)
    normal, scale = equilibrated(jacobian.product(weight))
    # A stretch may say nothing of its own breakaway time.
    inverse = np.linalg.pinv(normal, hermitian=True) / scale[:, None]
    influence = jacobian.along(inverse[:, : jacobian.parameters.shape[1]])
    plain, sums = np.zeros((2, jacobian.blocks, influence.shape[1]))
    np.add.at(plain, jacobian.owners, influence**2)
    np.add.at(sums, jacobian.owners, influence * (residual * weight)[:, None])
    total = np.maximum(np.sum(plain, axis=0), 1e-300)
    sums -= plain / total * np.sum(sums, axis=0)
    stretches = total**2 / np.maximum(np.sum(plain**2, axis=0), 1e-300)
    ratio = np.sum(sums**2, axis=0) / total * stretches / np.maximum(stretches - 1.0, 1.0)
    return ratio, stretches


def named_covariances(found: Covariances, joint: Problem, names: Sequence[str]) -> tuple[Array, Array]:
    """Return the covariance achieved and the least possible in the order of ``names``, by static limits, (p, p)."""
    order = [joint.free.index(INDEX[n]) for n in names]
    turn = rise_to_static(names)
    achieved, floor = (turn @ c[np.ix_(order, order)] @ turn.T for c in (found.achieved, found.floor))
    return achieved, floor


def rise_to_static(names: Sequence[str]) -> Array:
    """Return the map from (Coulomb level, rise) to (Coulomb level, static limit)."""
    turn = np.eye(len(names))
    for coulomb, static in (("Mc", "Ms"), ("mu_c", "mu_s")):
        if coulomb in names and static in names:
            turn[names.index(static), names.index(coulomb)] = 1.0
    return turn
