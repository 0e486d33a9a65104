"""Errors of the equations: measured less modelled side, filtered to one bandwidth, at the samples
where the equation applies. Every command that prints an error computes it here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.numerics.arrays import Array
from identification.signals import BoolArray, Decimator, noise, without_tones
from identification.views.nominal import INSTANTS, NominalTorque
from identification.views.view import View, sharpness

LEAST_PER_COLUMN = 10  # least number of samples for each quantity that is fitted in a recording
ACCURACY = 2e-4
"""Error that even the best sensors may cause, as a share of the greatest torque or voltage."""


@dataclass(frozen=True)
class Predicted:
    """One equation of one recording at the stated bandwidth."""

    equation: str  # `torque`, `transmission`, `voltage` or `breakaway`
    recording: str  # name of the recording
    role: str  # `fit` or `validate`
    time: Array  # s, shape (n,)
    # Measured side in the equation's unit, shape (n,); NaN at samples where the equation does not
    # apply (at rest, or with the power stage off).
    measured: Array
    model: Array  # modelled side in the equation's unit, shape (n,); NaN at the same samples

    @property
    def error(self) -> Array:
        """Measured less modelled side of the equation where the equation applies, shape (k,)."""
        off = self.measured - self.model
        return off[np.isfinite(off)]


def rms(parts: Iterable[Predicted]) -> float | None:
    """Return the root mean square of several recordings' errors, or None without any error."""
    errors = [p.error for p in parts]
    count = sum(len(e) for e in errors)
    return math.sqrt(sum(float(e @ e) for e in errors) / count) if count else None


def predicted(
    view: View, equation: str, measured: Array, model: Array, applies: BoolArray
) -> Predicted:
    """Return one equation of a recording."""
    series = (np.where(applies, view.low_pass(side), np.nan) for side in (measured, model))
    return Predicted(equation, view.recording.name, view.recording.role, view.kept_times, *series)


def predicted_torque(view: View, nominal: NominalTorque) -> Predicted:
    """Return the torque equation of the nominal model, in steady motion: drive torque (measured)
    and the torque that the motion requires less that of known loads.
    """
    asked = nominal.torque(view) - view.known
    return predicted(view, "torque", view.transmitted, asked, view.moving)


def predicted_voltage(view: View, model: Array) -> Predicted:
    """Return the voltage equation with the modelled voltage ``model``, V, shape (m,).

    What samples at instants leave unknown (:data:`INSTANTS`) is fitted in each recording, as its
    size depends on the time stamps of the recording.
    """
    assert view.voltage is not None
    lit = view.low_pass.untouched(np.isnan(view.voltage))
    found = predicted(view, "voltage", np.nan_to_num(view.voltage), model, lit)
    columns = np.stack([view.low_pass(make(view))[lit] for make in INSTANTS.values()], axis=1)
    columns = columns[:, np.any(columns != 0.0, axis=0)]
    if not columns.shape[1] or len(columns) < LEAST_PER_COLUMN * columns.shape[1]:
        return found
    part = found.model.copy()
    part[lit] += columns @ np.linalg.lstsq(columns, (found.measured - found.model)[lit])[0]
    return replace(found, model=part)


def predicted_breakaways(view: View, model: Array) -> Predicted:
    """Return the torque at the breakaways with the modelled torque ``model``, N m, shape (m,); a
    breakaway counts less, the faster the torque rises.
    """
    weight = sharpness(view)
    sides = (weight * series[view.breakaways] for series in (np.roll(view.raw_torque, 1), model))
    recording = view.recording
    return Predicted(
        "breakaway", recording.name, recording.role, view.time[view.breakaways], *sides
    )


def relative(parts: Iterable[Predicted]) -> float | None:
    """Return the norm of the errors over that of the measured side, or None without any error."""
    error = measured = 0.0
    for part in parts:
        off = part.error
        known = part.measured[np.isfinite(part.measured - part.model)]
        error += float(off @ off)
        measured += float(known @ known)
    return math.sqrt(error / measured) if measured > 0.0 else None


def noise_floor(parts: Sequence[Predicted], low_pass: Decimator) -> float | None:
    """Return the rms of the errors that no model can explain: the noise before the filter, by third
    differences of the errors in each recording, and the accuracy of the best sensors. None without
    any error.
    """
    known = [(k, p, np.isfinite(p.measured - p.model)) for k, p in enumerate(parts)]
    known = [(k, p, at) for k, p, at in known if np.any(at)]
    if not known:
        return None
    owner = np.concatenate([np.full(int(np.sum(at)), k) for k, _, at in known])
    left = without_tones(
        np.concatenate([p.error for _, p, _ in known]),
        owner,
        np.concatenate([p.time[at] for _, p, at in known]),
    )
    common = noise(left, owner, low_pass)
    squares = 0.0
    for k, _, at in known:
        own = noise(left[owner == k], owner[owner == k], low_pass)
        squares += float(np.sum(at)) * max(common, own) ** 2
    greatest = max(float(np.max(np.abs(p.measured[at]))) for _, p, at in known)
    return math.hypot(math.sqrt(squares / len(owner)), ACCURACY * greatest)
