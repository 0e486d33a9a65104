"""Predicts the intervals of a planned experiment from its Fisher information on the nominal model.

The nominal response is recorded with the bench's noise and sensors, and the information is computed
from the residuals that the default method minimises. The information therefore accounts for the
encoder's quantisation, the current's noise, the unknown breakaway times, and the samples that the
estimator omits around them. The sensitivities of one simulated run contain the current's noise: a
motion segment in which the joint almost stops by chance would have an information that other runs
do not confirm. Therefore a stage is simulated with several drives and noise series, and the
information is computed from products of the sensitivities of two different runs, as for the floor
of an estimate (:mod:`identification.estimate.uncertainty.cramer_rao`). Whole designs are then
judged by several simulated runs (:mod:`identification.design.simulated_trial`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from identification.design.simulated import PlannedModel, PlannedStage, at_the_truth
from identification.estimate.inertia.half_cycles import Replicate
from identification.estimate.inertia.instruments import instruments
from identification.estimate.uncertainty.cramer_rao import matching_means, replicate_information
from identification.filter.likelihood import Point
from identification.filter.noise_level import HUBER_THRESHOLD
from identification.model.parameters import INDEX, LOAD_PARAMETERS, LOGARITHMIC, SYSTEM_PARAMETERS
from identification.numerics.arrays import Array
from identification.numerics.levenberg_marquardt import huber_weight
from identification.numerics.spread import CONFIDENCE

NAMES = (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS)
LEAST_BREAKAWAYS = 4
"""Least number of breakaways of a stage that has information: the estimator needs several
breakaways to distinguish breakaway times from Ms.
"""
_CLEAR = 1e-9
"""Ratio of an eigenvalue of the information to the greatest eigenvalue, below which the direction
of the eigenvector counts as not identifiable.
"""


@dataclass(frozen=True)
class Information:
    """Information of a stage on the nine parameters relative to their values, in the order of
    NAMES; the information of several stages is the sum of that of each stage.

    Attributes:
        normal: Fisher information from products of the sensitivities of different simulated runs
            (replicates), bounded by ``power``, shape (9, 9).
        power: Covariance of the scores that the noise model predicts: the Fisher information from
            the products of each run's own sensitivities, shape (9, 9).
        scatter: Covariance of the scores observed over the motion segments of the simulated runs,
            shape (9, 9).
    """

    normal: Array
    power: Array
    scatter: Array

    def times(self, factor: float) -> Information:
        """Return the information of a stage that is ``factor`` times as long."""
        return Information(factor * self.normal, factor * self.power, factor * self.scatter)

    def effective(self, weights: Array) -> Information:
        """Return the information that is effective for one parameter. The information is divided by
        the ratio of the scores' observed variance to their variance by the noise model, if this
        ratio exceeds one.

        Args:
            weights: Weights of the scores in the error of the parameter's estimate, from
                :func:`weights_of_scores`, shape (9,).
        """
        ratio = float(weights @ self.scatter @ weights) / max(
            float(weights @ self.power @ weights), 1e-300
        )
        return replace(self, normal=self.normal / max(ratio, 1.0))


NOTHING = Information(*np.zeros((3, len(NAMES), len(NAMES))))


@dataclass(frozen=True)
class Intervals:
    """Relative half widths of the 90 % intervals after an experiment; infinite for a parameter that
    is not identifiable.
    """

    half_widths: Mapping[str, float]

    @property
    def weakest(self) -> str:
        """Name of the parameter with the widest interval relative to the parameter's value."""
        return max(self.half_widths, key=lambda name: self.half_widths[name])

    @property
    def worst(self) -> float:
        """Relative half width of the weakest parameter."""
        return self.half_widths[self.weakest]


