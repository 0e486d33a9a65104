"""Estimates the inertia by instrumental variables (M27-M32): instruments, variance inflation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from identification.filter.experiment import Experiment
from identification.filter.kalman import DIRECTION, FIRST, LAST
from identification.filter.likelihood import HUBER_THRESHOLD, Point, Searched, likeliest_noise
from identification.filter.segments import Motion
from identification.model.parameters import INERTIA, LOGARITHMIC, OFFSET
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled
from identification.numerics.least_squares import BlockArrow, huber_weight


@dataclass(frozen=True)
class Replicate:
    """One simulated replicate of an experiment."""

    point: Point  # the simulated recordings, in the order of the real ones, at the simulated values
    # Derivatives of the residuals at the point with respect to the free parameters of the real
    # experiment.
    sensitivities: BlockArrow
    residuals: Array  # prediction errors over their standard deviations, shape (r,)
    # Number of the noise realisation; a realisation and its copy with reversed sign have one
    # number.
    noise: int

    def inflated(self) -> tuple[BlockArrow, Array]:
        """Return sensitivities and residuals with the variance inflation (M13) of the estimate."""
        share = 1.0 / self.point.inflation[self.point.owners]
        return self.sensitivities.scaled(share), self.residuals * share


@dataclass(frozen=True)
class Curve:
    """Sensitivities over one segment of a replicate."""

    # Derivatives with respect to the parameters, then to the breakaway time, shape (n, p + 1).
    values: Array
    onset: float  # breakaway time, in samples after the segment's first sample
    noise: int  # number of the replicate's noise realisation


@dataclass(frozen=True)
class ReplicatedSegment:
    """A segment of a recording with its counterparts in the replicates."""

    number: int  # number of the segment, over all recordings
    rows: slice  # rows of the segment's residuals
    onset: float  # breakaway time, in samples after the segment's first sample
    # Counterparts of the segment in the replicates; a replicate may have none.
    curves: tuple[Curve, ...]

    def mean(self, curves: Sequence[Curve]) -> tuple[Array, Array]:
        """Return the mean of the curves at the segment's samples, (n, p + 1), and their number."""
        length = self.rows.stop - self.rows.start
        return mean_curve([c.values for c in curves], [c.onset for c in curves], length, self.onset)


def replicated_segments(
    point: Point, replicates: Sequence[Replicate]
) -> Iterator[ReplicatedSegment]:
    """Yield every segment of an experiment with its counterparts in replicates."""
    found_in = [_segments(r) for r in replicates]
    row, number = 0, 0
    for k, (m, begins) in enumerate(zip(point.motions, point.breakaway_times, strict=True)):
        for bounds, onset in zip(m.table, onsets_of(m, begins), strict=True):
            end = row + int(bounds[LAST] - bounds[FIRST])
            found = [curve for one in found_in if (curve := _same(one[k], bounds)) is not None]
            yield ReplicatedSegment(number, slice(row, end), float(onset), tuple(found))
            row, number = end, number + 1


def _segments(replicate: Replicate) -> list[list[tuple[Array, Curve]]]:
    """Return the segments of a replicate by recording: row in the table of segments, and curve."""
    point, slopes = replicate.point, replicate.sensitivities
    curves = np.column_stack([slopes.parameters, slopes.own])
    out, row = [], 0
    for m, begins in zip(point.motions, point.breakaway_times, strict=True):
        segments = []
        for bounds, onset in zip(m.table, onsets_of(m, begins), strict=True):
            length = int(bounds[LAST] - bounds[FIRST])
            segments.append(
                (bounds, Curve(curves[row : row + length], float(onset), replicate.noise))
            )
            row += length
        out.append(segments)
    return out


def _same(segments: Sequence[tuple[Array, Curve]], bounds: Array) -> Curve | None:
    """Return the curve that shares most samples with ``bounds``, at least half, or None."""
    best, least = None, 0.5 * (bounds[LAST] - bounds[FIRST])
    for other, curve in segments:
        common = min(other[LAST], bounds[LAST]) - max(other[FIRST], bounds[FIRST])
        if other[DIRECTION] == bounds[DIRECTION] and common > least:
            best, least = curve, common
    return best


