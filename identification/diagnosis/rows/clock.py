"""Finds the running time (the time since the machine was started cold) at which each recording
begins, from declared starts or time stamps.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from identification.recording import Recording


def one_clock(recordings: Sequence[Recording]) -> bool:
    """Whether the recordings, by their starts or time stamps, follow one another as on one
    clock.
    """
    spans = sorted(r.span for r in recordings)
    return all(ended < began for (_, ended), (began, _) in itertools.pairwise(spans))


def run_starts(recordings: Sequence[Recording]) -> list[float]:
    """Return the running time at which each recording begins, s.

    If starts or time stamps follow one another, running time counts from the zero of their clock,
    at which the machine was cold, provided that this zero precedes the first recording by no more
    than the total duration of the recordings; otherwise running time counts from the start of the
    first recording. The order of recordings without a common clock is unknown; each recording is
    then assumed to start cold, with running time 0.
    """
    if len(recordings) > 1 and one_clock(recordings):
        first, last = (
            min(r.span[0] for r in recordings),
            max(r.span[1] for r in recordings),
        )
        zero = 0.0 if 0.0 <= first < last - first else first
        return [r.span[0] - zero for r in recordings]
    return [0.0] * len(recordings)
