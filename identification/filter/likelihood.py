"""Residuals of the likelihood and their derivatives: prediction errors and ties (M22, M23)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from identification.filter.experiment import Experiment, Filter, Heads
from identification.filter.kalman import DIRECTION, FIRST, LAST, SEEDS, START
from identification.filter.segments import Motion, Noise
from identification.model.parameters import (
    ALPHA,
    LOAD_RISE,
    LOGARITHMIC,
    MC,
    MU_C,
    OFFSET,
    SYSTEM_RISE,
)
from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled
from identification.numerics.least_squares import BlockArrow, huber, huber_weight
from identification.recording import Model


def bounded(slopes: Array, ties: Array, scale: Array, bound: Array) -> tuple[Array, Array]:
    """Return the derivatives of innovations, shape (r - m, d), and of ties, shape (m, d), divided
    by the scale of their row and limited to the bound of their column; undefined derivatives become
    zero. The result has the columns of the parameters, shape (r, d - 1), and the column of the
    breakaway time, shape (r,).
    """
    parameters, own = np.empty((len(scale), len(bound) - 1)), np.empty(len(scale))
    cut = len(slopes)
    _limit(slopes, scale[:cut], bound, parameters[:cut], own[:cut])
    _limit(ties, scale[cut:], bound, parameters[cut:], own[cut:])
    return parameters, own


@compiled
def _limit(slopes: Array, scale: Array, bound: Array, parameters: Array, own: Array) -> None:
    """Fill ``parameters`` and ``own`` as described in :func:`bounded`."""
    last = slopes.shape[1] - 1
    for r in range(len(slopes)):
        for j in range(last + 1):
            slope = slopes[r, j] / scale[r]
            slope = min(max(slope, -bound[j]), bound[j]) if slope == slope else 0.0
            if j < last:
                parameters[r, j] = slope
            else:
                own[r] = slope


def static_limit(p: Array, m: Motion) -> Array:
    """Return the static limit Ms + F_P L1 mu_s (M3) at each breakaway, N m, shape (m,)."""
    return np.asarray(p[MC] + p[SYSTEM_RISE] + m.breakaway_moment * (p[MU_C] + p[LOAD_RISE]))


def static_slopes(seeds: Array, m: Motion) -> Array:
    """Return the derivative of the static limit (M3) at each breakaway, N m, (m, d)."""
    load = (seeds[:, MU_C] + seeds[:, LOAD_RISE])[None] * m.breakaway_moment[:, None]
    return np.asarray((seeds[:, MC] + seeds[:, SYSTEM_RISE])[None] + load)


def static_crossings(p: Array, motions: Sequence[Motion]) -> tuple[Array, ...]:
    """Return when the torque first reaches the static limit, s, one array per recording."""
    return tuple(m.static_crossing(static_limit(p, m)) for m in motions)


HUBER_THRESHOLD = 4.0
"""Size of an innovation, in standard deviations, above which it counts as an outlier."""
_FARTHEST_LOG = 6.0
"""Greatest change of a logarithmic parameter in one fit, so that the filter does not overflow."""
_TIME_SCALE_S = _TIME_STEP = 1e-3
_SHIFTS_S = tuple(2.5e-4 * k for k in range(-16, 17) if k)
"""Alternative breakaway times that are tried, relative to the present breakaway time."""
PARAMETER_STEP, _LEAST_SCALE = 1e-4, 1e-3
"""Step of finite differences: share of a coordinate's size, and least size."""
_GREATEST_CHANGE = 10.0
"""Greatest change of a residual, in standard deviations, or of the logarithm of its standard
deviation, over one step of a finite difference.
"""
_TIE_STEP_S = 1e-6  # step of a breakaway time for the slope of the torque at the breakaway
_UNFELT = 1e-6  # change of a residual below which a shift of the breakaway has no effect on it
_LEAST_SAMPLES = 40
"""Least samples of a segment over which the filter is run for other breakaway times."""
_LEAST_GAIN = 0.5
"""Least decrease of a segment's Huber cost for which its breakaway time is changed."""


