"""Chooses the common bandwidth of recordings that are fitted together: the least of their default
bandwidths, or a greater bandwidth if the motion needs it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from identification.estimate.equation_error.regression import LEAST_MOTION, samples_in_motion
from identification.prepare import default_bandwidth, prepare
from identification.recording import Recording

BANDWIDTH_STEP = 1.25
"""Ratio of successive bandwidths that are tried."""
SHARE_OF_RATE = 1.0 / 6.0
"""Greatest bandwidth that is tried, relative to the sampling rate."""


def common_bandwidth(recordings: Sequence[Recording], most_Hz: float = math.inf) -> float:
    """Return the least of the recordings' default bandwidths, Hz, or the least greater bandwidth at
    which the greatest number of stages have enough samples in motion.

    If the time between two reversals is shorter than the filter, no filter window is without rest,
    and no sample is in motion. A stage without a sample in motion at any bandwidth does not affect
    the bandwidth of the other stages.

    Args:
        recordings: At least one recording.
        most_Hz: Upper limit of the default bandwidths, Hz.
    """
    least = min(most_Hz, *(default_bandwidth(r) for r in recordings))
    greatest = SHARE_OF_RATE / max(r.period for r in recordings)
    tried, chosen, most = least, least, 0
    while tried <= greatest:
        prepared = [prepare(r, tried) for r in recordings]
        stages = [
            [p for p in prepared if p.recording.stage == stage]
            for stage in {r.stage for r in recordings}
        ]
        enough = sum(samples_in_motion(stage) >= LEAST_MOTION for stage in stages)
        if enough > most:
            chosen, most = tried, enough
        if enough == len(stages):
            break
        tried *= BANDWIDTH_STEP
    return chosen
