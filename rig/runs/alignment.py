"""Aligns drive and joint encoder, which sample with separate clocks, to one time base.

If one SYNC latches drive and encoder, only their time stamps drift apart; the samples are left
unchanged. Samples of a free-running encoder are up to a period older than those of the drive; their
age varies with the beat of the two clocks. A delay tau biases the inertia by tau dF/domega, where
dF/domega is the slope of friction over speed: half a millisecond near the Stribeck speed gives an
error of a quarter of the inertia.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.recording import Array
from identification.signals import quantum

AGREE = 0.02  # age of the encoder's samples, in periods, up to which they are simultaneous
_SHARE = 0.01
"""Share of samples that may be older than ``AGREE``, so that single late stamps have no effect."""
_BLOCKS = 500
_LEAST = 5.0  # percentile of a block's ages that is its least age, robust to early stamps
_FILLED = 3  # most encoder samples in a row that were overwritten and are interpolated


def taken_at(reference: Array, stamps: Array) -> Array:
    """Return the sampling times of an encoder by the reference clock, s, shape (n,).

    A sample is logged after it was taken, with almost no delay at some phase of the beat of the two
    clocks. Therefore the line between the clocks is the highest line for which almost no sample is
    in the future: the edge of the lower convex hull at the mean of the samples (Moon, Skelly and
    Towsley, INFOCOM 1999, 227). A constant delay is not observable.

    Args:
        reference: The drive's time of each row, s, rising, shape (n,).
        stamps: The encoder's own stamp of the angle in each row, s, not falling, shape (n,).
    """
    points = []
    for block in np.array_split(np.arange(len(stamps)), min(_BLOCKS, max(len(stamps) // 20, 1))):
        age = reference[block] - stamps[block]
        least = float(np.percentile(age, _LEAST))
        k = int(block[np.argmin(np.abs(age - least))])
        points.append((float(stamps[k] - stamps[0]), float(reference[k] - stamps[k])))
    hull: list[tuple[float, float]] = []
    for x, y in points:
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], (x, y)):
            hull.pop()
        hull.append((x, y))
    middle = float(np.mean(stamps - stamps[0]))
    k = min(max(int(np.searchsorted([x for x, _ in hull], middle)), 1), len(hull) - 1)
    (x0, y0), (x1, y1) = (hull[k - 1], hull[k]) if len(hull) > 1 else (hull[0], hull[0])
    slope = (y1 - y0) / (x1 - x0) if x1 > x0 else 0.0
    return np.asarray(stamps + y0 + slope * (stamps - stamps[0] - x0))


def _turns_down(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (c[0] - a[0]) * (b[1] - a[1])


def aligned(
    channels: Mapping[str, Array], stamps: Array, averaged: frozenset[str], gear_ratio: float
) -> tuple[dict[str, Array], str]:
    """Return the channels on one time base, and a note on the correction; the channels are
    unchanged if the clocks agree.

    The angle of the finer encoder is not interpolated. If the time base is that of the joint
    encoder, all other channels are interpolated at its sampling times; averaged channels remain
    means, over the period of the joint encoder.

    Args:
        channels: Channels, including ``time`` by the drive's clock, and ``angle``.
        stamps: The encoder's own stamps of ``angle``, s, shape (n,).
        averaged: Channels whose samples are means over the period that ends at their time.
        gear_ratio: Motor turns per joint turn.
    """
    time, angle = channels["time"], channels["angle"]
    period = float(np.median(np.diff(time)))
    if not np.all(np.diff(stamps) >= 0.0):
        return dict(channels), ""
    taken = taken_at(time, stamps)
    age = time - taken
    if np.mean(np.abs(age) > AGREE * period) < _SHARE:
        return dict(channels), ""
    new = np.concatenate(([True], np.diff(stamps) > 0.0))
    words = (
        "the joint encoder samples by its own clock: angles up to "
        f"{1e3 * float(np.percentile(age, 99.0)):.2g} ms older than the drive's samples"
    )
    motor = channels.get("motor_angle")
    if motor is not None and not 0.0 < quantum(angle) < quantum(motor) / gear_ratio:
        return {
            **channels,
            "angle": np.interp(time, taken[new], angle[new]),
        }, f"{words}; interpolated at the drive's time stamps"
    instants, counted, filled = _without_holes(taken[new], angle[new])
    inside = (instants >= time[0]) & (instants <= time[-1])
    instants, counted = instants[inside], counted[inside]
    out = {name: _at(instants, time, values, name in averaged) for name, values in channels.items()}
    words += "; the drive's samples interpolated at the encoder's time stamps"
    if filled:
        words += f", {filled} angles interpolated that were overwritten before they were read"
    return {**out, "time": instants, "angle": counted}, words


def _without_holes(taken: Array, angle: Array) -> tuple[Array, Array, int]:
    """Return an encoder's samples with short gaps filled, and the number of filled samples."""
    steps = np.diff(taken)
    missing = np.round(steps / float(np.median(steps))).astype(np.int64) - 1
    missing = np.where((missing > 0) & (missing <= _FILLED), missing, 0)
    extra = [
        taken[k] + steps[k] * np.arange(1, missing[k] + 1) / (missing[k] + 1)
        for k in np.flatnonzero(missing)
    ]
    if not extra:
        return taken, angle, 0
    instants = np.sort(np.concatenate([taken, *extra]))
    values = np.interp(instants, taken, angle)
    step = quantum(angle)
    if step > 0.0:
        values = angle[0] + np.round((values - angle[0]) / step) * step
    return instants, values, int(missing.sum())


def _at(instants: Array, time: Array, values: Array, mean: bool) -> Array:
    """Return a channel at other times, or its mean over the period that ends there."""
    if not mean:
        return np.interp(instants, time, values)
    period = float(np.median(np.diff(time)))
    edges = np.concatenate(([time[0] - period], time))
    span = float(np.median(np.diff(instants)))
    known = np.isfinite(values)

    def mean_of(each: Array) -> Array:
        total = np.concatenate(([0.0], np.cumsum(each * np.diff(edges))))
        return np.asarray(
            (np.interp(instants, edges, total) - np.interp(instants - span, edges, total)) / span
        )

    found = mean_of(np.where(known, values, 0.0))
    if not known.all():
        found[mean_of(np.where(known, 0.0, 1.0)) > 0.0] = np.nan
    return found
