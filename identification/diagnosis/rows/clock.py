"""Finds the running time (the time since the machine was started cold) at which each recording
begins, from declared starts or time stamps.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from identification.recording import Recording


def one_clock(recordings: Sequence[Recording]) -> bool:
    """Whether the starts or time stamps of recordings follow one another, as on one clock."""
    spans = sorted(r.span for r in recordings)
    return all(ended < began for (_, ended), (began, _) in itertools.pairwise(spans))


def run_starts(recordings: Sequence[Recording]) -> list[float]:
    """Return the running time at which each recording begins, s.

    If starts or time stamps follow one another, running time counts from the zero of their clock,
    when the machine was cold, provided that this zero precedes the first recording by no more than
    the recordings' total duration; otherwise it counts from the first recording. Recordings without
    a common clock have an unknown order; each is assumed to start cold, at its own zero.
    """
    if len(recordings) > 1 and one_clock(recordings):
        first, last = (
            min(r.span[0] for r in recordings),
            max(r.span[1] for r in recordings),
        )
        zero = 0.0 if 0.0 <= first < last - first else first
        return [r.span[0] - zero for r in recordings]
    return [0.0] * len(recordings)
