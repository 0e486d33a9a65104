"""Collects the timing statistics of a run: counts in fixed bins, fast enough for every cycle."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from itertools import accumulate, pairwise
from typing import Any, Final

EDGES_US: Final = (0, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000)
"""Upper ends of the recorded bins, microseconds; a further bin is for longer durations."""
RESOLUTION: Final = 0.01  # greatest relative error of a quantile above 1 us and below 1 s


def _fine_edges() -> Iterator[int]:
    """Yield the upper ends of the bins in memory, ns; a recorded bin is a whole number of them."""
    yield 0
    yield 1000
    for low, high in pairwise((1, *EDGES_US[1:], 1_000_000)):
        count = math.ceil(math.log(high / low) / math.log1p(RESOLUTION))
        yield from (round(1000 * low * (high / low) ** (k / count)) for k in range(1, count + 1))


_FINE_NS: Final = tuple(_fine_edges())
_ENDS: Final = tuple(_FINE_NS.index(1000 * edge) + 1 for edge in EDGES_US)
"""Number of the bins in memory up to each recorded end."""


class Histogram:
    """Histogram of durations, with the longest duration; its memory does not grow."""

    def __init__(self) -> None:
        self._counts = [0] * (len(_FINE_NS) + 1)
        self.worst_ns = 0  # longest duration, ns

    @property
    def counts(self) -> list[int]:
        """Counts per bin of :data:`EDGES_US`, and one for longer durations."""
        return [sum(self._counts[a:b]) for a, b in pairwise((0, *_ENDS, len(self._counts)))]

    def note(self, duration_ns: int) -> None:
        """Count one duration."""
        self._counts[bisect_left(_FINE_NS, duration_ns)] += 1
        self.worst_ns = max(self.worst_ns, duration_ns)

    def quantile_us(self, share: float) -> float | None:
        """Return the duration that the share ``share`` of the durations does not exceed, us, to
        :data:`RESOLUTION`; None if no duration was counted.

        Within a bin the durations are taken as evenly spread.
        """
        seen = list(accumulate(self._counts))
        if not seen[-1]:
            return None
        index = bisect_left(seen, share * seen[-1])
        if index == len(_FINE_NS):
            return self.worst_ns * 1e-3
        before = seen[index] - self._counts[index]
        part = (share * seen[-1] - before) / self._counts[index]
        low, high = _FINE_NS[max(index - 1, 0)], _FINE_NS[index]
        return min(low + part * (high - low), self.worst_ns) * 1e-3

    def record(self) -> dict[str, Any]:
        """Return counts in few bins, and the statistics, for ``run.json``."""
        return {
            "edges_us": list(EDGES_US),
            "counts": self.counts,
            "p50_us": self.quantile_us(0.5),
            "p99_us": self.quantile_us(0.99),
            "resolution": RESOLUTION,
            "worst_us": self.worst_ns * 1e-3,
        }


class Timing:
    """Timing statistics of a run."""

    def __init__(self) -> None:
        # Lateness of cycle starts; by the real clock for a simulated bench in real time.
        self.lateness = Histogram()
        # Time from a cycle's start until its sample was received: the sample's age at its check.
        self.answer = Histogram()
        # Cycles that were skipped because an earlier cycle was more than a period late.
        self.missed_syncs = 0
        self.lost_servo = 0  # cycles in which the drive's answer was missing or bad
        self.lost_encoder = 0  # cycles in which the joint encoder's answer was missing or bad
        self.oldest_s = 0.0  # the greatest age of the last fresh sample, s

    def record(self) -> dict[str, Any]:
        """Return all statistics for ``run.json``."""
        return {
            "lateness": self.lateness.record(),
            "answer": self.answer.record(),
            "missed_syncs": self.missed_syncs,
            "lost_servo": self.lost_servo,
            "lost_encoder": self.lost_encoder,
            "oldest_sample_s": self.oldest_s,
        }


def summary(timing: Mapping[str, Any]) -> str:
    """Return the statistics of a record as one line for the terminal."""
    late, answer = timing["lateness"], timing["answer"]
    if late["p99_us"] is None or answer["p99_us"] is None:
        return "no cycle was completed"
    return (
        f"lateness of cycles p99 {late['p99_us']:.0f} us, worst {late['worst_us']:.0f} us; answer "
        f"of the devices p99 {answer['p99_us']:.0f} us; {timing['missed_syncs']} SYNCs missed; "
        f"samples lost: {timing['lost_servo']} of the drive, {timing['lost_encoder']} of the "
        f"encoder; oldest sample {timing['oldest_sample_s'] * 1e3:.3g} ms"
    )


def instant(text: str) -> datetime:
    """Return the date and time that an ISO 8601 text states; a text without a zone is in UTC."""
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        found = None
    if found is None or len(text) < len("2026-01-31T12:00"):
        raise ValueError(
            "not an ISO time with date and time of day; write 2026-01-31T12:00:00, or seconds"
        )
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def iso_time(text: str) -> str:
    """Return the text if it is an ISO 8601 date and time."""
    instant(text)
    return text
