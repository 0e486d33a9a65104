"""Recordings that are fitted together, and the Kalman filter that runs over their segments."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from identification.filter.kalman import innovations
from identification.filter.noise import Noise
from identification.filter.segment_table import FIRST, LAST, TORQUE_RATE
from identification.filter.segments import Motion
from identification.filter.sensitivity import sensitivities
from identification.filter.tangents import seeded
from identification.model.parameters import COULOMB_OF, INDEX
from identification.numerics.arrays import Array, BoolArray
from identification.numerics.two_threads import both
from identification.recording import Model

_FORGOTTEN = math.pi**2 / 3.0
"""Exponent of the share of the quantisation error that is the same in all readings despite noise of
the angle (M20). Averaged over noise of variance v, the first harmonic of the quantisation error
falls by exp(-(2 pi)^2 v / (12 q)), where q is a twelfth of the squared encoder step (Widrow, IRE
Trans. Circuit Theory 3 (1956) 266).
"""
_LEAST_SHARED = 30000.0
"""Number of integration steps above which a second thread saves time."""

COST_OF_SENSITIVITIES = 3
"""Computing time of a pass with sensitivities, in passes without sensitivities."""

_Place = tuple[bytes, tuple[bytes, ...], Noise]
"""Parameters, breakaway times and noise of a run."""

_Part = list[tuple[int, slice]]
"""A subset of the segments: pairs of the number of a recording and rows of the table of its
segments.
"""


@dataclass(frozen=True, eq=False)
class Heads:
    """The first samples of every segment; the breakaway time affects no later sample of the
    segment.

    Attributes:
        tables: Tables of segments that end after these samples, one per recording, shape (m, 4).
        inside: Whether a sample is among these first samples, one array per recording.
        rows: Whether an innovation belongs to one of these first samples, shape (r - m,).
        halves: Two sets of the segments of about equal computing time.
    """

    tables: tuple[Array, ...]
    inside: tuple[BoolArray, ...]
    rows: BoolArray
    halves: tuple[_Part, _Part]


@dataclass(frozen=True, eq=False)
class Experiment:
    """Recordings that are fitted together; m segments, r residuals.

    Attributes:
        motions: Recordings with their segments.
        statics: Fixed static levels, each as index of the Coulomb level, index of the rise, and
            value.
    """

    motions: tuple[Motion, ...]
    statics: tuple[tuple[int, int, float], ...] = ()

    @classmethod
    def of(cls, motions: Sequence[Motion], model: Model) -> Experiment:
        """Return the experiment of these recordings, with the static levels that the declared model
        fixes.
        """
        statics = [(COULOMB_OF[n], INDEX[n], v) for n, v in model.fixed.items() if n in COULOMB_OF]
        return cls(tuple(motions), tuple(statics))

    @cached_property
    def breakaways(self) -> int:
        """Number of segments."""
        return sum(len(m.table) for m in self.motions)

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """Number of the segment of every residual, over all recordings, shape (r,); the ties come
        last.
        """
        inside = [self._owners(m, j) for j, m in enumerate(self.motions)]
        return np.concatenate([*inside, np.arange(self.breakaways)])

    def _owners(self, m: Motion, j: int) -> NDArray[np.int64]:
        """Return the segment number, over all recordings, of each sample inside a segment."""
        offset = sum(len(other.table) for other in self.motions[:j])
        owner = np.zeros(len(m.time), dtype=np.int64)
        for k, (first, last, _, _) in enumerate(m.table.astype(np.int64)):
            owner[first:last] = offset + k
        return owner[m.inside]

    @cached_property
    def lengths(self) -> NDArray[np.int64]:
        """Samples of each segment, shape (m,)."""
        inside = self.owners[: len(self.owners) - self.breakaways]
        return np.bincount(inside, minlength=self.breakaways)

    @cached_property
    def samples(self) -> NDArray[np.int64]:
        """Number of each innovation's sample in its segment, from zero, shape (r - m,)."""
        starts = np.cumsum(self.lengths) - self.lengths
        inside = self.owners[: len(self.owners) - self.breakaways]
        return np.asarray(np.arange(len(inside)) - starts[inside])

    def heads(self, samples: int) -> Heads:
        """Return the first ``samples`` samples of every segment that starts from rest."""
        tables, inside = [], []
        for m in self.motions:
            table, mask = m.table.copy(), np.zeros(len(m.time), dtype=bool)
            from_rest = table[:, TORQUE_RATE] > 0.0
            longest = np.where(from_rest, samples, 0)
            table[:, LAST] = np.minimum(table[:, LAST], table[:, FIRST] + longest)
            for first, last in table[:, [FIRST, LAST]].astype(np.int64):
                mask[first:last] = True
            tables.append(table)
            inside.append(mask)
        rows = [mask[m.inside] for m, mask in zip(self.motions, inside, strict=True)]
        halves = _halves(self.motions, tables)
        return Heads(tuple(tables), tuple(inside), np.concatenate(rows), halves)

    @cached_property
    def matching_count(self) -> Array:
        """Number of matching half cycles of every residual's segment, including the segment itself,
        shape (r,).
        """
        counts = np.concatenate(
            [np.sum(m.matching, axis=1).astype(np.float64) for m in self.motions]
        )
        return np.asarray(counts[self.owners])