def stage_information(stage: PlannedStage, nominals: Sequence[PlannedModel]) -> Information:
    """Return the information of one stage, from simulated runs that are replicates of one another.

    The information is :data:`NOTHING` if a run has too few breakaways or the filter diverges. The
    parameters are taken relative to their values, so that the matrices are well scaled; they are
    the static levels, not the rises.

    Args:
        stage: Command and weight of the stage.
        nominals: Model of each run, three at least; each run has its own noise.
    """
    names = NAMES if stage.weight else SYSTEM_PARAMETERS
    runs = []
    for number, nominal in enumerate(nominals):
        run = at_the_truth([stage], nominal, names, number, whole=False)
        if run is None or run.point.breakaways < LEAST_BREAKAWAYS:
            return NOTHING
        runs.append(run)
    turn = _turn(names, nominals[0])
    found = np.zeros((3, len(NAMES), len(NAMES)))
    for run in runs:
        others = [other for other in runs if other is not run]
        own = np.stack([_replicate_information(run, others), *_scores(run)])
        found[:, : len(names), : len(names)] += turn.T @ own @ turn / len(runs)
    return Information(_bounded(found[0], found[1]), found[1], found[2])


def _replicate_information(run: Replicate, others: Sequence[Replicate]) -> Array:
    """Return the information of a run from products with its replicates, with variance inflation,
    shape (p, p).
    """
    point, jacobian = run.point, run.sensitivities
    alike = matching_means(jacobian, instruments(point, jacobian), point.experiment.matching_count)
    by_segment = replicate_information(point, alike, others)
    return np.asarray(np.sum(by_segment / point.inflation[:, None, None] ** 2, axis=0))


def _scores(run: Replicate) -> tuple[Array, Array]:
    """Return two covariances of the scores of a stage, with breakaway times eliminated: by the
    noise model, and as observed over the motion segments; shape (p, p) each.
    """
    jacobian, residual = run.inflated()
    residual = residual * huber_weight(residual, HUBER_THRESHOLD)
    segments, owners = jacobian.blocks, jacobian.owners
    rows = np.column_stack([jacobian.parameters, jacobian.own])
    count = rows.shape[1] - 1
    power = np.zeros((segments, count + 1, count + 1))
    scores = np.zeros((segments, count + 1))
    np.add.at(power, owners, rows[:, :, None] * rows[:, None, :])
    np.add.at(scores, owners, rows * residual[:, None])
    times = power[:, count, count]
    share = np.where(
        times[:, None] > 0.0,
        power[:, :count, count] / np.where(times > 0.0, times, 1.0)[:, None],
        0.0,
    )
    scores = scores[:, :count] - share * scores[:, count:]
    power = power[:, :count, :count] - share[:, :, None] * power[:, count, None, :count]
    scores -= np.mean(scores, axis=0)
    return np.sum(power, axis=0), scores.T @ scores * segments / max(segments - 1, 1)


def _bounded(information: Array, power: Array) -> Array:
    """Return the information from replicates, limited in every direction to between zero and
    ``power``, the information from products of each run with itself.

    Products of two different runs are not bounded: with few matching half cycles they can by chance
    be negative, or far greater than ``power``.
    """
    scale = np.sqrt(np.maximum(np.diag(power), 1e-300))
    values, vectors = np.linalg.eigh(power / np.outer(scale, scale))
    clear = values > _CLEAR * np.max(values)
    root = vectors[:, clear] * np.sqrt(values[clear])
    inverse = vectors[:, clear] / np.sqrt(values[clear])
    shares, ways = np.linalg.eigh(inverse.T @ (information / np.outer(scale, scale)) @ inverse)
    half = root @ ways
    return np.asarray((half * np.clip(shares, 0.0, 1.0)) @ half.T * np.outer(scale, scale))