@dataclass(frozen=True, eq=False)
class Point:
    """A point in the search space of an experiment, with all inputs of the filter.

    A free vector ``x`` has the coordinates of the free parameters first, then the breakaway times
    of all segments. A point is immutable; a search returns another point.
    """

    filter: Filter  # the experiment's filter, which all points of the experiment share
    vector: Array  # parameters, vector of `parameters`
    free: tuple[int, ...]  # indices of the free parameters in that vector
    noise: Noise  # noise of torque and angle
    breakaway_times: tuple[Array, ...]  # breakaway times, s, one array per recording
    inflation: Array  # factor on the standard deviations of each segment (M13), shape (m,)

    @classmethod
    def of(
        cls,
        motions: Sequence[Motion],
        vector: Array,
        free: Sequence[int],
        model: Model,
        noise: Noise,
    ) -> Point:
        """Return a point without inflation; breakaways are where torque reaches the limit."""
        experiment = Experiment.of(motions, model)
        return cls(
            Filter(experiment),
            vector,
            tuple(free),
            noise,
            static_crossings(vector, experiment.motions),
            np.ones(experiment.breakaways),
        )

    @property
    def experiment(self) -> Experiment:
        """The recordings."""
        return self.filter.experiment

    @property
    def motions(self) -> tuple[Motion, ...]:
        """Recordings with their segments."""
        return self.experiment.motions

    @property
    def breakaways(self) -> int:
        """Number of segments."""
        return self.experiment.breakaways

    @property
    def owners(self) -> NDArray[np.int64]:
        """Number of the segment of every residual, shape (r,); the ties come last."""
        return self.experiment.owners

    @property
    def alpha(self) -> float:
        """Stribeck exponent."""
        return float(self.vector[ALPHA])

    def freeing(self, free: Sequence[int]) -> Point:
        """Return a copy of the point with other free parameters."""
        return replace(self, free=tuple(free))

    def at(self, vector: Array) -> Point:
        """Return the point with other parameters, and breakaways at their static limit."""
        times = static_crossings(vector, self.motions)
        return replace(self, vector=vector, breakaway_times=times)

    def moved(self, x: Array) -> Point:
        """Return the point that a free vector describes."""
        return replace(self, vector=self.parameters(x), breakaway_times=self.times(x))

    def origin(self) -> Array:
        """Return the free vector of the point itself."""
        p = [np.log(self.vector[k]) if k in LOGARITHMIC else self.vector[k] for k in self.free]
        return np.concatenate([p, np.zeros(self.breakaways)])

    def parameters(self, x: Array) -> Array:
        """Return the vector of all parameters at a free vector."""
        p = self.vector.copy()
        for value, k in zip(x, self.free, strict=False):
            if k in LOGARITHMIC:
                p[k] = self.vector[k] * np.exp(
                    np.clip(value - np.log(self.vector[k]), -_FARTHEST_LOG, _FARTHEST_LOG)
                )
            else:
                p[k] = value
        for coulomb, rise, static in self.experiment.statics:
            p[rise] = static - p[coulomb]
        return p

    def times(self, x: Array) -> tuple[Array, ...]:
        """Return the breakaway times in a free vector, s, one array per recording."""
        shift = _TIME_SCALE_S * x[len(self.free) :]
        cuts = np.cumsum([len(b) for b in self.breakaway_times])[:-1]
        return tuple(
            b + s for b, s in zip(self.breakaway_times, np.split(shift, cuts), strict=True)
        )

    def run(self, noise: Noise | None = None) -> tuple[Array, Array]:
        """Return innovations inside segments and their deviations, rad; see ``noise``."""
        return self.filter.run(
            self.vector, self.breakaway_times, self.noise if noise is None else noise
        )

    def predictions(self, x: Array) -> tuple[Array, Array]:
        """Return innovations (rad), then ties (N m, M22), and their deviations, shape (r,) each."""
        p = self.parameters(x)
        times = self.times(x)
        errors, deviations = self.filter.run(p, times, self.noise)
        return np.concatenate([errors, self.ties(p, times)]), self._inflated(deviations)

    def ties(self, p: Array, times: Sequence[Array]) -> Array:
        """Return the torque at each breakaway time less the static limit, N m (M22), shape (m,)."""
        ends = [
            m.table[:, DIRECTION] * (m.torque_at(t) - p[OFFSET]) - static_limit(p, m)
            for m, t in zip(self.motions, times, strict=True)
        ]
        return np.concatenate(ends)

    def _inflated(self, deviations: Array) -> Array:
        """Return the standard deviations of innovations and ties with variance inflation (M13)."""
        ties = np.full(self.breakaways, self.noise.whole_torque)
        return np.asarray(np.concatenate([deviations, ties]) * self.inflation[self.owners])

    def derivatives(
        self, x: Array, _errors: Array, deviations: Array
    ) -> tuple[BlockArrow, BlockArrow]:
        """Return d errors / d x, divided by the deviations, and d log deviations / d x.

        The derivatives are bounded like the finite differences: in stick-slip a residual depends
        irregularly on the parameters, and its derivative does not predict its change over a step.
        """
        p, times, seeds = self.parameters(x), self.times(x), self._seeds(x)
        errors, widening = self.filter.sensitivities(p, times, self.noise, seeds)
        later = [t + _TIE_STEP_S for t in times]
        along = (self.ties(p, later) - self.ties(p, times)) / _TIE_STEP_S
        limits = [static_slopes(seeds[:, :START], m) for m in self.motions]
        offsets = [m.table[:, DIRECTION, None] * seeds[:, OFFSET] for m in self.motions]
        ties = -np.concatenate(limits) - np.concatenate(offsets) + along[:, None] * seeds[:, START]
        steps = PARAMETER_STEP * np.maximum(np.abs(x[: len(self.free)]), _LEAST_SCALE)
        bound = _GREATEST_CHANGE / np.append(steps, _TIME_STEP)
        rows, ones = self.owners, np.ones_like(deviations)
        return (
            BlockArrow(*bounded(errors, ties, deviations, bound), rows, self.breakaways),
            BlockArrow(*bounded(widening, 0.0 * ties, ones, bound), rows, self.breakaways),
        )

    def _seeds(self, x: Array) -> Array:
        """Return d parameters and breakaway times / d free coordinates, shape (p + 1, SEEDS)."""
        seeds = np.zeros((len(self.free) + 1, SEEDS))
        p = self.parameters(x)
        for j, k in enumerate(self.free):
            seeds[j, k] = p[k] if k in LOGARITHMIC else 1.0
        for coulomb, rise, _ in self.experiment.statics:
            seeds[:, rise] = -seeds[:, coulomb]
        seeds[-1, START] = _TIME_SCALE_S
        return seeds

    def weighted(self, step: float = PARAMETER_STEP) -> Weighted:
        """Return residuals over their deviations as a function of the free vector near here."""
        _, deviations = self.run()
        return Weighted(self, self._inflated(deviations), step)

    def linearised(self) -> tuple[Weighted, Array, Array, BlockArrow]:
        """Return :meth:`weighted` residuals, the free vector of the point, and the residuals and
        their derivatives there.
        """
        held, x = self.weighted(), self.origin()
        residual = held.residuals(x)
        return held, x, residual, held.jacobian(x, residual)

    def differences(
        self, x: Array, change: Callable[[Array], Array], step: float = PARAMETER_STEP
    ) -> tuple[Array, Array]:
        """Return the derivatives of ``change``, of shape (k, r), at ``x``: with respect to the
        parameters, and with respect to the breakaway times.

        One run of the filter gives the derivatives with respect to all breakaway times, because
        each residual depends on one breakaway time only.
        """
        count = len(self.free)
        slopes = []
        for k in range(count):
            there = x.copy()
            there[k] += step * max(abs(x[k]), _LEAST_SCALE)
            slopes.append(change(there) / (there[k] - x[k]))
        there = x.copy()
        there[count:] += _TIME_STEP
        along = change(there) / _TIME_STEP
        return np.stack(slopes, axis=-1) if slopes else np.empty((*along.shape, 0)), along


