"""Equation errors of result files on a source: what each model predicts, with its effects and
without.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from identification.corrected.model import CorrectedModel
from identification.corrected.score import Predicted, predictions, rms
from identification.diagnosis.rows.view import views
from identification.plots.predicted import predicted as drawn
from identification.recording import Dataset
from rig.common.figures import Picture
from rig.common.parameter_table import Table
from rig.common.tables import number

_SHOWN_PER_ROLE = 3
_UNITS = {"transmission": "mrad", "voltage": "V"}


@dataclass(frozen=True)
class Prediction:
    """What one model predicts on every recording.

    Attributes:
        file: Result file.
        effects: Names of those that were switched on; empty for the nominal part alone.
        parts: Every equation of every recording.
    """

    file: Path
    effects: tuple[str, ...]
    parts: tuple[Predicted, ...]

    def error(self, equation: str, role: str) -> float | None:
        """Return the rms error of one equation over the recordings of one role; None where it does
        not apply.
        """
        return rms(p for p in self.parts if p.equation == equation and p.role == role)


def predict(
    dataset: Dataset, models: Sequence[tuple[Path, CorrectedModel]], bandwidth_Hz: float
) -> list[Prediction]:
    """Predict every recording with every model; one with effects also without them.

    Raises:
        RecordingError: A recording that cannot be brought to this bandwidth.
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


def error_table(found: Sequence[Prediction], unit: str) -> Table:
    """Return one row per model, equation and role."""
    rows = []
    for one in found:
        for equation in dict.fromkeys(p.equation for p in one.parts):
            errors = [one.error(equation, role) for role in ("fit", "validate")]
            scale = 1e3 if equation == "transmission" else 1.0
            cells = (number(None if e is None else scale * e, 4) for e in errors)
            effects = ", ".join(one.effects) or "none"
            rows.append((one.file.stem, effects, equation, *cells, _UNITS.get(equation, unit)))
    return Table(
        ("model", "effects", "equation", "rms, fit", "rms, validate", "unit"), tuple(rows), (3, 4)
    )


def error_record(found: Sequence[Prediction], unit: str) -> list[dict[str, object]]:
    """Return the same for the result file, SI units."""
    return [
        {
            "result": str(one.file),
            "effects": list(one.effects),
            "equation": equation,
            "unit": {"transmission": "rad", "voltage": "V"}.get(equation, unit),
            "rms": one.error(equation, "fit"),
            "validate_rms": one.error(equation, "validate"),
        }
        for one in found
        for equation in dict.fromkeys(p.equation for p in one.parts)
    ]


def pictures(found: Sequence[Prediction], unit: str) -> list[Picture]:
    """Return figures of the first model's torque equation, a few recordings of each role."""
    parts = [p for p in found[0].parts if p.equation == "torque"]
    shown = [
        p
        for role in ("fit", "validate")
        for p in [p for p in parts if p.role == role][:_SHOWN_PER_ROLE]
    ]
    return [
        Picture.of(
            f"predicted_{p.recording}",
            f"{p.recording} ({p.role}): torque measured and predicted",
            drawn(p, unit),
        )
        for p in shown
    ]
