"""Computes the covariance of the likelihood estimate and its Cramer-Rao bound (M38-M41)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from identification.estimate.inertia import (
    Replicate,
    ReplicatedSegment,
    combined_equation,
    instruments,
    replicated_segments,
)
from identification.filter.likelihood import HUBER_THRESHOLD, Point
from identification.model.parameters import INDEX, INERTIA, LOGARITHMIC, STRIBECK_TERMS
from identification.numerics.arrays import Array
from identification.numerics.compiled import each
from identification.numerics.least_squares import BlockArrow, equilibrated, huber_weight
from identification.numerics.spread import Spread
from identification.prepare import Prepared, prepare
from identification.recording import Recording
from identification.result import KnownConstant, Prior

_SILENT = 1e-12  # information that is assumed for an unknown that affects no residual


def bound(matching: BlockArrow) -> Array:
    """Return the Cramer-Rao bound from matching half cycles, shape (p, p).

    Args:
        matching: d residuals / d unknowns, of r rows and p columns, the mean over matching
            half cycles (``own.mixed(1 / count, mean over the others)``).
    """
    normal, scale = equilibrated(matching.product())
    silent = np.flatnonzero(np.diag(normal) == 0.0)
    normal[silent, silent] = _SILENT
    return np.asarray(np.linalg.inv(normal) / np.outer(scale, scale))


def replicate_information(
    point: Point, matching: BlockArrow, replicates: Sequence[Replicate]
) -> Array:
    """Return the Fisher information of each of the m motion segments on the p free parameters, from
    simulated replicates (M37, M12), shape (m, p, p).

    ``matching``: sensitivities from matching half cycles without variance inflation, for ties and
    for samples for which there are fewer than two noise realisations. ``replicates``: replicates
    with at least two noise realisations.
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
    """Return the sum over a segment of expected products of sensitivities, (p + 1, p + 1)."""
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


_PRIOR, _REPLICATE_PRIOR = 1.0, 16.0
"""Weight of the prior of the scatter (M41), in segments: without and with replicates."""
_FARTHEST = 1.0
"""Change of the logarithm of a parameter above which the parameter is not changed together with the
inertia: the linearisation is invalid, because the parameter is not identifiable (for example a
Stribeck speed below all sampled speeds).
"""


@dataclass(frozen=True)
class Covariances:
    """Covariance of the free parameters and its Cramer-Rao bound, in their units, shape (p, p)."""

    achieved: Array  # covariance with the inertia at the solution of its estimating equation
    floor: Array  # Cramer-Rao bound
    # Step of the free parameters to the solution of this equation; the other parameters change with
    # the inertia, shape (p,).
    step: Array


def covariances(point: Point, replicates: Sequence[Replicate] = ()) -> Covariances:
    """Return the achieved covariance of the free parameters and its Cramer-Rao bound at a point.

    The variance of the inertia is that of its estimating equation; the other parameters change with
    the inertia (M39). The standard deviation of each parameter is scaled by the scatter of its
    scores from segment to segment (M40, M41, and Liang and Zeger, Biometrika 73 (1986) 13); the
    scaling never reduces the variance of the inertia.

    ``replicates``: replicates of the experiment at the estimate, for the bound, the prior of the
    scatter, and instruments of the inertia.
    """
    _, _, residual, jacobian = point.linearised()
    z = instruments(point, jacobian)
    count = len(point.free)
    share = 1.0 / point.experiment.matching_count
    least = bound(jacobian.mixed(share, z))[:count, :count]
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
    """Return the Cramer-Rao bound with and without variance inflation, or None if singular."""
    if not replicates:
        return None
    uninflated = jacobian.scaled(point.inflation[point.owners])
    share = 1.0 / point.experiment.matching_count
    matching = uninflated.mixed(share, instruments(point, uninflated))
    information = replicate_information(point, matching, replicates)
    inflated, plain = (
        replicate_bound(information / f[:, None, None] ** 2)
        for f in (point.inflation, np.ones(len(information)))
    )
    return None if inflated is None or plain is None else (inflated, plain)