def onsets_of(m: Motion, begins: Array) -> Array:
    """Return the breakaway time of each segment, in samples after its first sample, shape (m,)."""
    first = m.table[:, FIRST].astype(np.int64)
    return np.asarray((begins - m.time[first]) / m.recording.period)


def mean_curve(
    curves: Sequence[Array], onsets: Sequence[float], length: int, onset: float
) -> tuple[Array, Array]:
    """Return the mean of curves shifted to one ``onset``, shape (length, p), and the number of
    curves at each sample, (length, 1).

    ``onsets``: breakaway time of each curve, in samples after its first sample. ``length``: length
    of the mean. ``onset``: breakaway time of the mean.
    """
    total, seen = np.zeros((length, curves[0].shape[1])), np.zeros((length, 1))
    for curve, begun in zip(curves, onsets, strict=True):
        _add_shifted(curve, begun, onset, int(np.floor(begun - onset)), total, seen)
    return total / np.maximum(seen, 1.0), seen


@compiled
def _add_shifted(
    curve: Array, begun: float, onset: float, ahead: int, total: Array, seen: Array
) -> None:
    """Add a curve, interpolated linearly between its samples, to ``total``; count in ``seen``."""
    for k in range(max(0, -ahead), min(len(total), len(curve) - 1 - ahead)):
        share = k + begun - onset - (k + ahead)
        for j in range(total.shape[1]):
            total[k, j] += (1.0 - share) * curve[k + ahead, j] + share * curve[k + ahead + 1, j]
        seen[k, 0] += 1.0


_WIDENING = 0.2
_SHARP = 2.0
_WIDEST = 7
"""Width of the Gaussian smoothing, samples: share of the time since breakaway, constant, most."""
_TRUNCATED = 4.0  # number of standard deviations at which the smoothing Gaussian is truncated


def instruments(point: Point, jacobian: BlockArrow) -> BlockArrow:
    """Return the instruments of every residual; zero at samples in no other matching segment."""
    count = len(point.free)
    both_ways = np.array([k == OFFSET for k in point.free] + [False])
    parameters, own = np.zeros_like(jacobian.parameters), np.zeros_like(jacobian.own)
    row, segment = 0, 0
    tie = len(own) - point.breakaways
    for m, begins in zip(point.motions, point.breakaway_times, strict=True):
        lengths = (m.table[:, LAST] - m.table[:, FIRST]).astype(np.int64)
        starts = row + np.concatenate(([0], np.cumsum(lengths)))
        curves, sides = [], []
        for j, side in enumerate(m.table[:, DIRECTION]):
            sides.append(np.where(both_ways, 1.0, side))
            here = slice(starts[j], starts[j + 1])
            curves.append(
                np.column_stack([jacobian.parameters[here], jacobian.own[here]]) * sides[j]
            )
        ties = jacobian.own[tie + segment : tie + segment + len(lengths)]
        onsets, matching = onsets_of(m, begins), m.matching
        for j, side in enumerate(sides):
            others = np.flatnonzero(matching[j] & (np.arange(len(curves)) != j))
            mean, _ = mean_curve(
                [curves[i] for i in others], onsets[others].tolist(), len(curves[j]), onsets[j]
            )
            mean = _smooth(mean, onsets[j]) * side
            parameters[starts[j] : starts[j + 1]] = mean[:, :count]
            own[starts[j] : starts[j + 1]] = mean[:, count]
            parameters[tie + segment + j] = jacobian.parameters[tie + segment + j]
            own[tie + segment + j] = np.mean(np.delete(ties, j))
        row = int(starts[-1])
        segment += len(lengths)
    return replace(jacobian, parameters=parameters, own=own)


