"""Prediction errors, ties and their derivatives over free parameters and breakaway times (M22,
M23).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from identification.filter.kalman import innovations
from identification.filter.noise import Noise
from identification.filter.segment_table import DIRECTION, LAST, TORQUE_RATE
from identification.filter.segments import Motion
from identification.model.parameters import (
    ALPHA,
    COULOMB_OF,
    INDEX,
    LOAD_RISE,
    LOGARITHMIC,
    MC,
    MU_C,
    OFFSET,
    SYSTEM_RISE,
)
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.levenberg_marquardt import huber
from identification.recording import Model

_FARTHEST_LOG = 6.0
"""Greatest change of a logarithm in one fit, so that the arithmetic of the filter does not
overflow.
"""
_TIME_SCALE_S = 1e-3
_SHIFTS_S = tuple(2.5e-4 * k for k in range(-16, 17) if k)
"""Grid of other breakaway times."""
PARAMETER_STEP, _LEAST_SCALE = 1e-4, 1e-3
_TIME_STEP = 1e-3
_FORGOTTEN = math.pi**2 / 3.0
"""Exponent of the part of the quantisation error that noise of the angle leaves the same at every
reading (M20): the first harmonic of that error, averaged over noise of variance v, falls by exp(-(2
pi)^2 v / (12 q)), where q is a twelfth of the step squared (Widrow, IRE Trans. Circuit Theory 3
(1956) 266).
"""
_LEAST_GAIN = 0.5
"""Least gain in a segment's Huber cost for its breakaway to move."""
_LEAST_SHARED = 30000.0
"""Integration steps above which a second thread saves time."""