def _beside_inertia(floor: Array, j: int, variance: float) -> Array:
    """Return the least-squares covariance with this variance of the inertia ``j`` (M39)."""
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
    """Return observed over modelled standard deviations of scores between segments (M41)."""
    # A recording has few segments; therefore the ratio is combined with its mean over replicates.
    # It may be below one, because the drive's loop compensates part of the noise in a segment.
    ratio, segments = _scatter(jacobian, residual)
    prior, worth = np.ones_like(ratio), _PRIOR
    if replicates:
        ratios = each(lambda replicate: _scatter(*replicate)[0], replicates)
        prior, worth = np.mean(ratios, axis=0), _REPLICATE_PRIOR
    return np.asarray(np.sqrt((worth * prior + segments * ratio) / (worth + segments)))


def _scatter(jacobian: BlockArrow, residual: Array) -> tuple[Array, Array]:
    """Return variance ratio and effective number of segments by parameter (M40), (p,) each."""
    weight = huber_weight(residual, HUBER_THRESHOLD)
    normal, scale = equilibrated(jacobian.product(weight))
    # The information of a segment on its breakaway time may be zero.
    inverse = np.linalg.pinv(normal, hermitian=True) / scale[:, None]
    influence = jacobian.along(inverse[:, : jacobian.parameters.shape[1]])
    plain = jacobian.by_block(np.ones(len(residual)), influence**2)
    sums = jacobian.by_block(residual * weight, influence)
    total = np.maximum(np.sum(plain, axis=0), 1e-300)
    # A distance of the point from the least-squares estimate must not count as scatter.
    sums -= plain / total * np.sum(sums, axis=0)
    segments = total**2 / np.maximum(np.sum(plain**2, axis=0), 1e-300)
    ratio = np.sum(sums**2, axis=0) / total * segments / np.maximum(segments - 1.0, 1.0)
    return ratio, segments


