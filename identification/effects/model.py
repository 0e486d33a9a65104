"""The corrected model: nominal parameters, identified effects, and an empirical curve of the
remaining mismatch; its errors on recordings, and recordings without the effects.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from identification.effects import EFFECTS
from identification.effects.effect import Coefficients, Columns, Effect, Shape
from identification.estimate.default import identify_any_length
from identification.estimate.equation_error import LEAST_MOTION
from identification.model.parameters import UNITS_ROTARY
from identification.numerics.arrays import Array
from identification.recording import Dataset, Recording, RecordingError
from identification.result import Identification
from identification.views.nominal import Nominal, has_winding_voltage, winding_voltage
from identification.views.predicted import (
    Predicted,
    predicted,
    predicted_breakaways,
    predicted_voltage,
)
from identification.views.view import View, delayed_view, rise_rate, views

COORDINATES = {"angle": "angle", "speed": "velocity"}
"""Coordinates of an empirical curve, with the signal of each coordinate."""
_REPLACED = ("current", "voltage", "torque")


@dataclass(frozen=True)
class Curve:
    """An empirical curve of a mismatch outside the catalogue, for simulations.

    The curve is ``value`` over ``grid``, shape (g,) each; it is linear between points and constant
    beyond the first and the last point. With ``against_motion`` it acts against the motion, like
    friction, in both directions.
    """

    equation: str
    coordinate: str
    unit: str
    residual_unit: str
    grid: Array
    value: Array
    against_motion: bool = False


class Response(NamedTuple):
    """What one effect adds to one equation: coefficients times the regressors ``columns`` at the
    nonlinear parameters ``shape``. If ``late``, the view is shifted by the time skew.
    """

    effect: Effect
    columns: Columns
    shape: Shape
    coefficients: Coefficients
    late: bool = False

    def added(self, view: View, nominal: Nominal) -> Array:
        """Return what the effect adds, shape (m,)."""
        if self.late:
            view = delayed_view(view, nominal.late_s)
        return np.asarray(np.array(self.coefficients) @ self.columns(view, nominal, self.shape))


@dataclass(frozen=True)
class CorrectedModel:
    """Result of a diagnosis as a model: nominal parameters, identified effects, empirical curve.

    Attributes:
        parameters: Nominal parameters, name to value; parameters that are absent count as 0.
            ``R`` and ``Ke`` replace the resistance, ohm, and the back-EMF constant, V s/rad, of the
            bench; ``J_r`` is the part of the inertia that moves with the motor behind a flexible
            transmission.
        alpha: Stribeck exponent.
        effects: Name of each effect to its parameters; an effect that occurs in one recording only
            has the parameter ``recording``, the number of this recording, counted from 1.
        curve: Empirical curve of a mismatch outside the catalogue, or None.
        catalogue: Name of each effect to its definition; with effects of one's own, more than the
            catalogue.
    """

    parameters: Mapping[str, float]
    alpha: float = 2.0
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    curve: Curve | None = None
    catalogue: Mapping[str, Effect] = field(default_factory=lambda: EFFECTS, repr=False)

    @cached_property
    def _fitted(self) -> tuple[Nominal, Mapping[str, tuple[Shape, Coefficients]]]:
        """Nominal values for the regressors, and parameters and coefficients of each effect."""
        plain = nominal = Nominal(self.parameters, (), self.alpha)
        placed = {n: self.catalogue[n].at(given, plain) for n, given in self.effects.items()}
        for name, (shape, coefficients) in placed.items():
            nominal = self.catalogue[name].feeds_back(nominal, shape, coefficients)
        for name, (shape, coefficients) in placed.items():
            nominal, shape = self.catalogue[name].begin(nominal, shape)
            placed[name] = shape, coefficients
        return nominal, placed

    @property
    def nominal(self) -> Nominal:
        """Nominal values on which the regressors of the effects depend."""
        return self._fitted[0]

    @property
    def values(self) -> dict[str, float]:
        """Name to value of all parameters, those of effects as ``effect.name``."""
        effects = {f"{e}.{n}": v for e, own in self.effects.items() for n, v in own.items()}
        return {**self.parameters, **effects}

    def changed(self, values: Mapping[str, float]) -> CorrectedModel:
        """Return the model with other values of some parameters, by the names of ``values``.

        Raises:
            RecordingError: The model has no such parameter.
        """
        if unknown := values.keys() - self.values.keys():
            raise RecordingError(
                f"no parameter of the model: {', '.join(sorted(unknown))}; it has "
                f"{', '.join(self.values)}"
            )
        effects = {
            e: {n: values.get(f"{e}.{n}", v) for n, v in own.items()}
            for e, own in self.effects.items()
        }
        nominal = {n: values.get(n, v) for n, v in self.parameters.items()}
        return dataclasses.replace(self, parameters=nominal, effects=effects)

    def numbers(self, recording: Recording) -> dict[str, float | list[float]]:
        """Return the nominal parameters, the bench constants and the values of effects on which
        other effects depend, by the names of the exported file; unknown values are 0.
        """
        bench, nominal = recording.bench, self.nominal
        known = {name: float(self.parameters.get(name, 0.0)) for name in UNITS_ROTARY}
        constants = {
            "R": self.parameters.get("R", bench.resistance),
            "L": bench.inductance,
            "Ke": self.parameters.get("Ke", bench.back_emf_constant),
            "L1": bench.moment_arm,
            "i": bench.gear_ratio,
            "ampere_torque": recording.bench.ampere_torque,
        }
        loads = ("load_sine", "load_cosine", "load_slope", "load_constant")
        return {
            **known,
            **dict(zip(loads, nominal.undeclared, strict=True)),
            "zero_A": nominal.zero_A,
            "efficiency": nominal.efficiency,
            "presliding_stiffness": nominal.presliding_stiffness,
            "late_s": nominal.late_s,
            "ripple": [float(x) for part in nominal.ripple for x in part],
            "alpha": self.alpha,
            **{name: float(value or 0.0) for name, value in constants.items()},
        }

    def responses(self, equation: str) -> Iterator[Response]:
        """Yield what each effect adds to an equation."""
        for name, (shape, coefficients) in self._fitted[1].items():
            effect = self.catalogue[name]
            columns = effect.corrected
            if equation in columns:
                late = effect.at_angle and equation == "torque" and self.nominal.late_s != 0.0
                yield Response(effect, columns[equation], shape, coefficients, late)

    def torque(self, view: View) -> Array:
        """Return the torque that the motion requires, N m at the joint, shape (n,)."""
        found = [r for r in self.responses("torque") if not r.effect.on_drive]
        rigid = self.nominal.torque(view) + self.parameters.get("J_r", 0.0) * view.twist
        total = self._sum(rigid, found, view)
        return total + carried(self.curve, "torque", view)

    def drive(self, view: View) -> Array:
        """Return the torque that the logged current produces, N m at the joint, shape (n,).

        Effects are computed at the torque that the nominal model requires, as in the diagnosis: the
        measured torque contains the mismatch, which would then explain itself.
        """
        found = [r for r in self.responses("torque") if r.effect.on_drive]
        return view.transmitted - self._sum(np.zeros(len(view.time)), found, view)

    def added_torque(self, view: View) -> Array:
        """Return the torque that effects and curve add to the nominal model, N m, shape (m,)."""
        plain = dataclasses.replace(self, effects={}, curve=None)
        return (self.torque(view) - plain.torque(view)) - (self.drive(view) - plain.drive(view))

    def twist(self, view: View) -> Array:
        """Return motor_angle / i - angle up to a constant, rad, shape (n,)."""
        total = self._sum(np.zeros(len(view.time)), self.responses("transmission"), view)
        return total + carried(self.curve, "transmission", view)

    def voltage(self, view: View) -> Array:
        """Return the voltage that the logged current requires, V, shape (n,)."""
        total = self._sum(self._winding(view), self.responses("voltage"), view)
        return total + carried(self.curve, "voltage", view)

    def _winding(self, view: View) -> Array:
        """Return the voltage of the winding, with the constants of the model where it has them."""
        bench, total = view.recording.bench, winding_voltage(view)
        for name, known, signal in (
            ("R", bench.resistance, view.current),
            ("Ke", bench.back_emf_constant, view.motor_speed),
        ):
            if name in self.parameters and signal is not None:
                total = total + (self.parameters[name] - (known or 0.0)) * signal
        return total

    def breakaway(self, view: View) -> Array:
        """Return the torque in the last sample before a breakaway, N m at the joint, shape (n,).

        The breakaway is somewhere in the sample period: the torque of the last sample at rest is
        below the static limit by its rise in half a period.
        """
        nominal = self.nominal
        limit = view.sense * (nominal.get("Ms") + view.moment * nominal.get("mu_s"))
        limit = limit - 0.5 * view.step * rise_rate(view)
        return self._sum(limit, self.responses("breakaway"), view)

    def _sum(self, total: Array, found: Iterable[Response], view: View) -> Array:
        for response in found:
            total = total + response.added(view, self.nominal)
        return total


def carried(curve: Curve | None, equation: str, view: View) -> Array:
    """Return the empirical curve at the signals, shape (n,); 0 if the curve belongs to another
    equation or is None.
    """
    if curve is None or curve.equation != equation or curve.coordinate not in COORDINATES:
        return np.zeros(len(view.time))
    value = np.interp(getattr(view, COORDINATES[curve.coordinate]), curve.grid, curve.value)
    return np.asarray(view.sense * value if curve.against_motion else value)


def predictions(view: View, model: CorrectedModel) -> tuple[Predicted, ...]:
    """Return every equation that the recording's channels allow, measured and predicted.

    In the transmission equation the mean of the measured less the modelled difference is
    subtracted for each recording, because the zeros of the two encoders are arbitrary.
    """
    recording = view.recording
    # The known loads supply a part of the required torque; the drive supplies the rest.
    asked = model.torque(view) - view.known
    found = [predicted(view, "torque", model.drive(view), asked, view.moving)]
    if view.lag is not None:
        lag, twist = view.low_pass(view.lag), view.low_pass(model.twist(view))
        zero, name = float(np.mean(lag - twist)), recording.name
        found.append(
            Predicted("transmission", name, recording.role, view.kept_times, lag - zero, twist)
        )
    if has_winding_voltage(view):
        found.append(predicted_voltage(view, model.voltage(view)))
    if len(view.breakaways):
        found.append(predicted_breakaways(view, model.breakaway(view)))
    return tuple(found)


def views_for(
    recordings: Sequence[Recording], bandwidth_Hz: float, model: CorrectedModel
) -> tuple[View, ...]:
    """Return the views with which a model is compared: friction is a function of the valve's
    motion if an effect makes the transmission flexible, unless the valve hardly moves.

    Args:
        recordings: Recordings.
        bandwidth_Hz: Bandwidth of the errors.
        model: The model.

    Raises:
        RecordingError: A recording does not allow this bandwidth.
    """
    if any(model.catalogue[name].flexible for name in model.effects):
        found = views(recordings, bandwidth_Hz, True)
        if sum(int(np.sum(v.moving)) for v in found) >= LEAST_MOTION:
            return found
    return views(recordings, bandwidth_Hz)


def without_effects(
    recordings: Sequence[Recording], model: CorrectedModel, bandwidth_Hz: float
) -> list[Recording]:
    """Return the recordings with the drive torque that would have occurred without the effects as
    torque channel.

    Raises:
        RecordingError: A recording has neither torque nor current, or does not allow this
            bandwidth.
    """
    seen = views_for(recordings, bandwidth_Hz, model)
    return [
        _without(recording, view, model) for recording, view in zip(recordings, seen, strict=True)
    ]


def refit(
    dataset: Dataset,
    model: CorrectedModel,
    bandwidth_Hz: float,
    rng: np.random.Generator | None = None,
) -> Identification:
    """Return the nominal parameters of a dataset without its effects, with intervals, by the
    default estimator; ``rng`` is that of :func:`identify_any_length`.

    The diagnosis uses equation errors, which do not resolve the falling branch of friction under
    load. The default estimator refines its values by prediction errors, but accepts the refined
    values only if no physics is missing; therefore the identified effects are subtracted first.

    Raises:
        RecordingError: The recordings do not determine the model.
    """
    # Recordings set aside heat the machine too.
    every = without_effects(dataset.recordings, model, bandwidth_Hz)
    fitted = [r for r in every if r.role == "fit"]
    return identify_any_length(dataclasses.replace(dataset, recordings=tuple(fitted)), rng=rng)


def _without(recording: Recording, view: View, model: CorrectedModel) -> Recording:
    added, measured = model.added_torque(view), recording.channels
    if "torque" not in measured and "current" not in measured:
        raise RecordingError(
            f"{recording.name}: effects are subtracted from the torque or the current, but "
            "the recording has neither channel"
        )
    raw = (
        measured["torque"]
        if "torque" in measured
        else recording.bench.ampere_torque * measured["current"]
    )
    averaged = recording.averaged & {"torque", "current"}
    shift = 0.5 * recording.period if averaged else 0.0
    channels = {name: values for name, values in measured.items() if name not in _REPLACED}
    channels["torque"] = np.asarray(raw - np.interp(recording.time - shift, view.time, added))
    kept = (recording.averaged - set(_REPLACED)) | ({"torque"} if averaged else set())
    return dataclasses.replace(recording, channels=channels, averaged=frozenset(kept))
