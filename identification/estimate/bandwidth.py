"""Chooses the bandwidth of a fit and the recordings that are long enough for its filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from identification.estimate.equation_error import LEAST_MOTION, samples_in_motion
from identification.prepare import (
    SLOW_BANDWIDTH_HZ,
    default_bandwidth,
    least_samples,
    prepare,
    uniform_grid,
)
from identification.recording import Dataset, Recording

STEP = 1.25  # ratio of successive bandwidths that are tried
SHARE_OF_RATE, SLOW_SHARE_OF_RATE = 1.0 / 6.0, 0.4
"""Greatest bandwidth that is tried, relative to the sampling rate: of any log, and of a slow log in
which no lower bandwidth leaves enough samples in motion.
"""
MOST_SHORT = 0.1
"""Greatest share of the samples that may be in pieces of files that are shorter than the filter."""
NAMED = 3  # greatest number of recordings that a warning lists by name


class Choice(NamedTuple):
    """Recordings and bandwidth of a fit."""

    dataset: Dataset  # the dataset without the recordings that are shorter than the filter
    bandwidth: float  # bandwidth of torque and regressors, Hz
    warnings: tuple[str, ...] = ()  # one text on all recordings that are left out; empty if none is


def moving_samples(recordings: Sequence[Recording], bandwidth_Hz: float) -> int:
    """Return the number of samples in motion that an identification uses at a bandwidth."""
    return samples_in_motion([prepare(r, bandwidth_Hz) for r in recordings])


def choose_bandwidth(
    dataset: Dataset,
    bandwidth_Hz: float | None = None,
    most_Hz: float = math.inf,
    moving: Callable[[Sequence[Recording], float], int] = moving_samples,
) -> Choice:
    """Return the bandwidth of a fit, and the recordings that are long enough for its filter.

    Identification, diagnosis and simulation use this choice.

    Args:
        dataset: The dataset; without recordings with role ``fit`` all its recordings count.
        bandwidth_Hz: Bandwidth, Hz, or None for :func:`common_bandwidth`.
        most_Hz: Upper limit of the default bandwidths, Hz.
        moving: Function that returns the number of samples in motion at a bandwidth.
    """
    fitted = dataset.part("fit") or dataset.recordings
    if bandwidth_Hz is None:
        bandwidth_Hz = common_bandwidth(fitted, most_Hz, moving)
    short = [r for r in dataset.recordings if not _long_enough(r, bandwidth_Hz)]
    kept = tuple(r for r in dataset.recordings if _long_enough(r, bandwidth_Hz))
    whole = {(r.role, r.stage) for r in fitted} <= {(r.role, r.stage) for r in kept}
    if not short or not whole:
        # Without a stage there is nothing to fit; the preparation of the recordings says why.
        return Choice(dataset, bandwidth_Hz)
    names = listed([r.name for r in short])
    seconds = max(least_samples(1.0 / r.period, bandwidth_Hz) * r.period for r in short)
    warning = (
        f"{names}: left out, because shorter than {seconds:.3g} s, the filter for a bandwidth of "
        f"{bandwidth_Hz:.3g} Hz; a higher --bandwidth has a shorter filter"
    )
    return Choice(replace(dataset, recordings=kept), bandwidth_Hz, (warning,))


def common_bandwidth(
    recordings: Sequence[Recording],
    most_Hz: float = math.inf,
    moving: Callable[[Sequence[Recording], float], int] = moving_samples,
) -> float:
    """Return the least of the recordings' default bandwidths, Hz, or the least greater bandwidth at
    which the greatest number of stages have enough samples in motion, and no file is shorter than
    the filter. Of a file that gaps split into pieces, a few short pieces may be.

    If the time between two reversals is shorter than the filter, no filter window is without rest,
    and no sample is in motion. A stage without a sample in motion at any bandwidth does not affect
    the bandwidth of the other stages.

    Args:
        recordings: At least one recording.
        most_Hz: Upper limit of the default bandwidths, Hz.
        moving: Function that returns the number of samples in motion at a bandwidth.
    """
    least = min(most_Hz, *(default_bandwidth(r) for r in recordings))
    rate = 1.0 / max(r.period for r in recordings)
    slow = max(SHARE_OF_RATE * rate, min(SLOW_SHARE_OF_RATE * rate, SLOW_BANDWIDTH_HZ))
    stages = {r.stage for r in recordings}
    samples = sum(len(r.time) for r in recordings)
    files = {r.source or r.name for r in recordings}
    tried, chosen, most = least, least, 0
    while tried <= SHARE_OF_RATE * rate or (most == 0 and tried <= slow):
        usable = [r for r in recordings if _long_enough(r, tried)]
        served = files == {r.source or r.name for r in usable}
        if served and sum(len(r.time) for r in usable) >= (1.0 - MOST_SHORT) * samples:
            parts = [[r for r in usable if r.stage == stage] for stage in stages]
            enough = sum(moving(part, tried) >= LEAST_MOTION for part in parts)
            if enough > most:
                chosen, most = tried, enough
            if enough == len(stages):
                break
        tried *= STEP
    return chosen


def listed(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def _long_enough(recording: Recording, bandwidth_Hz: float) -> bool:
    return len(uniform_grid(recording)) >= least_samples(1.0 / recording.period, bandwidth_Hz)