@dataclass(frozen=True, eq=False)
class Weighted:
    """Residuals near a point: prediction errors and ties over their standard deviations there."""

    point: Point
    deviations: Array  # standard deviations of the residuals at the point, constant, shape (r,)
    step: float = PARAMETER_STEP  # relative step of a coordinate for finite differences

    def residuals(self, x: Array) -> Array:
        """Return :meth:`Point.predictions` over constant standard deviations, (r,)."""
        errors, _ = self.point.predictions(x)
        return np.asarray(errors / self.deviations)

    def jacobian(self, x: Array, here: Array) -> BlockArrow:
        """Return d residuals / d x at ``x``: by sensitivities, or, if ``step`` is wider than the
        default, by finite differences; ``here`` are the residuals at ``x``.
        """
        if self.step == PARAMETER_STEP:
            return self.point.derivatives(x, here, self.deviations)[0]
        parameters, times = self.point.differences(
            x, lambda there: (self.residuals(there) - here)[None], self.step
        )
        return BlockArrow(parameters[0], times[0], self.point.owners, self.point.breakaways)

    def near_breakaways(self, x: Array, here: Array) -> NearBreakaways:
        """Return the residuals as a function of the breakaway times near those of ``x``, with the
        parameters of ``x``. The filter is run only over the samples that breakaway times affect.
        """
        experiment = self.point.experiment
        there = x.copy()
        there[len(self.point.free) :] += _SHIFTS_S[-1] / _TIME_SCALE_S
        after = self.residuals(there)
        inside = slice(0, len(experiment.samples))
        # The condition is written so that a residual that is NaN counts as affected.
        felt = ~(np.abs(after[inside] - here[inside]) <= _UNFELT)
        samples = int(np.max(experiment.samples[felt], initial=_LEAST_SAMPLES - 1)) + 1
        heads = experiment.heads(samples)
        rows = np.append(heads.rows, np.arange(inside.stop, len(here)))
        owners, deviations = self.point.owners[rows], self.deviations[rows]
        return NearBreakaways(self.point, heads, rows, here[rows], owners, deviations)

    def with_best_breakaways(self) -> tuple[Point, bool]:
        """Return the point with each breakaway time at the best value of a grid around the present
        value, and whether any breakaway time changed.

        A noisy torque crosses the static limit more than once, so that the Huber cost of a segment
        has several minima over the breakaway time. One segment in a wrong minimum shifts the static
        limit by several standard errors. Each breakaway time affects one segment only, and is
        chosen by the Huber cost of this segment.
        """
        origin, count = self.point.origin(), len(self.point.free)
        near = self.near_breakaways(origin, self.residuals(origin))
        shift = np.zeros(self.point.breakaways)
        least = near.costs(near.here) - _LEAST_GAIN
        for step in _SHIFTS_S:
            there = origin.copy()
            there[count:] += step / _TIME_SCALE_S
            cost = near.costs(near.residuals(there))
            better = cost < least
            least, shift = np.where(better, cost, least), np.where(better, step, shift)
        origin[count:] += shift / _TIME_SCALE_S
        return self.point.moved(origin), bool(np.any(shift != 0.0))


