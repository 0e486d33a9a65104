"""Stretches of single recordings in which something is wrong that no map over all of them shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from identification.diagnosis.result import ResidualTrace
from identification.diagnosis.rows.view import View
from identification.recording import Array

LONG_S = 0.3
"""Rests shorter than this say nothing: while torque rises fast, a rest outlasts the torque that
ends it.
"""
WITHSTOOD = 1.5
"""Torque of a rest over the greatest at which a rest of any other recording ended, from which on it
is told.
"""
LEAST_BREAKAWAYS = 12
LEAST_SHARE, CROWDED = 0.25, 3.0
"""Share of the mismatch that is left, and that share over the share of the rows, from which on a
recording is told.
"""
MOST_OF_IT = 0.8
"""Share of a recording's mismatch that lies in the stretch that is named."""


def standing(views: Sequence[View], unit: str) -> tuple[str, ...]:
    """Say where a joint stands under more torque than a rest withstood in any other recording.

    Friction at rest is no equation, only a limit: what breaks it does not show in the mismatch. A
    drive that protects itself goes on logging the torque that it was asked for.

    Args:
        views: All recordings.
        unit: Of the torque.
    """
    return tuple(line for view in views for line in _standing(view, views, unit))


def _standing(view: View, views: Sequence[View], unit: str) -> Iterator[str]:
    # Friction at rest grows with the load, so that lighter recordings set no limit.
    others = [
        v
        for v in views
        if v is not view and v.recording.contact_force >= view.recording.contact_force
    ]
    ended = [np.abs(v.raw_torque[v.breakaways - 1]) for v in others if len(v.breakaways)]
    torques = np.concatenate(ended) if ended else np.zeros(0)
    if len(torques) < LEAST_BREAKAWAYS:
        return
    limit = float(np.max(torques))
    linear = view.recording.bench.motion == "linear"
    for first, last in _runs(view.still):
        torque = float(np.median(np.abs(view.raw_torque[first:last])))
        if view.time[last - 1] - view.time[first] < LONG_S or torque < WITHSTOOD * limit:
            continue
        place = float(np.median(view.angle[first:last]))
        where = f"{place:.4g} m" if linear else f"{np.rad2deg(place):.1f} deg"
        yield (
            f"{view.recording.name}: from {view.time[first]:.2f} to {view.time[last - 1]:.2f} s "
            f"the joint stands at "
            f"{where} under {torque:.2g} {unit}, where elsewhere no rest withstood more than "
            f"{limit:.2g}: that torque "
            "did not reach it (a drive that cut it off), or something held it"
        )


def crowded(traces: Sequence[ResidualTrace]) -> tuple[str, ...]:
    """Say in which recordings, and when, most of the mismatch lies that the final model leaves.

    Args:
        traces: Of the recordings that were fitted.
    """
    lines = []
    for equation in dict.fromkeys(t.equation for t in traces):
        mine = [t for t in traces if t.equation == equation]
        powers = [float(t.after @ t.after) for t in mine]
        total, rows = max(sum(powers), 1e-300), sum(len(t.time) for t in mine)
        for trace, power in zip(mine, powers, strict=True):
            share, usual = power / total, len(trace.time) / rows
            if share >= LEAST_SHARE and share >= CROWDED * usual:
                first, last = shortest(trace.time, trace.after**2)
                lines.append(
                    f"{trace.recording}: {100.0 * share:.0f} % of the {equation} mismatch that is "
                    f"left is in it, where "
                    f"{100.0 * usual:.0f} % of the rows are, most of it from {first:.2f} to "
                    f"{last:.2f} s"
                )
    return tuple(lines)


def shortest(time: Array, power: Array) -> tuple[float, float]:
    """Return the shortest stretch with :data:`MOST_OF_IT` of the power, s."""
    total = np.concatenate(([0.0], np.cumsum(power)))
    ends = np.searchsorted(total, total[:-1] + MOST_OF_IT * total[-1])
    starts = np.flatnonzero(ends < len(total))
    spans = time[ends[starts] - 1] - time[starts]
    best = int(starts[np.argmin(spans)])
    return float(time[best]), float(time[ends[best] - 1])


def _runs(marks: np.ndarray) -> list[tuple[int, int]]:
    """Return (first, one past the last) of each run of marked samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], marks, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