def replicate_instruments(
    point: Point, plain: BlockArrow, replicates: Sequence[Replicate]
) -> BlockArrow:
    """Return the instrumental variables of all residuals, averaged over simulated replicates; those
    in ``plain`` where no replicate has the sample.

    Matching half cycles are few and differ slightly; a replicate is a simulation of the same motion
    with other noise. The mean over replicates is not smoothed, because the drive's response to
    steps of command and encoder is the same in all replicates, and with a coarse encoder the
    samples of these responses contain most information on the inertia.

    ``plain``: instruments from matching half cycles.
    """
    parameters, own = plain.parameters.copy(), plain.own.copy()
    for segment in replicated_segments(point, replicates):
        if not segment.curves:
            continue
        here, inflation = segment.rows, point.inflation[segment.number]
        mean, seen = segment.mean(segment.curves)
        matching = np.column_stack([parameters[here], own[here]])
        mean = np.where(seen > 0.0, mean / inflation, matching)
        parameters[here], own[here] = mean[:, :-1], mean[:, -1]
    return replace(plain, parameters=parameters, own=own)


def _smooth(curve: Array, onset: float) -> Array:
    """Return a curve smoothed with a width that grows with the samples since ``onset``, (n, p)."""
    width = np.clip(_WIDENING * (np.arange(len(curve)) - onset) - _SHARP, 2.0**-1, 2.0**_WIDEST)
    level = np.log2(width) + 1.0
    low = np.minimum(np.floor(level).astype(np.int64), _WIDEST)
    share = (level - low)[:, None]
    bank, row = _smoothed(curve), np.arange(len(curve))
    return np.asarray((1.0 - share) * bank[low, row] + share * bank[low + 1, row])


def _smoothed(curve: Array) -> Array:
    """Return a curve, and smoothed by Gaussians of 2^0 to 2^7 samples by FFT, (9, n, p)."""
    reach = round(_TRUNCATED * 2.0**_WIDEST)
    length = fft.next_fast_len(len(curve) + 2 * reach, real=True)
    held = np.concatenate(
        [np.repeat(curve[:1], reach, axis=0), curve, np.repeat(curve[-1:], reach, axis=0)]
    )
    wave = fft.rfft(held, length, axis=0)
    smoothed = fft.irfft(wave * _responses(length)[:, :, None], length, axis=1)
    return np.concatenate([curve[None], smoothed[:, reach : reach + len(curve)]])


@lru_cache(maxsize=64)
def _responses(length: int) -> NDArray[np.complex128]:
    """Return the frequency responses of the Gaussians, shape (8, length // 2 + 1)."""
    place = np.arange(length)
    distance = np.minimum(place, length - place)
    sigma = 2.0 ** np.arange(_WIDEST + 1)[:, None]
    taps = np.exp(-0.5 * (distance / sigma) ** 2) * (distance <= np.round(_TRUNCATED * sigma))
    return np.asarray(fft.rfft(taps / taps.sum(axis=1, keepdims=True), axis=1))


@dataclass(frozen=True)
class Equation:
    """The linearised estimating equation of the inertia: a sum of contributions of residuals."""

    # Decrease of the logarithm of the inertia per unit of each residual, shape (r,).
    influence: Array
    # Decrease of the logarithm of the inertia due to each residual: directly, and by its effect on
    # the instruments of other segments, shape (r,).
    parts: Array


def influence_on_inertia(
    point: Point, z: BlockArrow, jacobian: BlockArrow, residual: Array
) -> Array:
    """Return the decrease of ln J per unit of each residual (M30), shape (r,)."""
    return z.along(_mixture(point, z, jacobian, residual))


def _mixture(point: Point, z: BlockArrow, jacobian: BlockArrow, residual: Array) -> Array:
    """Return weights of instruments whose equation depends on log J alone, with unit slope."""
    j = point.free.index(INERTIA)
    power = z.product()
    others = np.delete(power, j, axis=0)
    taken = np.linalg.pinv(np.delete(others, j, axis=1), hermitian=True) @ others[:, j]
    alone = np.insert(-taken, j, 1.0)
    return alone / float(
        z.along(alone) @ (jacobian.parameters[:, j] * huber_weight(residual, HUBER_THRESHOLD))
    )