def named_covariances(
    found: Covariances, joint: Point, names: Sequence[str]
) -> tuple[Array, Array]:
    """Return the achieved covariance and its bound for ``names``, with static levels, (p, p)."""
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
    """
    missing = np.maximum(np.diag(floor) - np.diag(achieved), 0.0)
    return np.asarray(achieved + np.diag(missing))


def rise_to_static(names: Sequence[str]) -> Array:
    """Return the matrix that turns (Coulomb level, rise) into (Coulomb, static level), (p, p)."""
    turn = np.eye(len(names))
    for coulomb, static in (("Mc", "Ms"), ("mu_c", "mu_s")):
        if coulomb in names and static in names:
            turn[names.index(static), names.index(coulomb)] = 1.0
    return turn


Solve = Callable[[Sequence[Prepared]], Mapping[str, float]]
"""Function that solves the equation error of prepared recordings and returns values by name."""


class Constant(NamedTuple):
    """One uncertain constant: its place in a recording, its value and standard deviation."""

    place: str
    value: float
    uncertainty: float


def uncertain_constants(recordings: Sequence[Recording]) -> tuple[Constant, ...]:
    """Return the uncertain constants of the recordings, without duplicates.

    Constants of several recordings with the same place, value and uncertainty are one constant,
    such as a weight that was hung several times.
    """
    found: dict[Constant, None] = {}
    for recording in recordings:
        for place, uncertainty in recording.uncertainties.items():
            found[Constant(place, _read(recording, place), uncertainty)] = None
    return tuple(found)


def shifts_of_constants(active: Sequence[Prepared], solve: Solve) -> tuple[KnownConstant, ...]:
    """Return the effect of one standard deviation of each uncertain constant on the estimates."""
    found = []
    for constant in uncertain_constants([p.recording for p in active]):
        low, high = (
            solve([prepare(_moved(p.recording, constant, side), p.bandwidth_Hz) for p in active])
            for side in (-1.0, 1.0)
        )
        shifts = {name: 0.5 * (high[name] - low[name]) for name in high if name in low}
        found.append(KnownConstant(*constant, shifts))
    return tuple(found)


def with_constants(spread: Spread, constants: Sequence[KnownConstant]) -> Spread:
    """Return the covariance of the estimates, with the covariance due to the constants added."""
    covariance = spread.matrix
    for constant in constants:
        d = np.array([constant.shifts.get(name, 0.0) for name in spread.names])
        covariance = covariance + np.outer(d, d)
    return replace(spread, matrix=covariance)


def _moved(recording: Recording, constant: Constant, side: float) -> Recording:
    """Return the recording with a constant that it contains changed by its standard deviation."""
    place, value, uncertainty = constant
    if recording.uncertainties.get(place) != uncertainty or _read(recording, place) != value:
        return recording
    section, _, name = place.rpartition(".")
    moved: Any = {name: value + side * uncertainty}
    if section:
        moved = {section: replace(getattr(recording, section), **moved)}
    return replace(recording, **moved)


def _read(recording: Recording, place: str) -> float:
    value: Any = recording
    for name in place.split("."):
        value = getattr(value, name)
    return float(value)


CONTRADICTS = 2.6
"""Difference of prior and estimate, in standard deviations, from which a warning is given."""
_UNKNOWN = 1e8
"""Assumed standard deviation of a parameter that is not determined, over that of the prior."""


def with_priors(
    values: Mapping[str, float], spread: Spread, known: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], Spread, tuple[Prior, ...], tuple[str, ...]]:
    """Return values and covariance after combination with the priors, the effect of each prior, and
    warnings.

    ``known``: prior value and standard deviation of each parameter with a prior, by name.
    """
    names = [n for n in known if n in spread.names]
    warnings = [
        f"the prior of {name} has no effect: the fit found no friction of this kind"
        for name in known
        if name not in names
    ]
    if not names:
        return dict(values), spread, (), tuple(warnings)
    at = [spread.names.index(n) for n in names]
    wanted, deviations = np.array([known[n] for n in names]).T
    covariance = _finite(spread.matrix, dict(zip(at, deviations, strict=True)))
    before = np.array([values[n] for n in spread.names])
    sum_ = covariance[np.ix_(at, at)] + np.diag(deviations**2)
    gain = np.linalg.solve(sum_, covariance[at]).T
    after = before + gain @ (wanted - before[at])
    # This form of the covariance keeps its precision if only a prior determines a parameter.
    rest = np.eye(len(before))
    rest[:, at] -= gain
    left = rest @ covariance @ rest.T + gain @ np.diag(deviations**2) @ gain.T
    found, clipped = _within(
        {**values, **dict(zip(spread.names, map(float, after), strict=True))}, spread.names
    )
    warnings += clipped
    used = []
    for k, n in zip(at, names, strict=True):
        value, deviation = known[n]
        alone = math.sqrt(covariance[k, k])
        apart = abs(value - values[n]) / math.hypot(alone, deviation)
        if apart > CONTRADICTS:
            warnings.append(
                f"the prior of {n}, {value:.4g} +- {deviation:.2g}, and the recordings, "
                f"{values[n]:.4g} +- {alone:.2g}, are {apart:.1f} standard deviations apart: the "
                "prior or the estimate from the recordings is wrong, and the stated value is "
                "between the two"
            )
        used.append(Prior(n, value, deviation, values[n], alone, found[n], math.sqrt(left[k, k])))
    # An infinite or undefined variance is kept if the parameter has no prior.
    kept = np.where(np.isfinite(spread.matrix), left, spread.matrix)
    kept[np.ix_(at, at)] = left[np.ix_(at, at)]
    return found, replace(spread, matrix=kept), tuple(used), tuple(warnings)


def _finite(covariance: np.ndarray, deviations: Mapping[int, float]) -> np.ndarray:
    """Return the covariance with a large variance of parameters that are not determined."""
    made = np.array(covariance, dtype=np.float64)
    for k in np.flatnonzero(~np.isfinite(np.diag(covariance))):
        made[k, :] = made[:, k] = 0.0
        made[k, k] = (_UNKNOWN * deviations.get(int(k), 1.0)) ** 2
    return made


def _within(values: dict[str, float], names: Sequence[str]) -> tuple[dict[str, float], list[str]]:
    """Return the values, moved to limits that the priors exceed, and warnings about these."""
    found = {n: max(v, 0.0) if n in names and n != "offset" else v for n, v in values.items()}
    for coulomb, static, _ in STRIBECK_TERMS:
        if static in names and found[static] < found.get(coulomb, 0.0):
            found[static] = found[coulomb]
    beyond = [n for n in names if found[n] != values[n]]
    words = (
        "{} is set to the limit of its range, because the combination with the priors is beyond "
        "this limit: the priors contradict the recordings"
    )
    return found, [words.format(n) for n in beyond]
