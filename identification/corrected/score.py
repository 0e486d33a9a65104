"""Computes the errors of a corrected model on recordings: the error of each equation at the stated
bandwidth.

The measured and the modelled side of an equation are computed at the full sample rate and pass the
same filter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from identification.corrected.model import CorrectedModel
from identification.corrected.signals import signals_of
from identification.diagnosis.rows.view import View
from identification.numerics.arrays import Array


@dataclass(frozen=True)
class Predicted:
    """One equation of one recording at the stated bandwidth.

    Attributes:
        equation: ``torque``, ``transmission`` or ``voltage``.
        recording: Name of the recording.
        role: ``fit`` or ``validate``.
        time: s, shape (n,).
        measured: Measured side in the equation's unit, shape (n,); NaN at samples where the
            equation does not apply (at rest, or with the power stage off).
        model: Modelled side in the equation's unit, shape (n,); NaN at the same samples.
    """

    equation: str
    recording: str
    role: str
    time: Array
    measured: Array
    model: Array

    @property
    def error(self) -> Array:
        """Measured less modelled side of the equation, at the samples where the equation
        applies, shape (k,).
        """
        off = self.measured - self.model
        return off[np.isfinite(off)]


def predictions(view: View, model: CorrectedModel) -> tuple[Predicted, ...]:
    """Return every equation that the recording's channels allow, measured and predicted.

    In the transmission equation the median of the measured less the modelled difference is
    subtracted for each recording, because the zeros of the two encoders are arbitrary.
    """
    s, m, recording = signals_of(view), model.numbers(view.recording), view.recording
    # The known loads supply a part of the required torque; the drive supplies the rest.
    asked = model.torque(s, m) - view.known
    found = [_one(view, "torque", model.drive(s, m), asked, ~view.moving)]
    if view.lag is not None:
        lag, twist = view.low_pass(view.lag), view.low_pass(model.twist(s, m))
        zero = float(np.median(lag - twist))
        found.append(
            Predicted(
                "transmission", recording.name, recording.role, view.kept_times, lag - zero, twist
            )
        )
    known = recording.bench.resistance is not None and recording.bench.back_emf_constant is not None
    if view.voltage is not None and view.current is not None and known:
        dark = ~view.low_pass.untouched(np.isnan(view.voltage))
        found.append(_one(view, "voltage", np.nan_to_num(view.voltage), model.voltage(s, m), dark))
    return tuple(found)


def rms(parts: Iterable[Predicted]) -> float | None:
    """Return the root mean square of the errors of several recordings, or None without any
    error.
    """
    errors = [p.error for p in parts]
    count = sum(len(e) for e in errors)
    return math.sqrt(sum(float(e @ e) for e in errors) / count) if count else None


def _one(
    view: View, equation: str, measured: Array, model: Array, left_out: np.ndarray
) -> Predicted:
    series = (np.where(left_out, np.nan, view.low_pass(side)) for side in (measured, model))
    return Predicted(equation, view.recording.name, view.recording.role, view.kept_times, *series)