class Problem:
    """Residuals and Jacobian of one fit: free parameters first, then the breakaway times of all
    segments.

    Attributes:
        motions: Recordings with their segments.
        start: Parameters about which it is linearised, vector of
        :mod:`identification.model.parameters`.
        free: Places of the free parameters in that vector.
        statics: Fixed static levels: place of the Coulomb level, place of the rise, value.
        noise: Noise of torque and angle.
        breakaway_times: s, one array per recording.
        evaluations: Runs of the filter so far.
        iterations: Iterations of searches so far.
        solution_chi2: Chi-square of every solution of the estimating equations (M29).
        search_ends: End of every search: whether the Stribeck speed is unresolved, deviance,
            parameters, breakaway times.
        step: Difference of a coordinate for slopes, over its size.
        correlated_torque: Filtered correlated noise of the last run, N m, per recording.
        breakaways: Number of segments.
        owners: Segment of every residual, ties last, shape (r,).
        inflation: Factor on the standard deviations of each segment (M13), shape (m,).
    """

    def __init__(
        self,
        motions: Sequence[Motion],
        start: Array,
        free: Sequence[int],
        model: Model,
        noise: Noise,
    ) -> None:
        self.motions = tuple(motions)
        self.start = start
        self.free = tuple(free)
        self.statics = [
            (COULOMB_OF[n], INDEX[n], v) for n, v in model.fixed.items() if n in COULOMB_OF
        ]
        self.noise = noise
        self.breakaway_times = [np.zeros(len(m.table)) for m in motions]
        self.evaluations = 0
        self.iterations = 0
        self.solution_chi2: list[float] = []
        self.search_ends: list[tuple[bool, float, Array, list[Array]]] = []
        self.step = PARAMETER_STEP
        self._out = [np.zeros(len(m.time)) for m in motions]
        self._spread = [np.zeros(len(m.time)) for m in motions]
        self._speeds = [np.zeros(len(m.time)) for m in motions]
        self.correlated_torque = [np.zeros(len(m.time)) for m in motions]
        self.breakaways = sum(len(m.table) for m in motions)
        inside = [self._owners(m, j) for j, m in enumerate(motions)]
        self.owners = np.concatenate([*inside, np.arange(self.breakaways)])
        self.inflation = np.ones(self.breakaways)

    def _owners(self, m: Motion, j: int) -> NDArray[np.int64]:
        """Return the number, over all recordings, of the segment of each sample inside one."""
        offset = sum(len(other.table) for other in self.motions[:j])
        owner = np.zeros(len(m.time), dtype=np.int64)
        for k, (first, last, _, _) in enumerate(m.table.astype(np.int64)):
            owner[first:last] = offset + k
        return owner[m.inside]

    @property
    def alpha(self) -> float:
        """Stribeck exponent."""
        return float(self.start[ALPHA])

    @property
    def lengths(self) -> NDArray[np.int64]:
        """Samples of each segment, shape (m,)."""
        return np.bincount(
            self.owners[: len(self.owners) - self.breakaways], minlength=self.breakaways
        )

    @property
    def matching_count(self) -> Array:
        """Number of matching half cycles of every residual's segment, itself included, shape
        (r,).
        """
        counts = np.concatenate(
            [np.sum(m.matching, axis=1).astype(np.float64) for m in self.motions]
        )
        return np.asarray(counts[self.owners])

    def origin(self) -> Array:
        """Return the free vector at the start."""
        p = [np.log(self.start[k]) if k in LOGARITHMIC else self.start[k] for k in self.free]
        return np.concatenate([p, np.zeros(self.breakaways)])

    def parameters(self, x: Array) -> Array:
        """Return the parameter vector of a free vector."""
        p = self.start.copy()
        for value, k in zip(x, self.free, strict=False):
            if k in LOGARITHMIC:
                p[k] = self.start[k] * np.exp(
                    np.clip(value - np.log(self.start[k]), -_FARTHEST_LOG, _FARTHEST_LOG)
                )
            else:
                p[k] = value
        for coulomb, rise, static in self.statics:
            p[rise] = static - p[coulomb]
        return p

    def run(self, p: Array, times: Sequence[Array], noise: Noise) -> tuple[Array, Array]:
        """Filter every recording; return the innovations inside segments and their standard
        deviations, rad.
        """
        self.evaluations += 1
        one, other = self._halves
        if other:
            with ThreadPoolExecutor(1) as beside:
                half = beside.submit(self._filter, other, p, times, noise)
                self._filter(one, p, times, noise)
            half.result()
        else:
            self._filter(one, p, times, noise)
        errors = [out[m.inside] for m, out in zip(self.motions, self._out, strict=True)]
        deviations = [
            spread[m.inside] for m, spread in zip(self.motions, self._spread, strict=True)
        ]
        return np.concatenate(errors), np.concatenate(deviations)

    def _filter(
        self, pieces: Sequence[tuple[int, slice]], p: Array, times: Sequence[Array], noise: Noise
    ) -> None:
        """Filter some segments: number of a recording and rows of its table.

        Another thread may run meanwhile.
        """
        for j, rows in pieces:
            m, out, spread, speeds = self.motions[j], self._out[j], self._spread[j], self._speeds[j]
            variance = m.angle_variance + noise.angle**2
            staying = m.angle_variance * math.exp(-_FORGOTTEN * noise.angle**2 / m.angle_variance)
            level = np.array(
                [noise.torque, variance, noise.correlated, noise.correlation_s, staying]
            )
            innovations(
                m.table[rows], times[j][rows], m.time, m.angle, m.torque, m.slope, m.moment,
                m.extra_inertia, level, m.steps, m.unsure, p, out, spread, speeds,
                self.correlated_torque[j],
            )  # fmt: skip

    @cached_property
    def _halves(self) -> tuple[list[tuple[int, slice]], list[tuple[int, slice]]]:
        """Two sets of segments that take about equal time: number of the recording and rows of its
        table.

        The second set is empty where a second thread would not save time. A segment that does not
        start from rest continues the one before it and stays with it.
        """
        costs = [
            [float(np.sum(m.steps[int(a) : int(b)])) for a, b in m.table[:, : LAST + 1]]
            for m in self.motions
        ]
        whole = sum(map(sum, costs))
        left = 0.5 * whole if whole > _LEAST_SHARED else math.inf
        parts: tuple[list[tuple[int, slice]], list[tuple[int, slice]]] = ([], [])
        for j, (m, cost) in enumerate(zip(self.motions, costs, strict=True)):
            cut = int(np.searchsorted(np.cumsum(cost), left))
            while 0 < cut < len(cost) and not m.table[cut, TORQUE_RATE] > 0.0:
                cut += 1
            left -= sum(cost[:cut])
            for part, rows in zip(parts, (slice(0, cut), slice(cut, len(cost))), strict=True):
                if rows.stop > rows.start:
                    part.append((j, rows))
        return parts

    def hold_weights(self) -> None:
        """Take the deviations at the start for the residuals of :meth:`residuals`."""
        _, deviations = self.run(self.start, self.breakaway_times, self.noise)
        self._deviation = self._inflated(deviations)

    def _inflated(self, deviations: Array) -> Array:
        """Return the deviations of innovations and ties with variance inflation (M13)."""
        ties = np.full(self.breakaways, self.noise.whole_torque)
        return np.asarray(np.concatenate([deviations, ties]) * self.inflation[self.owners])

    def times(self, x: Array) -> list[Array]:
        """Return the breakaway times of a free vector, s, one array per recording."""
        shift = _TIME_SCALE_S * x[len(self.free) :]
        cuts = np.cumsum([len(b) for b in self.breakaway_times])[:-1]
        return [b + s for b, s in zip(self.breakaway_times, np.split(shift, cuts), strict=True)]

    def predictions(self, x: Array) -> tuple[Array, Array]:
        """Return innovations, rad, then ties (M22), N m, and the standard deviations of both, shape
        (r,).
        """
        p = self.parameters(x)
        times = self.times(x)
        errors, deviations = self.run(p, times, self.noise)
        ends = [
            m.table[:, DIRECTION] * (m.torque_at(t) - p[OFFSET]) - static_limit(p, m)
            for m, t in zip(self.motions, times, strict=True)
        ]
        return np.concatenate([errors, *ends]), self._inflated(deviations)

    def derivatives(
        self, x: Array, errors: Array, deviations: Array
    ) -> tuple[BlockArrow, BlockArrow]:
        """Return d errors / d x over the deviations, and d log deviations / d x, by differences."""

        def change(there: Array) -> Array:
            e, d = self.predictions(there)
            return np.stack([(e - errors) / deviations, np.log(d / deviations)])

        parameters, times = self._differences(x, change)
        return self._arrow(parameters[0], times[0]), self._arrow(parameters[1], times[1])

    def residuals(self, x: Array) -> Array:
        """Return the errors of :meth:`predictions` over the deviations of the last
        :meth:`hold_weights`.
        """
        errors, _ = self.predictions(x)
        return np.asarray(errors / self._deviation)

    def jacobian(self, x: Array, here: Array) -> BlockArrow:
        """Return d residuals / d x at ``x``, where the residuals are ``here``, by differences."""
        parameters, times = self._differences(x, lambda there: (self.residuals(there) - here)[None])
        return self._arrow(parameters[0], times[0])

    def _differences(self, x: Array, change: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Return the slopes of ``change`` from ``x``, of shape (k, r): in the parameters, and in
        the breakaway times.

        One run serves all breakaway times, because no residual depends on two of them.
        """
        count = len(self.free)
        slopes = []
        for k in range(count):
            there = x.copy()
            there[k] += self.step * max(abs(x[k]), _LEAST_SCALE)
            slopes.append(change(there) / (there[k] - x[k]))
        there = x.copy()
        there[count:] += _TIME_STEP
        along = change(there) / _TIME_STEP
        return np.stack(slopes, axis=-1) if slopes else np.empty((*along.shape, 0)), along

    def _arrow(self, parameters: Array, times: Array) -> BlockArrow:
        return BlockArrow(parameters, times, self.owners, self.breakaways)

    def move_breakaways(self, threshold: float) -> bool:
        """Move each breakaway time to the best of a grid of times around it; return whether any
        moved.

        Noisy torque crosses the static limit more than once, so that a breakaway time has several
        minima, and one segment in the wrong one shifts the static limit by several standard errors.
        Segments share no breakaway time, so that each is judged by its own Huber cost.
        """
        origin, count = self.origin(), len(self.free)
        owners = self.owners
        best = np.bincount(owners, huber(self.residuals(origin), threshold))
        shift = np.zeros(self.breakaways)
        least = best - _LEAST_GAIN
        for step in _SHIFTS_S:
            there = origin.copy()
            there[count:] += step / _TIME_SCALE_S
            cost = np.bincount(owners, huber(self.residuals(there), threshold))
            better = cost < least
            least, shift = np.where(better, cost, least), np.where(better, step, shift)
        origin[count:] += shift / _TIME_SCALE_S
        self.keep(origin)
        return bool(np.any(shift != 0.0))

    def keep(self, x: Array) -> None:
        """Make this free vector the start."""
        self.start = self.parameters(x)
        self.breakaway_times = self.times(x)


def static_limit(p: Array, m: Motion) -> Array:
    """Return the static limit Ms + F_P L1 mu_s (M3) at each breakaway, N m, shape (m,)."""
    return np.asarray(p[MC] + p[SYSTEM_RISE] + m.breakaway_moment * (p[MU_C] + p[LOAD_RISE]))