@dataclass(frozen=True, eq=False)
class NearBreakaways:
    """Residuals as a function of the breakaway times, with fixed parameters, computed only for the
    samples that breakaway times affect.

    The breakaway time affects some hundred samples after the breakaway; a segment may have
    thousands of samples.
    """

    point: Point
    heads: Heads  # samples that the breakaway times affect
    # Numbers of the affected residuals, innovations first and then ties, shape (q,).
    rows: NDArray[np.int64]
    here: Array  # affected residuals at the breakaway times of the point, shape (q,)
    owners: NDArray[np.int64]  # number of the segment of each affected residual, shape (q,)
    deviations: Array  # standard deviation of each affected residual, constant, shape (q,)

    def residuals(self, x: Array) -> Array:
        """Return the affected residuals at a free vector, shape (q,)."""
        p, times = self.point.parameters(x), self.point.times(x)
        errors, _ = self.point.filter.run(p, times, self.point.noise, self.heads)
        return np.concatenate([errors, self.point.ties(p, times)]) / self.deviations

    def by_segment(self, values: Array) -> Array:
        """Return the sum over each segment of one value for each affected residual, shape (m,)."""
        return np.asarray(np.bincount(self.owners, values, self.point.breakaways), dtype=np.float64)

    def costs(self, residuals: Array) -> Array:
        """Return the Huber cost of each segment's affected residuals, shape (m,)."""
        return self.by_segment(huber(residuals, HUBER_THRESHOLD))


