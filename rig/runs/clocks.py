"""Compares the clocks of a run: drift of drive and encoder, gaps, late answers.

The functions depend only on their arguments.
"""

from __future__ import annotations

import numpy as np

from identification.recording import Array

LEAST_DRIFT_PPM = 1.0
"""Least drift that is reported, ppm; drifts of crystals are 20 to 100 ppm."""
LATE_PERIODS = 1.0
"""Number of periods after which an answer counts as late."""


def drift_ppm(reference: Array, other: Array) -> float | None:
    """Return the drift of the other clock against the reference clock, ppm, positive if the other
    clock is faster, or None if a clock does not run forward.

    The drift is computed from the medians of the first and last fifth, so that single late stamps
    have no influence.

    Args:
        reference: Times of the reference clock, s, shape (n,).
        other: Times of the other clock at the same samples, s, shape (n,).
    """
    fifth = len(reference) // 5
    if fifth < 1 or not (np.all(np.diff(reference) > 0.0) and np.all(np.diff(other) > 0.0)):
        return None
    first, last = slice(None, fifth), slice(-fifth, None)
    gone = float(
        np.median(other[last] - reference[last]) - np.median(other[first] - reference[first])
    )
    return 1e6 * gone / float(np.mean(reference[last]) - np.mean(reference[first]))


def describe(time: Array, host: Array, drive: Array, encoder: Array) -> list[str]:
    """Return messages on gaps, late answers and drifting clocks; empty if there is nothing to
    report.

    If drive and encoder latch at one SYNC, a drift between their clocks does not affect the
    samples; if the encoder is free-running, :mod:`rig.runs.alignment` corrects the drift.

    Args:
        time: Start of each cycle, s, shape (n,).
        host: Time at which the answers of each cycle had been collected, s, shape (n,).
        drive: The drive's own stamps, s, shape (n,).
        encoder: The joint encoder's own stamps, s, shape (n,).
    """
    notes = []
    steps = np.diff(time)
    period = float(np.median(steps)) if len(steps) else 0.0
    gaps = steps > 1.5 * period
    if np.any(gaps):
        lost = round(float(np.sum(steps[gaps] / period - 1.0)))
        notes.append(
            f"{int(gaps.sum())} gaps, {lost} samples lost, the longest gap "
            f"{1e3 * float(steps.max()):.4g} ms"
        )
    late = host - time > LATE_PERIODS * period
    if np.any(late):
        notes.append(
            f"{100.0 * float(np.mean(late)):.2g} % of the answers came more than one period late"
        )
    for ours, theirs, words in (
        (time, drive, "drive's clock {} host's"),
        (drive, encoder, "encoder's clock {} drive's"),
    ):
        drift = drift_ppm(ours, theirs)
        if drift is not None and abs(drift) >= LEAST_DRIFT_PPM:
            notes.append("the " + words.format(f"runs {drift:+.1f} ppm against the"))
    return notes