class Filter:
    """Runs the Kalman filter over all recordings of an experiment; the filter owns its buffers.

    A filter keeps the result of the last run over whole segments, because searches begin and end at
    the point of the last run. Results are read-only copies. A filter is not thread-safe.

    Args:
        experiment: The recordings.

    Attributes:
        experiment: The recordings.
        evaluations: Number of runs so far, without repetitions of the last one.
    """

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        self.evaluations = 0
        self._last: tuple[_Place, tuple[Array, Array]] | None = None
        motions = experiment.motions
        self._errors, self._deviations, self._speeds, self._correlated = (
            [np.zeros(len(m.time)) for m in motions] for _ in range(4)
        )
        self._halves = _halves(motions, [m.table for m in motions])

    def run(
        self, p: Array, times: Sequence[Array], noise: Noise, heads: Heads | None = None
    ) -> tuple[Array, Array]:
        """Filter every recording; return the innovations inside segments and their standard
        deviations, rad.

        Args:
            p: Vector of :mod:`identification.model.parameters`.
            times: Breakaway times, s, one array per recording.
            noise: Noise of torque and angle.
            heads: First samples of the segments; only these samples are filtered and returned. None
                for whole segments.
        """
        if heads is not None:
            tables = heads.tables
            self._shared(heads.halves, lambda part: self._filter(part, tables, p, times, noise))
            return self._found(heads.inside)
        place = (p.tobytes(), tuple(t.tobytes() for t in times), noise)
        if self._last is None or self._last[0] != place:
            self._last = place, self._run(p, times, noise)
        return self._last[1]

    def _run(self, p: Array, times: Sequence[Array], noise: Noise) -> tuple[Array, Array]:
        """Filter whole segments; return the innovations and their standard deviations, rad."""
        motions = self.experiment.motions
        tables = [m.table for m in motions]
        self.evaluations += 1
        self._shared(self._halves, lambda part: self._filter(part, tables, p, times, noise))
        return self._found([m.inside for m in motions])

    def _found(self, inside: Sequence[BoolArray]) -> tuple[Array, Array]:
        """Return read-only copies of the last innovations and standard deviations, rad."""
        return _joined(self._errors, inside), _joined(self._deviations, inside)

    def correlated_torque(self, p: Array, times: Sequence[Array], noise: Noise) -> list[Array]:
        """Return the filtered correlated noise of the torque, N m, one array per recording; only
        the values inside segments are meaningful. The arguments are those of :meth:`run`.
        """
        self._run(p, times, noise)
        return [hidden.copy() for hidden in self._correlated]

    def sensitivities(
        self, p: Array, times: Sequence[Array], noise: Noise, seeds: Array
    ) -> tuple[Array, Array]:
        """Return the derivatives of the innovations inside segments, rad, and the derivatives of
        the logarithms of their standard deviations, shape (r - m, d) each.

        Args:
            p: Vector of :mod:`identification.model.parameters`.
            times: Breakaway times, s, one array per recording.
            noise: Noise of torque and angle, which is constant.
            seeds: Directions, shape (d, :data:`identification.filter.sensitivity.SEEDS`).
        """
        motions = self.experiment.motions
        self.evaluations += COST_OF_SENSITIVITIES
        shape = len(seeds)
        slopes, widenings = ([np.zeros((len(m.time), shape)) for m in motions] for _ in range(2))

        def part_of(part: _Part) -> None:
            tangents = seeded(seeds)
            for j, rows in part:
                m = motions[j]
                samples = (m.time, m.angle, m.torque, m.slope, m.moment, m.steps, m.unsure)
                sensitivities(
                    m.table[rows], times[j][rows], samples, m.extra_inertia, _levels(m, noise), p,
                    tangents, slopes[j], widenings[j],
                )  # fmt: skip

        self._shared(self._halves, part_of)
        inside = [m.inside for m in motions]
        return _joined(slopes, inside), _joined(widenings, inside)

    @staticmethod
    def _shared(halves: tuple[_Part, _Part], work: Callable[[_Part], None]) -> None:
        """Run a computation for both halves of the segments, the second half in another thread
        unless that half is empty.
        """
        one, other = halves
        if other:
            both(lambda: work(one), lambda: work(other))
        else:
            work(one)

    def _filter(
        self,
        part: _Part,
        tables: Sequence[Array],
        p: Array,
        times: Sequence[Array],
        noise: Noise,
    ) -> None:
        """Filter a subset of the segments; another thread may filter the other segments at the same
        time.
        """
        for j, rows in part:
            m = self.experiment.motions[j]
            innovations(
                tables[j][rows], times[j][rows], m.time, m.angle, m.torque, m.slope, m.moment,
                m.extra_inertia, _levels(m, noise), m.steps, m.unsure, p,
                self._errors[j], self._deviations[j], self._speeds[j], self._correlated[j],
            )  # fmt: skip


