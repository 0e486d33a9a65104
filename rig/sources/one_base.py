"""Resamples channels that a file stores on several time bases at the time stamps of one time base.

The functions depend only on their arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array
from rig.sources.repair import GAP_PERIODS

SLOWER, FASTER = 0.9, 1.5
"""Ratio of the rate of a channel to the rate of the result: below the first value, a note states
that the course between samples is a guess; above the second value, that samples are left out.
"""
EDGE_PERIODS = 1e-6
"""Distance, in periods, from the first or last sample of another time base up to which a row counts
as inside this time base, because time stamps are rounded.
"""
HELD = frozenset({"enabled"})
"""Channels whose values are not interpolated, but hold until the next sample."""


@dataclass(frozen=True)
class Base:
    """One time base of a file.

    Attributes:
        name: Name for messages.
        stamps: Time stamps of the rows by the file's clock, s, shape (n,).
    """

    name: str
    stamps: Array


class StampsError(Exception):
    """The time stamps of a time base cannot be used; the message states the reason."""


def on_one_base(
    channels: Mapping[str, Array], bases: Mapping[str, Base], wanted: Base
) -> tuple[dict[str, Array], int, list[str]]:
    """Interpolate the channels of other time bases at the time stamps of the wanted base.

    Between samples that are more than :data:`GAP_PERIODS` median periods apart, values are missing.
    Rows before the first or after the last sample of any channel are left out.

    Args:
        channels: Values of each channel, on its own time base.
        bases: Time base of each channel.
        wanted: Time base of the result.

    Returns:
        Channels of shape (m,), the number of rows of the wanted base before the first used row,
        and notes.

    Raises:
        StampsError: The stamps of a time base run backwards or are missing, or the time bases do
            not overlap.
    """
    found: dict[str, Array] = {}
    notes: list[str] = []
    inside = np.ones(len(wanted.stamps), dtype=np.bool_)
    for name, values in channels.items():
        base = bases[name]
        if base is wanted or np.array_equal(base.stamps, wanted.stamps):
            found[name] = values
            continue
        found[name], within = _interpolated(name, values, base, wanted)
        inside &= within
        notes.append(f"`{name}`: {_words(base, wanted, name)}")
    rows = np.flatnonzero(inside)
    if not rows.size:
        others = {base.name for base in bases.values()} - {wanted.name}
        raise StampsError(
            f"no row of {wanted.name} is within the times of {', '.join(sorted(others))}; use "
            f"columns of one time base"
        )
    first, stop = int(rows[0]), int(rows[-1]) + 1
    left = len(inside) - (stop - first)
    if left:
        notes.append(f"{left} rows of {wanted.name} outside of the other time bases left out")
    return {name: values[first:stop] for name, values in found.items()}, first, notes


def _interpolated(
    name: str, values: Array, base: Base, wanted: Base
) -> tuple[Array, NDArray[np.bool_]]:
    known = np.isfinite(values)
    stamps, samples = base.stamps[known], values[known]
    for one in (base, wanted):
        steps = np.diff(one.stamps)
        if not np.all(np.isfinite(one.stamps)) or np.any(steps < 0):
            row = int(np.argmax(~(steps >= 0))) + 1
            raise StampsError(
                f"the time stamps of {one.name} run backwards or are missing at its row {row + 1}, "
                f"so that columns cannot be interpolated between time bases; use columns of one "
                f"time base"
            )
    if len(stamps) < 2:
        raise StampsError(
            f"`{name}` has {len(stamps)} samples in {base.name}; at least two are needed to "
            f"interpolate it at the time stamps of {wanted.name}"
        )
    first = np.concatenate(([True], np.diff(stamps) > 0))
    stamps, samples = stamps[first], samples[first]
    at = wanted.stamps
    after = np.clip(np.searchsorted(stamps, at, side="right"), 1, max(1, len(stamps) - 1))
    if name in HELD:
        result = samples[np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, None)]
    else:
        result = np.interp(at, stamps, samples)
    if len(stamps) > 1:
        wide = np.diff(stamps)
        apart = wide[after - 1] > GAP_PERIODS * float(np.median(wide))
        apart &= (at > stamps[after - 1]) & (at < stamps[after])
        result = np.where(apart, np.nan, result)
    slack = EDGE_PERIODS * (float(np.median(np.diff(at))) if len(at) > 1 else 0.0)
    return result, (at >= stamps[0] - slack) & (at <= stamps[-1] + slack)


def _words(base: Base, wanted: Base, name: str) -> str:
    own, target = (_rate(one.stamps) for one in (base, wanted))
    how = "held between its samples" if name in HELD else "interpolated"
    words = f"of {base.name} ({own:.4g} Hz), {how} at the stamps of {wanted.name} ({target:.4g} Hz)"
    if own < SLOWER * target:
        words += "; its rate is lower, so that the course between samples is a guess"
    elif own > FASTER * target:
        words += "; its rate is higher: to use all of its samples, map `time` to its own stamps"
    return words


def _rate(stamps: Array) -> float:
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    return 1.0 / period if period > 0 else 0.0
