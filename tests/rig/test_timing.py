"""What a run says about its punctuality."""

from __future__ import annotations

import numpy as np
import pytest

from rig.common.timing import EDGES_US, RESOLUTION, Histogram, Timing, summary


def test_bins_hold_what_is_up_to_their_end() -> None:
    histogram = Histogram()
    for duration_ns in (0, 1, 20_000, 20_001, 50_000_000, 50_000_001):
        histogram.note(duration_ns)
    assert histogram.counts[:3] == [1, 2, 1]
    assert histogram.counts[-2:] == [1, 1]
    assert len(histogram.counts) == len(EDGES_US) + 1
    assert histogram.worst_ns == 50_000_001


@pytest.mark.parametrize("true_us", np.geomspace(1.1, 900_000.0, 12))
def test_no_quantile_is_off_by_more_than_the_resolution(true_us: float) -> None:
    """Judged by a bin's end, a true 11 ms was 20 ms."""
    histogram = Histogram()
    for k in range(1000):
        histogram.note(round(true_us * 1000 * (2.0 if k >= 990 else 1.0)))
    assert histogram.quantile_us(0.99) == pytest.approx(true_us, rel=RESOLUTION)
    assert histogram.quantile_us(0.5) == pytest.approx(true_us, rel=RESOLUTION)


def test_a_first_cycle_that_failed_is_no_cycle() -> None:
    for part in ("lateness", "answer"):
        timing = Timing()
        getattr(timing, part).note(130_000)
        assert summary(timing.record()) == "no cycle was completed"


def test_a_summary_states_every_loss() -> None:
    timing = Timing()
    timing.lateness.note(130_000)
    timing.answer.note(700_000)
    timing.missed_syncs, timing.lost_servo, timing.lost_encoder, timing.oldest_s = 3, 2, 1, 0.999
    assert summary(timing.record()) == (
        "lateness of cycles p99 130 us, worst 130 us; answer of the devices p99 700 us; "
        "3 SYNCs missed; samples lost: 2 of the drive, 1 of the encoder; oldest sample 999 ms"
    )
