"""Checks and repairs time stamps and missing samples of a recording; rejects unusable data.

The functions depend only on their arguments. Every correction gives a note. Rows are numbered from
0; callers convert row numbers to places in a file.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array

REPEATED_SHARE = 0.01
"""Greatest share of samples with repeated time stamps that are dropped with a note."""
MISSING_SHARE = 0.05
"""Greatest share of missing samples of a channel that are interpolated with a note."""
MISSING_RUN = 5  # greatest number of successive missing samples that are interpolated
GAP_PERIODS = 5.0  # length of a time step, in median periods, above which the recording is split
MIN_SAMPLES = 50
UNEVEN_SHARE = 0.05  # relative range (5 to 95 %) of the sample period above which a note results
UNEVEN = "uneven sampling kept as recorded"  # beginning of the note on uneven sampling
PERIODS_S = (2e-6, 0.5)
"""Median sample periods, s, of a drive's log; beyond, the time has another unit."""
TIME_UNITS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
USUAL_PERIODS_S = (4e-5, 0.5)  # least and greatest sample period that a unit must give to be named

Mask = NDArray[np.bool_]


class UnusableError(Exception):
    """The data cannot be used; ``row`` is the first bad row, or None for all of them."""

    def __init__(self, message: str, row: int | None = None) -> None:
        super().__init__(message)
        self.row = row


@dataclass(frozen=True)
class Timing:
    """The rows of a time base that are used, and their division into pieces."""

    keep: Mask | None  # mask of the rows that are used, shape (n,), or None for all rows
    # (start, stop) of each piece without a gap, as numbers of the used rows.
    pieces: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]


def examine_time(time: Array) -> Timing:
    """Check time stamps and find rows to drop and places to split."""
    if len(time) < MIN_SAMPLES:
        raise UnusableError(f"only {len(time)} samples; at least {MIN_SAMPLES} are needed")
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        raise UnusableError(
            f"time is not a number in {bad.size} rows; remove these rows or state `rate`",
            int(bad[0]),
        )
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if back.size:
        row = int(back[0]) + 1
        raise UnusableError(
            f"time runs backwards, from {time[row - 1]:.9g} to {time[row]:.9g} s; sort or cut the "
            f"file there",
            row,
        )
    notes: list[str] = []
    keep: Mask | None = None
    repeated = np.flatnonzero(steps == 0) + 1
    if repeated.size:
        share = repeated.size / len(time)
        if share > REPEATED_SHARE:
            raise UnusableError(
                f"{repeated.size} repeated time stamps ({100 * share:.1f} % of the rows, at most"
                f" {100 * REPEATED_SHARE:g} %); log the time with more digits, or state `rate` "
                "instead",
                int(repeated[0]),
            )
        keep = np.ones(len(time), dtype=np.bool_)
        keep[repeated] = False
        notes.append(f"{repeated.size} samples with a repeated time stamp dropped")
        steps = np.diff(time[keep])
    pieces, split_notes = _split(steps)
    return Timing(keep, pieces, (*notes, *_describe(steps), *split_notes))


def _split(steps: Array) -> tuple[tuple[tuple[int, int], ...], list[str]]:
    median = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP_PERIODS * median)
    if gaps.size > len(steps) / MIN_SAMPLES:
        # Long steps in every few samples are the rhythm of the log, unless they are pauses.
        usual = float(np.mean(steps))
        if np.max(steps) <= GAP_PERIODS * usual:
            return ((0, len(steps) + 1),), [
                f"{gaps.size} steps longer than {GAP_PERIODS:g} median periods, at most "
                f"{steps.max():.4g} s, count as uneven sampling, because they come in every "
                f"{len(steps) / gaps.size:.3g} samples"
            ]
    if not gaps.size:
        return ((0, len(steps) + 1),), []
    edges = [0, *(int(gap) + 1 for gap in gaps), len(steps) + 1]
    pieces = list(pairwise(edges))
    long = tuple(piece for piece in pieces if piece[1] - piece[0] >= MIN_SAMPLES)
    notes = [
        f"{gaps.size} gaps, the longest {steps[gaps].max():.4g} s: split into {len(pieces)} spans"
    ]
    dropped = sum(stop - start for start, stop in pieces if stop - start < MIN_SAMPLES)
    if dropped:
        notes.append(
            f"{len(pieces) - len(long)} spans shorter than {MIN_SAMPLES} samples dropped "
            f"({dropped} samples)"
        )
    if not long:
        doubt = other_unit(median)
        raise UnusableError(
            f"{gaps.size} gaps leave no span of {MIN_SAMPLES} samples (median period "
            f"{median:.4g} s, a gap is longer than {GAP_PERIODS:g} median periods); record with an "
            "even rate, or write the log again with its gaps filled at even times and map that file"
            + (f"; {doubt}" if doubt else ""),
            int(gaps[0]) + 1,
        )
    return long, notes


def _describe(steps: Array) -> list[str]:
    low, median, high = (float(q) for q in np.percentile(steps, [5, 50, 95]))
    notes = []
    if high - low > UNEVEN_SHARE * median:
        notes.append(f"{UNEVEN}: median period {median:.4g} s, 5 to 95 % {low:.4g} to {high:.4g} s")
    doubt = other_unit(median)
    return [*notes, doubt] if doubt else notes


def other_unit(period: float) -> str:
    """Return a doubt that a median period, s, is in seconds, with the remedy; or an empty text."""
    low, high = PERIODS_S
    if low <= period < high or period <= 0.0:
        return ""
    if period < low:
        return (
            f"median period {period:.4g} s: no drive is logged at {1.0 / period:.3g} Hz; check the "
            "scale of `time`"
        )
    least, most = USUAL_PERIODS_S
    units = [(u, s) for u, s in TIME_UNITS.items() if least <= period * s < most]
    remedies = [
        f"if `time` is in {unit} ({1.0 / (period * scale):.4g} Hz), set its scale to {scale:g}"
        for unit, scale in units
    ]
    return f"median period {period:.4g} s: " + (" or, ".join(remedies) or "check its scale")


def fill_missing(values: Array, time: Array, legitimate: Mask | None = None) -> tuple[Array, int]:
    """Interpolate isolated missing samples linearly in time.

    Args:
        values: Samples, NaN or infinite where missing, shape (n,).
        time: Time stamps, s, shape (n,), not decreasing.
        legitimate: Mask of the rows in which a sample may be missing and stays NaN (power stage
            off), shape (n,).

    Returns:
        The samples (``values`` itself if no sample was missing), and the number of interpolated
        samples.
    """
    finite = np.isfinite(values)
    missing = ~finite if legitimate is None else ~finite & ~legitimate
    count = int(missing.sum())
    if count == 0:
        return values, 0
    considered = len(values) if legitimate is None else int((~legitimate).sum())
    first = int(np.argmax(missing))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False]))))
    longest = int(np.max(edges[1::2] - edges[::2], initial=0))
    if count > MISSING_SHARE * considered or longest > MISSING_RUN:
        raise UnusableError(
            f"{count} of {considered} samples are missing, the longest run {longest} (at most"
            f" {100 * MISSING_SHARE:g} %, and {MISSING_RUN} in a row, are interpolated)"
            + (
                "; use the part before or after the gap by `window`"
                if longest > MISSING_RUN
                else ""
            ),
            first,
        )
    filled = np.where(finite, values, np.nan)
    filled[missing] = np.interp(time[missing], time[finite], values[finite])
    return filled, count
