"""The joint least-squares problem of a refinement: free parameters and breakaway times to residuals and Jacobian."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from threading import Thread

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
"""Farthest, in logarithm, that one fit may take them from its start: beyond, the filter's arithmetic overflows."""
_TIME_SCALE_S = 1e-3
_SHIFTS_S = tuple(2.5e-4 * k for k in range(-16, 17) if k)
"""Where else a breakaway is looked for."""
PARAMETER_STEP, _LEAST_SCALE = 1e-4, 1e-3
_TIME_STEP = 1e-3
_FORGOTTEN = math.pi**2 / 3.0
"""How fast noise of the angle makes its quantisation another one at every sample: a shaft at rest reads q off by what
its place within a step has it, and the first harmonic of that, averaged over noise of variance v, falls by
exp(-(2 pi)^2 v / (12 q)), q being a twelfth of the step squared (Widrow, IRE Trans. Circuit Theory 3 (1956) 266)."""
_LEAST_GAIN = 0.5
"""Of a stretch's Huber cost, for its breakaway to move."""
_LEAST_SHARED = 30000.0
"""Steps of the filter from which a second thread is worth its start."""


class Problem:
    """Residuals and Jacobian of one joint fit: parameters first, then the breakaway times of all stretches."""

    def __init__(
        self, motions: Sequence[Motion], start: Array, free: Sequence[int], model: Model, noise: Noise
    ) -> None:
        self.motions = tuple(motions)
        self.start = start
        self.free = tuple(free)
        self.statics = [(COULOMB_OF[n], INDEX[n], v) for n, v in model.fixed.items() if n in COULOMB_OF]
        self.noise = noise
        self.begins = [np.zeros(len(m.table)) for m in motions]
        self.evaluations = 0
        self.iterations = 0
        self.ends: list[float] = []
        """Defect of every solution of the estimating equations that led anywhere."""
        self.reached: list[tuple[bool, float, Array, list[Array]]] = []
        """Where searches by likelihood ended: whether the Stribeck speed is unresolved, deviance, kernel's vector,
        breakaway times."""
        self.step = PARAMETER_STEP
        """Over which differences in the parameters are taken, over the size of the coordinate."""
        self._out = [np.zeros(len(m.time)) for m in motions]
        self._spread = [np.zeros(len(m.time)) for m in motions]
        self._speeds = [np.zeros(len(m.time)) for m in motions]
        self.hidden = [np.zeros(len(m.time)) for m in motions]
        """Torque that correlated noise hid at each sample of each recording in the last run, N m."""
        self.breakaways = sum(len(m.table) for m in motions)
        inside = [self._owners(m, j) for j, m in enumerate(motions)]
        self.owners = np.concatenate([*inside, np.arange(self.breakaways)])
        """Stretch of every residual, the breakaway residuals last, shape (r,)."""
        self.doubt = np.ones(self.breakaways)
        """How many times larger than it seems each stretch's noise is taken to be, shape (m,)."""

    def _owners(self, m: Motion, j: int) -> NDArray[np.int64]:
        """Number, over all recordings, of the stretch that owns each inside sample."""
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
        """Samples in each stretch, shape (m,)."""
        return np.bincount(self.owners[: len(self.owners) - self.breakaways], minlength=self.breakaways)

    @property
    def siblings(self) -> Array:
        """How many stretches of its recording move like every residual's, itself among them, shape (r,)."""
        counts = np.concatenate([np.sum(m.alike, axis=1).astype(np.float64) for m in self.motions])
        return np.asarray(counts[self.owners])

    def origin(self) -> Array:
        """Return the free vector of the start."""
        p = [np.log(self.start[k]) if k in LOGARITHMIC else self.start[k] for k in self.free]
        return np.concatenate([p, np.zeros(self.breakaways)])

    def parameters(self, x: Array) -> Array:
        """Return the kernel's vector of a free vector."""
        p = self.start.copy()
        for value, k in zip(x, self.free, strict=False):
            if k in LOGARITHMIC:
                p[k] = self.start[k] * np.exp(np.clip(value - np.log(self.start[k]), -_FARTHEST_LOG, _FARTHEST_LOG))
            else:
                p[k] = value
        for coulomb, rise, static in self.statics:
            p[rise] = static - p[coulomb]
        return p

    def run(self, p: Array, times: Sequence[Array], noise: Noise) -> tuple[Array, Array]:
        """Filter every recording; return the prediction errors inside stretches and their standard deviations, rad."""
        self.evaluations += 1
        one, other = self._halves
        if other:
            beside = Thread(target=self._filter, args=(other, p, times, noise))
            beside.start()
            self._filter(one, p, times, noise)
            beside.join()
        else:
            self._filter(one, p, times, noise)
        errors = [out[m.inside] for m, out in zip(self.motions, self._out, strict=True)]
        deviations = [spread[m.inside] for m, spread in zip(self.motions, self._spread, strict=True)]
        return np.concatenate(errors), np.concatenate(deviations)

    def _filter(self, pieces: Sequence[tuple[int, slice]], p: Array, times: Sequence[Array], noise: Noise) -> None:
        """Filter these stretches, each piece some of one recording's; the kernel lets other threads run meanwhile."""
        for j, rows in pieces:
            m, out, spread, speeds = self.motions[j], self._out[j], self._spread[j], self._speeds[j]
            variance = m.angle_variance + noise.angle**2
            staying = m.angle_variance * math.exp(-_FORGOTTEN * noise.angle**2 / m.angle_variance)
            level = np.array([noise.torque, variance, noise.correlated, noise.correlation_s, staying])
            innovations(
                m.table[rows], times[j][rows], m.time, m.angle, m.torque, m.slope, m.moment,
                m.extra_inertia, level, m.steps, m.unsure, p, out, spread, speeds, self.hidden[j],
            )  # fmt: skip

    @cached_property
    def _halves(self) -> tuple[list[tuple[int, slice]], list[tuple[int, slice]]]:
        """The stretches in two parts that take about as long: recording and rows of its table.

        Two processor cores are what a laptop has to spare; the second part is empty where it would be done before a
        thread has begun. A stretch that does not begin at rest goes on where the one before it ended, and stays with
        it.
        """
        costs = [[float(np.sum(m.steps[int(a) : int(b)])) for a, b in m.table[:, : LAST + 1]] for m in self.motions]
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

    def weigh(self) -> None:
        """Hold the prediction errors' weights at what they are at the start."""
        _, deviations = self.run(self.start, self.begins, self.noise)
        self._deviation = self._believed(deviations)

    def _believed(self, deviations: Array) -> Array:
        """Return standard deviations of prediction errors, then of the ties, with the doubt in each stretch."""
        ties = np.full(self.breakaways, self.noise.whole_torque)
        return np.asarray(np.concatenate([deviations, ties]) * self.doubt[self.owners])

    def times(self, x: Array) -> list[Array]:
        """Return the breakaway times of a free vector, s, one array per recording."""
        shift = _TIME_SCALE_S * x[len(self.free) :]
        cuts = np.cumsum([len(b) for b in self.begins])[:-1]
        return [b + s for b, s in zip(self.begins, np.split(shift, cuts), strict=True)]

    def predictions(self, x: Array) -> tuple[Array, Array]:
        """Return prediction errors, rad, then torque at each breakaway less the static limit, N m; and deviations."""
        p = self.parameters(x)
        times = self.times(x)
        errors, deviations = self.run(p, times, self.noise)
        ends = [
            m.table[:, DIRECTION] * (m.torque_at(t) - p[OFFSET]) - static_limit(p, m)
            for m, t in zip(self.motions, times, strict=True)
        ]
        return np.concatenate([errors, *ends]), self._believed(deviations)

    def derivatives(self, x: Array, errors: Array, deviations: Array) -> tuple[BlockArrow, BlockArrow]:
        """Return d errors / d x over the deviations, and d log deviations / d x, by differences."""

        def change(there: Array) -> Array:
            e, d = self.predictions(there)
            return np.stack([(e - errors) / deviations, np.log(d / deviations)])

        parameters, times = self._differences(x, change)
        return self._arrow(parameters[0], times[0]), self._arrow(parameters[1], times[1])

    def residuals(self, x: Array) -> Array:
        """Return the errors of :meth:`predictions` over the deviations that they had when last weighed."""
        errors, _ = self.predictions(x)
        return np.asarray(errors / self._deviation)

    def jacobian(self, x: Array, here: Array) -> BlockArrow:
        """Return d residuals / d x at ``x``, where the residuals are ``here``, by differences."""
        parameters, times = self._differences(x, lambda there: (self.residuals(there) - here)[None])
        return self._arrow(parameters[0], times[0])

    def _differences(self, x: Array, change: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Return the slopes of ``change`` from ``x``, of shape (k, r): in the parameters, and in the breakaway times.

        One run serves all breakaway times, as no stretch sees another's.
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

    def seek_breakaways(self, threshold: float) -> bool:
        """Move each breakaway to the likeliest of a grid of times around it; return whether any moved.

        The measured torque crosses the static limit more than once where it is noisy, so a breakaway time has several
        minima, and one stretch in the wrong one pulls the static limit by several standard errors. No stretch sees
        another's time, so each is judged by its own Huber cost, at these parameters.
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
        """Make this free vector the new start."""
        self.start = self.parameters(x)
        self.begins = self.times(x)


def static_limit(p: Array, m: Motion) -> Array:
    """Return Ms + F_P L1 mu_s at each breakaway, N m, shape (m,)."""
    return np.asarray(p[MC] + p[SYSTEM_RISE] + m.breakaway_moment * (p[MU_C] + p[LOAD_RISE]))
