"""Recordings that are fitted together, and the Kalman filter that runs over their segments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from identification.filter.kalman import (
    ANGLE,
    AT_ONCE,
    BEFORE,
    DEVIATION,
    ERROR,
    FILTERED,
    FIRST,
    LANES,
    LAST,
    MOMENT,
    SAMPLE_COLUMNS,
    SLOPE,
    STEPS,
    TIME,
    TORQUE,
    UNSURE,
    innovations,
    sensitivities,
)
from identification.filter.segments import Motion, Noise
from identification.model.parameters import COULOMB_OF, INDEX
from identification.numerics.arrays import Array
from identification.numerics.compiled import both, idle
from identification.recording import Model

COST_OF_SENSITIVITIES = 3
"""Filter runs as which one run with sensitivities counts, by its computing time."""

_Place = tuple[bytes, tuple[bytes, ...], Noise]  # parameters, breakaway times and noise of a run


@dataclass(frozen=True, eq=False)
class Lineup:
    """Motion segments in the order in which the filter processes them, the longest first."""

    table: Array  # table of segments, shape (m, 7)
    order: NDArray[np.int64]  # number of each of these segments in the experiment, shape (m,)

    @classmethod
    def of(cls, table: Array) -> Lineup:
        """Return the segments that have samples, in the order of the filter."""
        lengths = table[:, LAST] - table[:, FIRST]
        order = np.argsort(-lengths, kind="stable")
        order = order[lengths[order] > 0.0]
        return cls(table[order], order)

    @cached_property
    def halves(self) -> tuple[Lineup, ...]:
        """The segments in two parts of equal computing time; one if one instruction does all."""
        if len(self.order) <= AT_ONCE:
            return (self,)
        # Kernels are compiled for contiguous arrays.
        return tuple(Lineup(self.table[k::2].copy(), self.order[k::2]) for k in (0, 1))


@dataclass(frozen=True, eq=False)
class Heads:
    """The first samples of every segment: all that the segment's breakaway time affects."""

    lineup: Lineup  # segments that end after these samples
    rows: NDArray[np.int64]  # numbers of the innovations of these first samples, shape (q,)


@dataclass(frozen=True, eq=False)
class Experiment:
    """Recordings that are fitted together; m segments, r residuals."""

    motions: tuple[Motion, ...]  # recordings with their segments
    # Static levels that are not fitted, each as index of the Coulomb level, index of the rise, and
    # value.
    statics: tuple[tuple[int, int, float], ...] = ()

    @classmethod
    def of(cls, motions: Sequence[Motion], model: Model) -> Experiment:
        """Return the experiment of recordings, with the static levels that the model fixes."""
        statics = [(COULOMB_OF[n], INDEX[n], v) for n, v in model.fixed.items() if n in COULOMB_OF]
        return cls(tuple(motions), tuple(statics))

    @cached_property
    def breakaways(self) -> int:
        """Number of segments."""
        return sum(len(m.table) for m in self.motions)

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """Segment of each residual, counted over all recordings, ties last, shape (r,)."""
        inside = np.repeat(np.arange(self.breakaways), self.lengths)
        return np.concatenate([inside, np.arange(self.breakaways)])

    @cached_property
    def lengths(self) -> NDArray[np.int64]:
        """Samples of each segment, shape (m,)."""
        lengths = [(m.table[:, LAST] - m.table[:, FIRST]).astype(np.int64) for m in self.motions]
        return np.concatenate([np.zeros(0, dtype=np.int64), *lengths])

    @cached_property
    def samples(self) -> NDArray[np.int64]:
        """Number of each innovation's sample in its segment, from zero, shape (r - m,)."""
        starts = np.cumsum(self.lengths) - self.lengths
        return np.asarray(np.arange(int(self.lengths.sum())) - np.repeat(starts, self.lengths))

    @cached_property
    def table(self) -> Array:
        """Table of all segments, shape (m, 7), with the columns of
        :mod:`identification.filter.kalman`; the samples of the segments are rows of
        :attr:`table_of_samples`.
        """
        parts = []
        for m in self.motions:
            before = m.angle[m.table[:, FIRST].astype(np.int64) - 1]
            known = np.broadcast_to([m.extra_inertia, m.angle_variance], (len(before), 2))
            parts.append(np.column_stack([m.table, before, known]))
        out = np.concatenate(parts)
        out[:, LAST] = np.cumsum(self.lengths)
        out[:, FIRST] = out[:, LAST] - self.lengths
        return out

    @cached_property
    def table_of_samples(self) -> Array:
        """Table of the samples inside segments, over all recordings, shape (r - m, 8)."""
        out = np.empty((int(self.lengths.sum()), SAMPLE_COLUMNS))
        row = 0
        for m in self.motions:
            at = np.flatnonzero(m.inside)
            here = out[row : row + len(at)]
            here[:, TIME], here[:, BEFORE] = m.time[at], m.time[at - 1]
            here[:, ANGLE], here[:, TORQUE], here[:, SLOPE] = m.angle[at], m.torque[at], m.slope[at]
            here[:, MOMENT], here[:, STEPS] = m.moment[at], m.steps[at]
            here[:, UNSURE] = m.unsure[at]
            row += len(at)
        return out

    @cached_property
    def lineup(self) -> Lineup:
        """All segments in the order in which the filter processes them."""
        return Lineup.of(self.table)

    def heads(self, samples: int) -> Heads:
        """Return the first ``samples`` samples of every segment."""
        table = self.table.copy()
        table[:, LAST] = np.minimum(table[:, LAST], table[:, FIRST] + samples)
        return Heads(Lineup.of(table), np.flatnonzero(self.samples < samples))

    @cached_property
    def matching_count(self) -> Array:
        """Number of matching half cycles of each residual's segment, with itself, shape (r,)."""
        counts = np.concatenate(
            [np.sum(m.matching, axis=1).astype(np.float64) for m in self.motions]
        )
        return np.asarray(counts[self.owners])


