"""Collects the timing statistics of a run: counts in fixed bins, fast enough for every cycle."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from typing import Any

EDGES_US = (0, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000)
"""Upper ends of the bins, microseconds; a further bin is for longer durations."""
_EDGES_NS = tuple(edge * 1000 for edge in EDGES_US)


class Histogram:
    """Histogram of durations, with the longest duration.

    Attributes:
        counts: Counts per bin of :data:`EDGES_US`, and one for longer durations.
        worst_ns: Longest duration, ns.
    """

    def __init__(self) -> None:
        self.counts = [0] * (len(EDGES_US) + 1)
        self.worst_ns = 0

    def note(self, duration_ns: int) -> None:
        """Count one duration."""
        self.counts[bisect_left(_EDGES_NS, duration_ns)] += 1
        self.worst_ns = max(self.worst_ns, duration_ns)

    def share_within_us(self, share: float) -> float | None:
        """Return the upper end of the bin at the quantile ``share``, or the longest duration if the
        quantile is beyond the last bin.

        The result is None if no duration was counted.
        """
        total = sum(self.counts)
        if not total:
            return None
        seen = 0
        for edge, count in zip(EDGES_US, self.counts, strict=False):
            seen += count
            if seen >= share * total:
                return min(float(edge), self.worst_ns * 1e-3)
        return self.worst_ns * 1e-3

    def record(self) -> dict[str, Any]:
        """Return the bins and the statistics that are computed from the bins, for ``run.json``."""
        return {
            "edges_us": list(EDGES_US),
            "counts": list(self.counts),
            "p50_us": self.share_within_us(0.5),
            "p99_us": self.share_within_us(0.99),
            "worst_us": self.worst_ns * 1e-3,
        }


class Timing:
    """Timing statistics of a run.

    Attributes:
        lateness: Lateness of cycle starts; by the real clock for a simulated bench in real time.
        answer: Time from a cycle's start until its sample was received: the sample's age at its
            check.
        missed_syncs: Cycles that were skipped because an earlier cycle was more than a period late.
        lost_servo: Cycles in which the drive's answer was missing or bad.
        lost_encoder: Cycles in which the joint encoder's answer was missing or bad.
        oldest_s: The greatest age of the last fresh sample, s.
    """

    def __init__(self) -> None:
        self.lateness = Histogram()
        self.answer = Histogram()
        self.missed_syncs = 0
        self.lost_servo = 0
        self.lost_encoder = 0
        self.oldest_s = 0.0

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
        f"of the devices p99 {answer['p99_us']:.0f} us; "
        f"{timing['missed_syncs']} SYNCs missed; samples lost: "
        f"{timing['lost_servo']} of the drive, {timing['lost_encoder']} of the encoder; "
        f"oldest sample {timing['oldest_sample_s'] * 1e3:.3g} ms"
    )
