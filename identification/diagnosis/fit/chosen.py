"""Chooses the recordings and the bandwidth of a diagnosis."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from identification.diagnosis.fit.start import bandwidth_of
from identification.estimate.equation_error import LEAST_MOTION, samples_in_motion
from identification.prepare import prepare
from identification.recording import Dataset, RecordingError


class Chosen(NamedTuple):
    """Recordings and bandwidth of a diagnosis.

    Attributes:
        dataset: The dataset; recordings that cannot be used have the role ``unused``.
        bandwidth: Bandwidth of all errors, Hz.
        warnings: Texts that state which recordings are not used, and why.
    """

    dataset: Dataset
    bandwidth: float
    warnings: tuple[str, ...] = ()


def choose(dataset: Dataset, bandwidth_Hz: float | None) -> Chosen:
    """Return the recordings to use, and the bandwidth of all errors.

    Loaded recordings in which the joint rests nearly all the time do not determine friction under
    load. Such recordings are not used, and only the unloaded recordings are diagnosed.

    Args:
        dataset: The dataset.
        bandwidth_Hz: Bandwidth of all errors, or None for a bandwidth chosen from the recordings.

    Raises:
        RecordingError: No recording has the role ``fit``.
    """
    fitted = dataset.part("fit")
    if not fitted:
        raise RecordingError(
            "no recording has the role fit, but a diagnosis needs at least one; set `role: fit` in "
            "the campaign file"
        )
    bandwidth = bandwidth_Hz or bandwidth_of(fitted)
    moving = {
        stage: samples_in_motion([prepare(r, bandwidth) for r in fitted if r.stage == stage])
        for stage in {r.stage for r in fitted}
    }
    rests = moving.get("loaded", LEAST_MOTION) < LEAST_MOTION
    if not rests or moving.get("unloaded", 0) < LEAST_MOTION:
        return Chosen(dataset, bandwidth)
    kept = tuple(
        replace(r, role="unused") if r.stage == "loaded" else r for r in dataset.recordings
    )
    names = ", ".join(r.name for r in dataset.recordings if r.stage == "loaded")
    warning = (
        f"{names}: at a bandwidth of {bandwidth:.3g} Hz these loaded recordings have "
        f"{moving['loaded']} samples in motion, and at least {LEAST_MOTION} are needed. Therefore "
        "no loaded recording is used, and effects of the load are not diagnosed; add recordings in "
        "which the loaded joint moves longer"
    )
    return Chosen(replace(dataset, recordings=kept), bandwidth, (warning,))
