"""Finds the segments of the simulated replicates that correspond to each motion segment of a
recording (its counterparts), and averages the sensitivities of these counterparts.

The averages are used as instrumental variables (M28) and for the Cramér-Rao bound. Breakaway times
differ slightly between noise realisations; the curves are therefore shifted to a common breakaway
time before they are averaged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from identification.filter.likelihood import Point
from identification.filter.segment_table import DIRECTION, FIRST, LAST
from identification.filter.segments import Motion
from identification.numerics.arrays import Array
from identification.numerics.block_arrow import BlockArrow


@dataclass(frozen=True)
class Replicate:
    """One simulated replicate of an experiment.

    Attributes:
        point: The simulated recordings, in the order of the real ones, at the simulated values.
        sensitivities: Derivatives of the residuals at the point with respect to the free parameters
            of the real experiment.
        residuals: Prediction errors over their standard deviations, shape (r,).
        noise: Number of the noise realisation; a realisation and its copy with reversed sign have
            one number.
    """

    point: Point
    sensitivities: BlockArrow
    residuals: Array
    noise: int

    def inflated(self) -> tuple[BlockArrow, Array]:
        """Return sensitivities and residuals with the variance inflation (M13) that is used for the
        estimate.
        """
        share = 1.0 / self.point.inflation[self.point.owners]
        return self.sensitivities.scaled(share), self.residuals * share


@dataclass(frozen=True)
class Curve:
    """Sensitivities over one segment of a replicate.

    Attributes:
        values: Derivatives with respect to the parameters, then to the breakaway time, shape (n, p
            + 1).
        onset: Breakaway time, in samples after the segment's first sample.
        noise: Number of the replicate's noise realisation.
    """

    values: Array
    onset: float
    noise: int


@dataclass(frozen=True)
class ReplicatedSegment:
    """A segment of a recording with its counterparts in the replicates.

    Attributes:
        number: Number of the segment, over all recordings.
        rows: Rows of the segment's residuals.
        onset: Breakaway time, in samples after the segment's first sample.
        curves: Counterparts of the segment in the replicates; a replicate may have none.
    """

    number: int
    rows: slice
    onset: float
    curves: tuple[Curve, ...]

    def mean(self, curves: Sequence[Curve]) -> tuple[Array, Array]:
        """Return the mean of one or more curves at the segment's samples, (n, p + 1), and the
        number of curves at each sample, (n, 1).
        """
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
    """Return the curve of the segment that has the given direction and most samples in common with
    the segment of these ``bounds``, or None if no segment has half of the samples in common.
    """
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

    Args:
        curves: One or more curves, of any lengths.
        onsets: Breakaway time of each curve, in samples after its first sample.
        length: Length of the mean.
        onset: Breakaway time of the mean.
    """
    total, seen = np.zeros((length, curves[0].shape[1])), np.zeros((length, 1))
    for curve, begun in zip(curves, onsets, strict=True):
        ahead = int(np.floor(begun - onset))
        first, last = max(0, -ahead), min(length, len(curve) - 1 - ahead)
        if first >= last:
            continue
        share = (np.arange(first, last) + begun - onset - np.arange(first + ahead, last + ahead))[
            :, None
        ]
        before, after = (
            curve[first + ahead : last + ahead],
            curve[first + ahead + 1 : last + ahead + 1],
        )
        total[first:last] += (1.0 - share) * before + share * after
        seen[first:last] += 1.0
    return total / np.maximum(seen, 1.0), seen
