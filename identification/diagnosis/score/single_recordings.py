"""Finds implausible rests and a concentrated mismatch in single recordings, which the mean over all
recordings does not show.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from identification.diagnosis.result import ResidualTrace
from identification.recording import Array
from identification.views.view import View

LONG_S = 0.3
"""Least duration of a rest, s. At the end of a shorter rest, under a torque that rises fast, the
torque exceeds the static limit before motion is visible.
"""
TORQUE_RATIO = 1.5
"""Ratio of the torque during a rest to the greatest torque at the end of a rest in any other
recording, from which the rest is reported.
"""
LEAST_BREAKAWAYS = 12
LEAST_SHARE, CROWDED = 0.25, 3.0
"""Share of the remaining mismatch from which a recording is reported, and least ratio of this share
to the share of the rows.
"""
MOST_OF_IT = 0.8
"""Share of the mismatch of a recording that the reported interval of time contains."""


def rests_under_torque(views: Sequence[View], unit: str) -> tuple[str, ...]:
    """Return a text for each rest under a torque greater than the torque at the end of any rest in
    other recordings.

    At rest friction is known only to be within its static limit, so that a torque beyond the limit
    does not appear in the mismatch. A possible cause is a drive that has switched its torque off
    but still logs the requested torque.

    Args:
        views: All recordings.
        unit: Unit of the torque.
    """
    return tuple(line for view in views for line in _rests_of(view, views, unit))


def _rests_of(view: View, views: Sequence[View], unit: str) -> Iterator[str]:
    # Friction at rest grows with the load; recordings with less load therefore give no limit.
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
        if view.time[last - 1] - view.time[first] < LONG_S or torque < TORQUE_RATIO * limit:
            continue
        place = float(np.median(view.angle[first:last]))
        where = f"{place:.4g} m" if linear else f"{np.rad2deg(place):.1f} deg"
        yield (
            f"{view.recording.name}: from {view.time[first]:.2f} to {view.time[last - 1]:.2f} s "
            f"the joint rests at {where} under a logged torque of {torque:.2g} {unit}, but all "
            f"rests in other recordings end at a torque of at most {limit:.2g} {unit}: check "
            "whether the drive had switched its torque off, or whether the joint was blocked"
        )


def crowded_recordings(traces: Sequence[ResidualTrace]) -> tuple[str, ...]:
    """Return a text for each recording that contains a large part of the mismatch of the corrected
    model, with the interval of time.

    Args:
        traces: Mismatch of the recordings that were fitted.
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
                    f"{trace.recording}: contains {100.0 * share:.0f} % of the remaining "
                    f"{equation} mismatch, but only {100.0 * usual:.0f} % of the samples; most of "
                    f"this mismatch is between {first:.2f} and {last:.2f} s"
                )
    return tuple(lines)


def shortest(time: Array, power: Array) -> tuple[float, float]:
    """Return start and end, s, of the shortest interval with the share :data:`MOST_OF_IT` of the
    power.
    """
    total = np.concatenate(([0.0], np.cumsum(power)))
    ends = np.searchsorted(total, total[:-1] + MOST_OF_IT * total[-1])
    starts = np.flatnonzero(ends < len(total))
    spans = time[ends[starts] - 1] - time[starts]
    best = int(starts[np.argmin(spans)])
    return float(time[best]), float(time[ends[best] - 1])


def _runs(marks: np.ndarray) -> list[tuple[int, int]]:
    """Return the first sample and the sample after the last of each run of marked samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], marks, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
