"""The course of sensitivities over single stretches of motion, and what rehearsals of the same stretches make of them.

Breakaways come a little earlier or later with every noise, so that curves are laid over one another by the time since
breakaway.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from identification.filter.likelihood import Problem
from identification.filter.segment_table import DIRECTION, FIRST, LAST
from identification.filter.segments import Motion
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow


@dataclass(frozen=True)
class Rehearsal:
    """What a simulation of the same experiment says of every parameter.

    Attributes:
        problem: The simulated recordings, in the order of the real ones, at the values that were simulated.
        sensitivities: d prediction errors over their deviations / d x there, of the real problem's free parameters.
        residuals: Those errors over their deviations, shape (r,).
        noise: Which noise it was drawn with; that with its sign turned is the same one.
    """

    problem: Problem
    sensitivities: BlockArrow
    residuals: Array
    noise: int

    def believed(self) -> tuple[BlockArrow, Array]:
        """Return sensitivities and residuals with the doubt in single stretches, as in the estimate."""
        share = 1.0 / self.problem.doubt[self.problem.owners]
        return self.sensitivities.scaled(share), self.residuals * share


@dataclass(frozen=True)
class Curve:
    """Sensitivities over one stretch of a rehearsal.

    Attributes:
        values: Of the parameters, then of the breakaway time, shape (n, p + 1).
        onset: When it breaks away, samples after its first.
        noise: Of its rehearsal.
    """

    values: Array
    onset: float
    noise: int


@dataclass(frozen=True)
class PlayedStretch:
    """A stretch of a recording, and what rehearsals show of it.

    Attributes:
        number: Of the stretch, over all recordings.
        rows: Its residuals.
        onset: When it breaks away, samples after its first.
        curves: Of those rehearsals in which there is such a stretch.
    """

    number: int
    rows: slice
    onset: float
    curves: tuple[Curve, ...]

    def mean(self, curves: Sequence[Curve]) -> tuple[Array, Array]:
        """Return the mean of some curves, at least one, at its samples, (n, p + 1), and how many there are, (n, 1)."""
        length = self.rows.stop - self.rows.start
        return mean_curve([c.values for c in curves], [c.onset for c in curves], length, self.onset)


def played(problem: Problem, rehearsals: Sequence[Rehearsal]) -> Iterator[PlayedStretch]:
    """Yield every stretch of a problem with what rehearsals show of it."""
    shown = [_stretches(r) for r in rehearsals]
    row, number = 0, 0
    for k, (m, begins) in enumerate(zip(problem.motions, problem.begins, strict=True)):
        for bounds, onset in zip(m.table, onsets_of(m, begins), strict=True):
            end = row + int(bounds[LAST] - bounds[FIRST])
            found = [curve for one in shown if (curve := _same(one[k], bounds)) is not None]
            yield PlayedStretch(number, slice(row, end), float(onset), tuple(found))
            row, number = end, number + 1


def _stretches(rehearsal: Rehearsal) -> list[list[tuple[Array, Curve]]]:
    """Return, by recording, the stretches of a rehearsal: row of the table, and curve."""
    problem, slopes = rehearsal.problem, rehearsal.sensitivities
    curves = np.column_stack([slopes.parameters, slopes.own])
    out, row = [], 0
    for m, begins in zip(problem.motions, problem.begins, strict=True):
        stretches = []
        for bounds, onset in zip(m.table, onsets_of(m, begins), strict=True):
            length = int(bounds[LAST] - bounds[FIRST])
            stretches.append((bounds, Curve(curves[row : row + length], float(onset), rehearsal.noise)))
            row += length
        out.append(stretches)
    return out


def _same(stretches: Sequence[tuple[Array, Curve]], bounds: Array) -> Curve | None:
    """Return the curve of the stretch that goes the same way over most of the same samples, None if none does."""
    best, least = None, 0.5 * (bounds[LAST] - bounds[FIRST])
    for other, curve in stretches:
        common = min(other[LAST], bounds[LAST]) - max(other[FIRST], bounds[FIRST])
        if other[DIRECTION] == bounds[DIRECTION] and common > least:
            best, least = curve, common
    return best


def onsets_of(m: Motion, begins: Array) -> Array:
    """Return when each stretch breaks away, in samples after its first, shape (m,)."""
    first = m.table[:, FIRST].astype(np.int64)
    return np.asarray((begins - m.time[first]) / m.recording.period)


def mean_curve(curves: Sequence[Array], onsets: Sequence[float], length: int, onset: float) -> tuple[Array, Array]:
    """Return the mean of curves shifted to one ``onset``, shape (length, p), and how many there are, (length, 1).

    Args:
        curves: Each of its own length, at least one.
        onsets: When each breaks away, samples after its first.
        length: Of the mean.
        onset: When that breaks away.
    """
    total, seen = np.zeros((length, curves[0].shape[1])), np.zeros((length, 1))
    for curve, begun in zip(curves, onsets, strict=True):
        ahead = int(np.floor(begun - onset))
        first, last = max(0, -ahead), min(length, len(curve) - 1 - ahead)
        if first >= last:
            continue
        share = (np.arange(first, last) + begun - onset - np.arange(first + ahead, last + ahead))[:, None]
        before, after = curve[first + ahead : last + ahead], curve[first + ahead + 1 : last + ahead + 1]
        total[first:last] += (1.0 - share) * before + share * after
        seen[first:last] += 1.0
    return total / np.maximum(seen, 1.0), seen
