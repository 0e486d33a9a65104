"""The Cramer-Rao bound of a measurement as it is.

The current is a noisy mean over each period, the drive's loop is unknown, so the current is a given input and not
foretold; the encoder is quantised; and when each stretch breaks away is unknown. Then the Fisher information is that of
the prediction errors' mean: sensitivities over standard deviations, products summed over all samples (Ljung, System
Identification, 2nd ed., 7.4), with the breakaway times eliminated.

A stretch's own sensitivities hold the current's noise, whose square would pass for excitation. Where the experiment was
rehearsed, they are those of rehearsals of the very stretch, in products of two different noises, so that no noise is
squared. Else they are replaced by the mean over the stretches of the recording that make the same motion, as long
after their breakaway: the noise's share falls with their number, and what distinguishes them is lost, so that this
bound is up to a quarter too high.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.estimate.inertia.half_cycles import PlayedStretch, Rehearsal, played
from identification.filter.likelihood import Problem
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.least_squares import equilibrated

_SILENT = 1e-12
"""Information on an unknown that touches no residual."""


def means_alike(jacobian: BlockArrow, others: BlockArrow, stretches: Array) -> BlockArrow:
    """Return the mean of sensitivities over the stretches that make the same motion.

    Args:
        jacobian: A stretch's own, of r rows.
        others: The mean over the other stretches.
        stretches: How many stretches each row's mean is over, its own among them, shape (r,).
    """
    return jacobian.mixed(1.0 / stretches, others)


def bound(alike: BlockArrow) -> Array:
    """Return the smallest covariance that an unbiased estimate can have, by strokes alike.

    Args:
        alike: d residuals / d unknowns, residuals over their standard deviations, of r rows and p columns; the mean
            over stretches that make the same motion (:func:`means_alike`).

    Returns:
        Shape (p, p).

    Raises:
        numpy.linalg.LinAlgError: The unknowns are not all excited.
    """
    normal, scale = equilibrated(alike.product())
    silent = np.flatnonzero(np.diag(normal) == 0.0)
    normal[silent, silent] = _SILENT
    return np.asarray(np.linalg.inv(normal) / np.outer(scale, scale))


def rehearsed_information(problem: Problem, alike: BlockArrow, rehearsals: Sequence[Rehearsal]) -> Array:
    """Return what each stretch tells of the free parameters by rehearsals of it, its breakaway time eliminated.

    Args:
        problem: At its start.
        alike: d residuals / d x there by strokes alike, for samples that fewer than two noises show, and for the ties;
            no stretch doubted.
        rehearsals: With two noises at least.

    Returns:
        Shape (m, p, p); a stretch that is doubted tells less by the square of that.
    """
    count = len(problem.free)
    rows = np.column_stack([alike.parameters, alike.own])
    ties = rows[len(rows) - problem.breakaways :]
    out = np.zeros((problem.breakaways, count, count))
    for stretch in played(problem, rehearsals):
        tie = ties[stretch.number]
        told = _products(stretch, rows[stretch.rows]) + np.outer(tie, tie)
        out[stretch.number] = told[:count, :count]
        if told[count, count] > 0.0:
            out[stretch.number] -= np.outer(told[:count, count], told[count, :count]) / told[count, count]
    return out


def rehearsed_bound(told: Array) -> Array | None:
    """Return the smallest covariance that an unbiased estimate can have, from rehearsals of the experiment.

    Args:
        told: By each stretch (:func:`rehearsed_information`), shape (m, p, p).

    Returns:
        Of the free parameters, shape (p, p); None where so few noises leave the information without an inverse.
    """
    information = np.sum(told, axis=0)
    if np.any(np.diag(information) <= 0.0):
        return None
    normal, scale = equilibrated(information)
    if np.linalg.eigvalsh(normal)[0] <= 0.0:
        return None
    return np.asarray(np.linalg.inv(normal) / np.outer(scale, scale))


def _products(stretch: PlayedStretch, alike: Array) -> Array:
    """Return the sum over a stretch's samples of the expected products of its sensitivities, shape (p + 1, p + 1).

    The mean of products over all pairs of different noises (Hoeffding, Ann. Math. Statist. 19 (1948) 293).
    """
    noises = {curve.noise for curve in stretch.curves}
    total, squares, seen = np.zeros_like(alike), np.zeros((alike.shape[1],) * 2), np.zeros((len(alike), 1))
    shown = [stretch.mean([c for c in stretch.curves if c.noise == noise]) for noise in sorted(noises)]
    for mean, number in shown:
        total += mean
        seen += number > 0.0
    pairs = np.where(seen > 1.0, seen * (seen - 1.0), np.inf)
    for mean, _ in shown:
        squares += (mean / pairs).T @ mean
    left = alike[seen[:, 0] < 2.0]
    return np.asarray((total / pairs).T @ total - squares + left.T @ left)