def _levels(m: Motion, noise: Noise) -> Array:
    """Return the noise of a recording as the noise vector of the compiled kernels, shape (5,)."""
    variance = m.angle_variance + noise.angle**2
    staying = m.angle_variance * math.exp(-_FORGOTTEN * noise.angle**2 / m.angle_variance)
    return np.array([noise.torque, variance, noise.correlated, noise.correlation_s, staying])


def _joined(values: Sequence[Array], inside: Sequence[BoolArray]) -> Array:
    """Return a read-only copy of the values of the samples inside segments, over all recordings."""
    joined = np.concatenate([v[where] for v, where in zip(values, inside, strict=True)])
    joined.flags.writeable = False
    return joined


def _halves(motions: Sequence[Motion], tables: Sequence[Array]) -> tuple[_Part, _Part]:
    """Split the segments into two sets of about equal computing time.

    The second set is empty where a second thread would not save time. A segment that does not start
    from rest continues the segment before it, and both stay in one set.
    """
    costs = [
        [float(np.sum(m.steps[int(a) : int(b)])) for a, b in table[:, : LAST + 1]]
        for m, table in zip(motions, tables, strict=True)
    ]
    whole = sum(map(sum, costs))
    left = 0.5 * whole if whole > _LEAST_SHARED else math.inf
    parts: tuple[_Part, _Part] = ([], [])
    for j, (table, cost) in enumerate(zip(tables, costs, strict=True)):
        cut = int(np.searchsorted(np.cumsum(cost), left))
        while 0 < cut < len(cost) and not table[cut, TORQUE_RATE] > 0.0:
            cut += 1
        left -= sum(cost[:cut])
        for part, rows in zip(parts, (slice(0, cut), slice(cut, len(cost))), strict=True):
            if rows.stop > rows.start:
                part.append((j, rows))
    return parts