class Searched(NamedTuple):
    """End point of a search, and the number of its steps."""

    point: Point
    iterations: int


ROUNDS = 4  # greatest number of Gauss-Newton steps for a breakaway time
LONGEST_STEP_MS = 2.0


@dataclass(frozen=True)
class Reduced:
    """Normal equations of some recordings without breakaway times; p parameters, m segments."""

    normal: Array  # Fisher information of the residuals (unit variance), shape (p, p)
    scores: Array  # gradient of half the sum of squares of each segment's residuals, shape (m, p)
    squares: float  # sum of squared residuals
    neighbours: float  # sum of products of neighbouring residuals
    count: int  # number of residuals


def optimise_breakaway_times(point: Point, rounds: int = ROUNDS) -> Point:
    """Return the point at which each breakaway time minimises its segment's Huber cost; the
    parameters stay fixed.

    The method is Gauss-Newton with one step length per segment: a step that raises the Huber cost
    of its segment is undone and shortened.
    """
    count = len(point.free)
    held = point.weighted()
    x = point.origin()
    near = held.near_breakaways(x, held.residuals(x))
    residual = near.here
    cost = near.costs(residual)
    length = np.ones(point.breakaways)
    for _ in range(rounds):
        there = x.copy()
        there[count:] += 1e-3
        along = (near.residuals(there) - residual) / 1e-3
        weight = huber_weight(residual, HUBER_THRESHOLD)
        own = near.by_segment(weight * along * along)
        step = -near.by_segment(weight * along * residual) / np.where(own > 0.0, own, np.inf)
        trial = x.copy()
        trial[count:] += length * np.clip(step, -LONGEST_STEP_MS, LONGEST_STEP_MS)
        tried = near.residuals(trial)
        tried_cost = near.costs(tried)
        better = tried_cost < cost
        x[count:] = np.where(better, trial[count:], x[count:])
        length = np.where(better, 1.0, 0.25 * length)
        residual = np.where(better[near.owners], tried, residual)
        cost = np.where(better, tried_cost, cost)
    return replace(point, breakaway_times=point.times(x))


def search_breakaway_times(point: Point) -> Point:
    """Return the point with each breakaway at the least local minimum of its Huber cost."""
    there, moved = optimise_breakaway_times(point).weighted().with_best_breakaways()
    return optimise_breakaway_times(there) if moved else there


def reduce(point: Point) -> Reduced:
    """Return the normal equations at a point, with the breakaway times eliminated (M12)."""
    _, _, residual, jacobian = point.linearised()
    found = jacobian.eliminated(residual, huber_weight(residual, HUBER_THRESHOLD))
    inside = residual[: len(residual) - point.breakaways]
    return Reduced(
        normal=found.matrix,
        scores=found.scores,
        squares=float(inside @ inside),
        neighbours=float(inside[1:] @ inside[:-1]),
        count=len(inside),
    )


