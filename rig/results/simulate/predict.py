"""Predicts the recordings of a source with models from result files, once with and once without the
effects of the model, and returns the equation errors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from identification.export.model import CorrectedModel, Predicted, predictions, rms
from identification.recording import Dataset
from identification.views.view import views


@dataclass(frozen=True)
class Prediction:
    """Prediction of one model for every recording.

    Attributes:
        file: Result file.
        effects: Names of the active effects; empty for the nominal part alone.
        parts: Every equation of every recording.
    """

    file: Path
    effects: tuple[str, ...]
    parts: tuple[Predicted, ...]

    def error(self, equation: str, role: str) -> float | None:
        """Return the rms error of one equation over the recordings of one role, or None if the
        equation does not apply.
        """
        return rms(p for p in self.parts if p.equation == equation and p.role == role)


def predict(
    dataset: Dataset, models: Sequence[tuple[Path, CorrectedModel]], bandwidth_Hz: float
) -> list[Prediction]:
    """Predict every recording with every model, and again without effects if the model has
    effects.

    Raises:
        RecordingError: A recording cannot be filtered to this bandwidth.
    """
    seen = views(dataset.recordings, bandwidth_Hz)
    found = []
    for file, model in models:
        forms = [model]
        if model.effects or model.curve is not None:
            forms.append(dataclasses.replace(model, effects={}, curve=None))
        for form in forms:
            names = (*form.effects, *(["curve"] if form.curve is not None else []))
            found.append(
                Prediction(file, names, tuple(p for view in seen for p in predictions(view, form)))
            )
    return found
