"""When recordings began, as far as their declared starts or their time stamps say it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from identification.recording import Recording


def one_clock(recordings: Sequence[Recording]) -> bool:
    """Whether recordings follow one another by their starts or time stamps, as on one clock."""
    spans = sorted(r.span for r in recordings)
    return all(ended < began for (_, ended), (began, _) in itertools.pairwise(spans))


def run_starts(recordings: Sequence[Recording]) -> list[float]:
    """Return when each recording began, s of running time.

    Where their starts or time stamps follow one another on one clock these say it: from that
    clock's zero, where it is no further back than the recordings are long, as the machine was cold
    then; else from the first. Of recordings without a common clock each began cold, at its own
    zero: in which order they were made nobody says.
    """
    if len(recordings) > 1 and one_clock(recordings):
        first, last = (
            min(r.span[0] for r in recordings),
            max(r.span[1] for r in recordings),
        )
        zero = 0.0 if 0.0 <= first < last - first else first
        return [r.span[0] - zero for r in recordings]
    return [0.0] * len(recordings)