def likelihood_slope(point: Point) -> float:
    """Return the steepness of the likelihood at a point.

    If noise decides whether the joint stops or moves on, the errors of the linearised filter have a
    nonzero mean. The likelihood of other values is then far greater than that of the simulated
    values, and the information of the stage is wrong. With the gradient g of the log likelihood and
    the information I of p parameters, the steepness is g' I^-1 g / p, which is about 1 if noise
    alone causes the gradient. The inertia is excluded, because it is not estimated by likelihood.
    """
    x, count = point.origin(), len(point.free)
    errors, deviations = point.predictions(x)
    jacobian, widening = point.derivatives(x, errors, deviations)
    residual = np.clip(errors / deviations, -HUBER_THRESHOLD, HUBER_THRESHOLD)
    score = jacobian.back(residual) + widening.back(1.0 - residual**2)
    known = jacobian.product() + 2.0 * widening.product()
    times = list(range(count, len(score)))
    sought = [k for k in range(count) if point.free[k] != INDEX["J"]]
    steepness = _squared(score, known, [*sought, *times]) - _squared(score, known, times)
    return steepness / max(len(sought), 1)


def _squared(score: Array, known: Array, places: Sequence[int]) -> float:
    """Return g' I^-1 g for the scores g and the information I of the unknowns at ``places``."""
    part = score[list(places)]
    return float(part @ np.linalg.pinv(known[np.ix_(places, places)], hermitian=True) @ part)


def _turn(names: Sequence[str], nominal: PlannedModel) -> Array:
    """Return the matrix that transforms relative changes of named parameters to changes of the
    coordinates of a search (logarithms, rises).
    """
    turn = np.eye(len(names))
    for k, name in enumerate(names):
        if INDEX[name] not in LOGARITHMIC:
            turn[k, k] = nominal.values[name]
    for coulomb, static in (("Mc", "Ms"), ("mu_c", "mu_s")):
        if static in names:
            turn[names.index(static), names.index(coulomb)] = -nominal.values[coulomb]
    return turn


def weights_of_scores(informations: Sequence[Information], target: str, loaded: bool) -> Array:
    """Return the weights of the scores in the error of an estimate, shape (9,): the row of the
    ``target`` parameter in the inverse of the information of several stages. To first order, the
    error of the estimate is the sum of the scores times these weights.
    """
    count = len(NAMES) if loaded else len(SYSTEM_PARAMETERS)
    total = np.sum([i.normal for i in informations], axis=0)[:count, :count]
    scale = np.sqrt(np.maximum(np.diag(total), 1e-300))
    out = np.zeros(len(NAMES))
    out[:count] = (
        np.linalg.pinv(total / np.outer(scale, scale), hermitian=True)[NAMES.index(target)] / scale
    )
    return out


def effective(informations: Sequence[Information], target: str, loaded: bool) -> list[Information]:
    """Return the effective information of each stage on the ``target`` parameter, which is
    estimated from all stages together.
    """
    weights = weights_of_scores(informations, target, loaded)
    return [i.effective(weights) for i in informations]


def intervals_of(informations: Sequence[Information], loaded: bool) -> Intervals:
    """Return the intervals from all stages together: of all nine parameters if any stage is loaded,
    otherwise of the five system parameters.
    """
    names = NAMES if loaded else SYSTEM_PARAMETERS
    total = np.sum([i.normal for i in informations], axis=0)[: len(names), : len(names)]
    seen = np.flatnonzero(np.diag(total) > 0.0)
    widths = dict.fromkeys(names, math.inf)
    scale = np.sqrt(np.diag(total)[seen])
    values, vectors = np.linalg.eigh(total[np.ix_(seen, seen)] / np.outer(scale, scale))
    clear = values >= 1e-12 * np.max(values, initial=0.0)
    bread = (vectors[:, clear] / values[clear]) @ vectors[:, clear].T / np.outer(scale, scale)
    quantile = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
    for k, place in enumerate(seen):
        if not np.any(np.abs(vectors[k, ~clear]) > 1e-6):
            widths[names[place]] = quantile * math.sqrt(bread[k, k])
    return Intervals(widths)