def equation(point: Point, z: BlockArrow, jacobian: BlockArrow, residual: Array) -> Equation:
    """Return the equation of the inertia with instruments that are independent of the residuals."""
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
    """Return the nonnegative weighted mean of two equations with the least variance (M32)."""
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

    ``z``: instruments from matching half cycles. ``replicates``: replicates; empty to use matching
    half cycles alone.
    """
    half_cycles = equation_of_half_cycles(point, z, jacobian, residual)
    if not replicates:
        return half_cycles
    other = replicate_instruments(point, z, replicates)
    return least_variance(half_cycles, equation(point, other, jacobian, residual))


_ROUNDING = 1e-12
"""Share of the information on a parameter below which a segment counts as having no information."""


def inflation_factors(
    segments: Array, lengths: NDArray[np.int64], recordings: NDArray[np.int64], most: float
) -> Array:
    """Return the factor on the standard deviations of each segment's residuals, shape (m,); for
    most segments the factor is 1.

    Args:
        segments: Information of each segment on the parameters, breakaway times eliminated, shape
            (m, p, p).
        lengths: Number of samples of each segment, shape (m,).
        recordings: Number of each segment's recording, shape (m,).
        most: Greatest information of a segment without inflation, relative to the median of the
            segments of its recording.
    """
    information = np.einsum("mkk->mk", segments)
    information = np.where(information > _ROUNDING * np.sum(information, axis=0), information, 0.0)
    out = np.ones(len(information))
    for k in np.unique(recordings):
        here = recordings == k
        out[here] = np.sqrt(np.maximum(_excess(information[here], lengths[here]) / most, 1.0))
    return out


def _excess(information: Array, lengths: NDArray[np.int64]) -> Array:
    """Return each segment's information over the median's, for the worst parameter, (m,)."""
    order = np.argsort(information, axis=0)
    middle = np.argmax(2 * np.cumsum(lengths[order], axis=0) >= np.sum(lengths), axis=0)
    usual = np.take_along_axis(
        information, np.take_along_axis(order, middle[None], axis=0), axis=0
    )[0]
    return np.asarray(
        np.max(information / np.where(usual > 0.0, usual, np.inf), axis=1, initial=0.0)
    )


SOLVED = 3.0  # chi-square below which the estimating equations count as solved (M29)
ROUNDS = 6  # greatest number of rounds, each with new instruments, weights and derivatives
_LEVEL_ROUNDS = (0, 2)
_CHORDS = 8
_HALVINGS = 5
_LONGEST_LOG = 0.4
_LONGEST_SHIFT = 2.0
_SETTLED = 0.05
_TURNS = 8
_MOST = 3.0  # information of a segment over the recording's median above which it is inflated (M13)
_CHORD_SETTLED = 0.02


def solve(point: Point) -> Point:
    """Return the solution of the estimating equations, by a search that starts from ``point``."""
    count = len(point.free)
    for turn in range(ROUNDS):
        if turn in _LEVEL_ROUNDS:
            point = replace(point, noise=likeliest_noise(point))
        begun = point.origin()[:count]
        point, deviation = _round(point)
        moved = np.abs(point.origin()[:count] - begun) / deviation
        if turn >= _LEVEL_ROUNDS[-1] and float(np.max(moved)) < _SETTLED:
            break
    return point


def _round(point: Point) -> tuple[Point, Array]:
    """Solve the equations with fixed instruments by chord steps; return point and deviations."""
    held, x, residual, jacobian = point.linearised()
    z = instruments(point, jacobian)
    count = len(point.free)
    bread = np.linalg.inv(z.product(huber_weight(residual, HUBER_THRESHOLD), jacobian))
    power = z.product()
    metric = np.linalg.pinv(power, hermitian=True)
    deviation = np.sqrt(np.abs(np.diag(bread @ power @ bread.T)))[:count]
    score = z.back(residual * huber_weight(residual, HUBER_THRESHOLD))
    for _ in range(_CHORDS):
        step = -bread @ score
        logs = [abs(s) for s, k in zip(step, point.free, strict=False) if k in LOGARITHMIC]
        share = min(
            1.0,
            _LONGEST_LOG / max([*logs, 1e-9]),
            _LONGEST_SHIFT / float(np.max(np.abs(step[count:]))),
        )
        for _ in range(_HALVINGS):
            there = held.residuals(x + share * step)
            then = z.back(there * huber_weight(there, HUBER_THRESHOLD))
            if then @ metric @ then < score @ metric @ score:
                break
            share *= 0.5
        else:
            break
        x, score = x + share * step, then
        if float(np.max(np.abs(step[:count]) / deviation)) < _CHORD_SETTLED:
            break
    return point.moved(x), np.asarray(deviation)


def equations_chi2(point: Point) -> float:
    """Return the chi-square of the estimating equations at a point (M29)."""
    _, _, residual, jacobian = point.linearised()
    z = instruments(point, jacobian)
    score = z.back(residual * huber_weight(residual, HUBER_THRESHOLD))
    return float(score @ np.linalg.pinv(z.product(), hermitian=True) @ score)


def fit_beside_inertia(point: Point, refine: Callable[[Point], Searched]) -> Searched:
    """Fit the inertia by its estimating equation and all other parameters by likelihood, in turn.

    Maximum likelihood is strongly biased in the inertia only. For all other parameters it is more
    precise than estimating equations with instruments that are means over a few segments, and its
    search stays in its basin. In the estimating equation of the inertia all other unknowns are
    eliminated, so that errors of these unknowns have an effect of second order only (M30, M31).

    Args:
        point: Point at the end of the unloaded and loaded fits.
        refine: Function that maximises the likelihood over the free parameters from a point.
    """
    free = point.free
    others = tuple(k for k in free if k != INERTIA)
    low, high = (-np.inf, 0.0), (np.inf, 0.0)
    iterations = 0
    for _ in range(_TURNS):
        if others:
            found = refine(_inflated(point, others))
            point, iterations = found.point.freeing(free), iterations + found.iterations
        if others == free:
            break
        point = replace(point, noise=likeliest_noise(point))
        step, deviation = _inertia_step(point)
        if not math.isfinite(step):
            raise np.linalg.LinAlgError("the estimating equation does not determine the inertia")
        here = float(np.log(point.vector[INERTIA]))
        low, high = ((here, step), high) if step > 0.0 else (low, (here, step))
        there = here + float(np.clip(step, -_LONGEST_LOG, _LONGEST_LOG))
        if not low[0] < there < high[0]:
            there = (low[0] * high[1] - high[0] * low[1]) / (high[1] - low[1])
        vector = point.vector.copy()
        vector[INERTIA] = np.exp(there)
        point, iterations = replace(point, vector=vector), iterations + 1
        if abs(there - here) < _SETTLED * deviation:
            break
    # Variance inflation depends on the parameters; therefore it is computed anew at the end of the
    # fit.
    return Searched(_inflated(point, others).freeing(free), iterations)


def _inflated(point: Point, others: tuple[int, ...]) -> Point:
    """Return the point with the parameters ``others`` free and inflation computed for them."""
    return replace(point.freeing(others), inflation=segment_inflation(point, others))


def _inertia_step(point: Point) -> tuple[float, float]:
    """Return the step in log J that solves the linearised equation, and its deviation."""
    _, _, residual, jacobian = point.linearised()
    influence = influence_on_inertia(point, instruments(point, jacobian), jacobian, residual)
    return -float(influence @ (residual * huber_weight(residual, HUBER_THRESHOLD))), float(
        np.linalg.norm(influence)
    )


def segment_inflation(point: Point, others: Sequence[int]) -> Array:
    """Return each segment's variance inflation for the estimate of ``others``, (m,) (M13)."""
    # Derivatives with respect to all free parameters are computed, because the callers need them
    # next.
    jacobian = replace(point, inflation=np.ones(point.breakaways)).linearised()[3]
    for j in reversed([j for j, k in enumerate(point.free) if k not in others]):
        jacobian = jacobian.without(j)
    return inflation_by(point.experiment, jacobian)


def inflation_by(experiment: Experiment, jacobian: BlockArrow) -> Array:
    """Return the variance inflation computed from sensitivities without inflation, shape (m,)."""
    information = jacobian.information_by_block()
    numbers = np.arange(len(experiment.motions), dtype=np.int64)
    recordings = np.repeat(numbers, [len(m.table) for m in experiment.motions])
    return inflation_factors(information, experiment.lengths, recordings, _MOST)
