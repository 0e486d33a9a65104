"""Refits the nominal parameters, by the default estimator, to recordings from which the effects are
subtracted.

The diagnosis uses equation errors, which do not resolve the falling branch of friction under load.
The default estimator refines its values by prediction errors, but accepts the refined values only
if no physics is missing; therefore the identified effects are subtracted first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from identification.corrected.model import CorrectedModel
from identification.corrected.signals import signals_of
from identification.diagnosis.rows.view import View, views
from identification.estimate.default import identify
from identification.recording import Dataset, Recording, RecordingError
from identification.result import Identification

_REPLACED = ("current", "voltage", "torque")


def without_effects(
    recordings: Sequence[Recording], model: CorrectedModel, bandwidth_Hz: float
) -> list[Recording]:
    """Return the recordings with the drive torque that would have occurred without the effects as
    torque channel.

    Raises:
        RecordingError: A recording has neither torque nor current, or does not allow this
            bandwidth.
    """
    seen = views(recordings, bandwidth_Hz)
    return [
        _without(recording, view, model) for recording, view in zip(recordings, seen, strict=True)
    ]


def refit(
    dataset: Dataset,
    model: CorrectedModel,
    bandwidth_Hz: float,
    rng: np.random.Generator | None = None,
) -> Identification:
    """Return the nominal parameters of a dataset without its effects, with intervals; ``rng`` is
    that of :func:`identify`.

    Raises:
        RecordingError: The recordings do not determine the model.
    """
    fitted = without_effects(dataset.part("fit"), model, bandwidth_Hz)
    return identify(dataclasses.replace(dataset, recordings=tuple(fitted)), rng=rng)


def _without(recording: Recording, view: View, model: CorrectedModel) -> Recording:
    s, m = signals_of(view), model.numbers(recording)
    plain = dataclasses.replace(model, effects={}, curve=None)
    added = (model.torque(s, m) - plain.torque(s, m)) - (model.drive(s, m) - plain.drive(s, m))
    measured = recording.channels
    if "torque" not in measured and "current" not in measured:
        raise RecordingError(
            f"{recording.name}: effects are subtracted from the torque or the current, but "
            "the recording has neither channel"
        )
    raw = measured["torque"] if "torque" in measured else m["ampere_torque"] * measured["current"]
    averaged = recording.averaged & {"torque", "current"}
    shift = 0.5 * recording.period if averaged else 0.0
    channels = {name: values for name, values in measured.items() if name not in _REPLACED}
    channels["torque"] = np.asarray(raw - np.interp(recording.time - shift, view.time, added))
    kept = (recording.averaged - set(_REPLACED)) | ({"torque"} if averaged else set())
    return dataclasses.replace(recording, channels=channels, averaged=frozenset(kept))