_NOISE_LEVEL_FARTHEST_LOG = 4.0
_SIMPLEX, _MOST = ((0.0, -1.0), (0.5, -1.0), (0.0, 0.5)), 30
_SIMPLEX_CORRELATED = (
    (0.0, -1.0, 0.0, 0.0),
    (0.5, -1.0, 0.0, 0.0),
    (0.0, 0.5, 0.0, 0.0),
    (0.0, -1.0, 0.5, 0.0),
    (0.0, -1.0, 0.0, 0.5),
)
_MOST_CORRELATED = 90
"""Initial simplex of the noise search, as logarithms, and greatest number of filter runs."""
_SHARES, _PERIODS = (0.5, 1.5), (3.0, 10.0, 30.0, 100.0)
"""Start values of correlated noise: ratio to white noise, correlation time in sample periods."""


def torque_noise(motions: Sequence[Motion]) -> float:
    """Return the torque scatter, N m rms: median third difference inside segments."""
    differences = [np.diff(m.torque, n=3)[m.inside[3:]] for m in motions]
    spread = np.median(np.abs(np.concatenate(differences)))
    return float(1.4826 * spread / np.sqrt(20.0))


def likeliest_noise(point: Point) -> Noise:
    """Return a point's noise levels of least deviance, with a correlated part if it has one."""
    first = point.noise
    unit = np.array([first.torque, math.sqrt(max(m.angle_variance for m in point.motions))])
    simplex, most = np.array(_SIMPLEX), _MOST
    if first.correlated > 0.0:
        unit = np.append(unit, [first.correlated, first.correlation_s])
        simplex, most = np.array(_SIMPLEX_CORRELATED), _MOST_CORRELATED

    def levels(x: Array) -> Noise:
        return Noise(
            *(
                np.exp(np.clip(x, -_NOISE_LEVEL_FARTHEST_LOG, _NOISE_LEVEL_FARTHEST_LOG)) * unit
            ).tolist()
        )

    def cost(x: Array) -> float:
        return deviance(*point.run(levels(x)))

    found = optimize.minimize(
        cost,
        simplex[0],
        method="Nelder-Mead",
        options={"xatol": 0.03, "fatol": 2.0, "maxfev": most, "initial_simplex": simplex},
    )
    return levels(found.x)


def first_correlated_noise(point: Point) -> Noise:
    """Return the likeliest of a few start values for noise with a correlated part."""
    period = max(m.recording.period for m in point.motions)
    tried = [
        replace(point.noise, correlated=share * point.noise.torque, correlation_s=periods * period)
        for share in _SHARES
        for periods in _PERIODS
    ]
    return min(tried, key=lambda noise: deviance(*point.run(noise)))


def repeating_share(point: Point) -> float:
    """Return the share of the filtered correlated noise that matching half cycles have in common
    (M26).

    Noise does not repeat in matching half cycles, but the effect of unmodelled physics does. The
    share is one if a recording has no two matching half cycles in the same direction.
    """
    common, power = 0.0, 0.0
    filtered = point.filter.correlated_torque(point.vector, point.breakaway_times, point.noise)
    cuts = np.cumsum([int(np.sum(m.inside)) for m in point.motions])[:-1]
    for m, hidden in zip(point.motions, np.split(filtered, cuts), strict=True):
        lengths = (m.table[:, LAST] - m.table[:, FIRST]).astype(np.int64)
        last = np.cumsum(lengths)
        first = last - lengths
        same = (
            m.matching & m.matching.T & np.equal.outer(m.table[:, DIRECTION], m.table[:, DIRECTION])
        )
        pairs = np.argwhere(np.triu(same, 1))
        if len(pairs) == 0:
            return 1.0
        for i, j in pairs:
            length = min(last[i] - first[i], last[j] - first[j])
            one, other = hidden[first[i] : first[i] + length], hidden[first[j] : first[j] + length]
            common += float(one @ other)
            power += 0.5 * float(one @ one + other @ other)
    return common / power if power > 0.0 else 1.0


def deviance(errors: Array, deviations: Array, clip: float = HUBER_THRESHOLD) -> float:
    """Return -2 log likelihood of innovations, with outliers clipped (M24)."""
    return float(np.sum(2.0 * np.log(deviations) + np.minimum((errors / deviations) ** 2, clip**2)))
