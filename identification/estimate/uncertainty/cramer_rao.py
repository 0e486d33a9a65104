"""Computes the Cramer-Rao bound of an experiment: the least variance of any unbiased estimate (M37,
M38).

The bound holds for a quantised encoder, for unknown breakaway times, and for a measured current
that is a given input, because the drive loop is unknown. The Fisher information is computed from
the mean of the prediction errors: products of sensitivities over standard deviations, summed over
samples (Ljung, System Identification, 2nd ed., 7.4), with the breakaway times eliminated.

The sensitivities of a segment contain the current noise, whose square would count as excitation.
With replicates, products of sensitivities from two different noise realisations are used. Without
replicates, the sensitivities are averaged over matching half cycles. This average reduces the
noise, but loses the differences between half cycles; without replicates the bound is therefore up
to a quarter too high.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.estimate.inertia.half_cycles import (
    Replicate,
    ReplicatedSegment,
    replicated_segments,
)
from identification.filter.likelihood import Point
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.least_squares import equilibrated

_SILENT = 1e-12
"""Information that is assumed for an unknown that affects no residual."""


def matching_means(jacobian: BlockArrow, others: BlockArrow, counts: Array) -> BlockArrow:
    """Return the mean of sensitivities over matching half cycles.

    Args:
        jacobian: Sensitivities of each segment, r rows.
        others: Mean over the other matching half cycles.
        counts: Number of matching half cycles of the segment of each row, including the segment
            itself, shape (r,).
    """
    return jacobian.mixed(1.0 / counts, others)


def bound(matching: BlockArrow) -> Array:
    """Return the Cramer-Rao bound from matching half cycles, shape (p, p).

    Args:
        matching: d residuals / d unknowns, of r rows and p columns, from :func:`matching_means`.

    Returns:
        Shape (p, p).

    Raises:
        numpy.linalg.LinAlgError: The recordings do not excite all unknowns.
    """
    normal, scale = equilibrated(matching.product())
    silent = np.flatnonzero(np.diag(normal) == 0.0)
    normal[silent, silent] = _SILENT
    return np.asarray(np.linalg.inv(normal) / np.outer(scale, scale))


def replicate_information(
    point: Point, matching: BlockArrow, replicates: Sequence[Replicate]
) -> Array:
    """Return each segment's information on the free parameters, from replicates (M37, M12), shape
    (m, p, p).

    Args:
        point: Point at which the sensitivities are computed.
        matching: Sensitivities from matching half cycles without variance inflation, for ties and
            for samples for which there are fewer than two noise realisations.
        replicates: Replicates with at least two noise realisations.
    """
    count = len(point.free)
    rows = np.column_stack([matching.parameters, matching.own])
    ties = rows[len(rows) - point.breakaways :]
    out = np.zeros((point.breakaways, count, count))
    for segment in replicated_segments(point, replicates):
        tie = ties[segment.number]
        here = _products(segment, rows[segment.rows]) + np.outer(tie, tie)
        out[segment.number] = here[:count, :count]
        if here[count, count] > 0.0:
            out[segment.number] -= (
                np.outer(here[:count, count], here[count, :count]) / here[count, count]
            )
    return out


def replicate_bound(information: Array) -> Array | None:
    """Return the Cramer-Rao bound from replicates (M38).

    Args:
        information: Information of each segment (:func:`replicate_information`), shape (m, p, p).

    Returns:
        Covariance of the free parameters, shape (p, p), or None if the information is singular.
    """
    total = np.sum(information, axis=0)
    if np.any(np.diag(total) <= 0.0):
        return None
    normal, scale = equilibrated(total)
    if np.linalg.eigvalsh(normal)[0] <= 0.0:
        return None
    return np.asarray(np.linalg.inv(normal) / np.outer(scale, scale))


def _products(segment: ReplicatedSegment, matching: Array) -> Array:
    """Return the sum over a segment's samples of the expected products of its sensitivities, shape
    (p + 1, p + 1).

    The expectation is the mean over all pairs of different noise realisations (Hoeffding, Annals of
    Mathematical Statistics 19 (1948) 293).
    """
    noises = {curve.noise for curve in segment.curves}
    total, squares, seen = (
        np.zeros_like(matching),
        np.zeros((matching.shape[1],) * 2),
        np.zeros((len(matching), 1)),
    )
    means = [
        segment.mean([c for c in segment.curves if c.noise == noise]) for noise in sorted(noises)
    ]
    for mean, number in means:
        total += mean
        seen += number > 0.0
    pairs = np.where(seen > 1.0, seen * (seen - 1.0), np.inf)
    for mean, _ in means:
        squares += (mean / pairs).T @ mean
    left = matching[seen[:, 0] < 2.0]
    return np.asarray((total / pairs).T @ total - squares + left.T @ left)