class Filter:
    """Runs the Kalman filter over all recordings of an experiment; the filter owns its buffers.

    A filter keeps the innovations of the last run over whole segments, and the last derivatives,
    because a search often needs both again at the same point. Results are read-only copies. A
    filter is not thread-safe.

    Args:
        experiment: The recordings.
    """

    def __init__(self, experiment: Experiment) -> None:
        self.experiment = experiment
        # Number of filter runs so far; a repetition of the last run does not count.
        self.evaluations = 0
        self._last: tuple[_Place, tuple[Array, Array]] | None = None
        self._slopes: tuple[_Place, Array, tuple[Array, Array]] | None = None
        self._found = np.zeros((3, int(experiment.lengths.sum())))

    def run(
        self, p: Array, times: Sequence[Array], noise: Noise, heads: Heads | None = None
    ) -> tuple[Array, Array]:
        """Filter every recording; return the innovations inside segments and their standard
        deviations, rad.

        ``heads``: first samples of the segments, of which alone the innovations are computed and
        returned; None for whole segments.
        """
        if heads is not None:
            self._filter(heads.lineup, p, times, noise)
            return self._found[ERROR, heads.rows], self._found[DEVIATION, heads.rows]
        place = _place(p, times, noise)
        if self._last is None or self._last[0] != place:
            self._last = place, self._run(p, times, noise)
        return self._last[1]

    def _run(self, p: Array, times: Sequence[Array], noise: Noise) -> tuple[Array, Array]:
        """Filter whole segments; return the innovations and their standard deviations, rad."""
        self.evaluations += 1
        self._filter(self.experiment.lineup, p, times, noise)
        found = self._found[: DEVIATION + 1].copy()
        found.flags.writeable = False
        return found[ERROR], found[DEVIATION]

    def correlated_torque(self, p: Array, times: Sequence[Array], noise: Noise) -> Array:
        """Return the filtered correlated noise inside segments, N m, (r - m,); see :meth:`run`."""
        self._run(p, times, noise)
        return np.array(self._found[FILTERED], dtype=np.float64)

    def sensitivities(
        self, p: Array, times: Sequence[Array], noise: Noise, seeds: Array
    ) -> tuple[Array, Array]:
        """Return the derivatives of the innovations inside segments, rad, and the derivatives of
        the logarithms of their standard deviations, shape (r - m, d) each.

        ``seeds``: directions, shape (d, :data:`identification.filter.kalman.SEEDS`).
        """
        place = _place(p, times, noise)
        if self._slopes is not None and self._slopes[0] == place:
            known, found = self._slopes[1:]
            same = np.all(seeds[:, None] == known[None], axis=2)
            if np.all(np.any(same, axis=1)):
                columns = np.argmax(same, axis=1)
                slopes, widenings = (np.ascontiguousarray(s[:, columns]) for s in found)
                return slopes, widenings
        self.evaluations += COST_OF_SENSITIVITIES
        slopes, widenings = (np.zeros((self._found.shape[1], len(seeds))) for _ in range(2))
        samples, begins = self.experiment.table_of_samples, np.concatenate(times)
        levels = _levels(noise)
        _shared(
            self.experiment.lineup,
            lambda part: sensitivities(
                part.table, begins[part.order], samples, levels, p, seeds, slopes, widenings
            ),
            AT_ONCE,
        )
        self._slopes = place, seeds, (slopes, widenings)
        return slopes, widenings

    def _filter(self, lineup: Lineup, p: Array, times: Sequence[Array], noise: Noise) -> None:
        """Filter segments; results go into the filter's buffer."""
        samples, begins = self.experiment.table_of_samples, np.concatenate(times)
        levels = _levels(noise)
        _shared(
            lineup,
            lambda part: innovations(
                part.table, begins[part.order], samples, levels, p, self._found
            ),
            LANES,
        )


def _shared(lineup: Lineup, work: Callable[[Lineup], None], most: int) -> None:
    """Call ``work`` on all segments; two threads share more than ``most`` segments."""
    if len(lineup.order) > most and idle():
        one, other = lineup.halves
        both(lambda: work(one), lambda: work(other))
    else:
        work(lineup)


def _place(p: Array, times: Sequence[Array], noise: Noise) -> _Place:
    return p.tobytes(), tuple(t.tobytes() for t in times), noise


def _levels(noise: Noise) -> Array:
    """Return the noise as the noise vector of the compiled kernels, shape (4,)."""
    return np.array([noise.torque, noise.angle, noise.correlated, noise.correlation_s])
