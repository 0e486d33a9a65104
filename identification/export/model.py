"""The corrected model: nominal parameters, identified effects, and an empirical curve of the
remaining mismatch; its errors on recordings, and recordings without the effects.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from identification.diagnosis.result import Curve
from identification.effects import EFFECTS
from identification.effects.effect import Columns, Effect, Shape
from identification.estimate.default import identify
from identification.model.parameters import UNITS_ROTARY
from identification.numerics.arrays import Array
from identification.recording import Dataset, Recording, RecordingError
from identification.result import Identification
from identification.views.nominal import Nominal, winding_voltage
from identification.views.view import View, views

COORDINATES = {"angle": "angle", "speed": "velocity", "time": "time"}
"""Coordinates of an empirical curve, with the signal of each coordinate."""
_REPLACED = ("current", "voltage", "torque")


class Response(NamedTuple):
    """What one effect adds to one equation: coefficients times the regressors ``columns`` at the
    nonlinear parameters ``shape``.
    """

    effect: Effect
    columns: Columns
    shape: Shape
    coefficients: tuple[float, ...]

    def added(self, view: View, nominal: Nominal) -> Array:
        """Return what the effect adds, shape (m,)."""
        return np.asarray(np.array(self.coefficients) @ self.columns(view, nominal, self.shape))


@dataclass(frozen=True)
class CorrectedModel:
    """Result of a diagnosis as a model: nominal parameters, identified effects, empirical curve.

    Attributes:
        parameters: Nominal parameters, name to value; parameters that are absent count as 0.
        alpha: Stribeck exponent.
        effects: Name of each effect to its parameters; an effect that occurs in one recording only
            has the parameter ``recording``, the number of this recording, counted from 1.
        curve: Empirical curve of a mismatch outside the catalogue, or None.
    """

    parameters: Mapping[str, float]
    alpha: float = 2.0
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    curve: Curve | None = None

    @cached_property
    def _fitted(self) -> tuple[Nominal, Mapping[str, tuple[Shape, tuple[float, ...]]]]:
        """Nominal values for the regressors, and parameters and coefficients of each effect."""
        plain = nominal = Nominal(self.parameters, (), self.alpha)
        placed = {n: EFFECTS[n].at(given, plain) for n, given in self.effects.items()}
        for name, (shape, coefficients) in placed.items():
            nominal = EFFECTS[name].feeds_back(nominal, shape, coefficients)
        for name, (shape, coefficients) in placed.items():
            nominal, shape = EFFECTS[name].begin(nominal, shape)
            placed[name] = shape, coefficients
        return nominal, placed

    @property
    def nominal(self) -> Nominal:
        """Nominal values on which the regressors of the effects depend."""
        return self._fitted[0]

    def numbers(self, recording: Recording) -> dict[str, float | list[float]]:
        """Return the nominal parameters, the bench constants and the values of effects on which
        other effects depend, by the names of the exported file; unknown values are 0.
        """
        bench, nominal = recording.bench, self.nominal
        known = {name: float(self.parameters.get(name, 0.0)) for name in UNITS_ROTARY}
        constants = {
            "R": bench.resistance,
            "L": bench.inductance,
            "Ke": bench.back_emf_constant,
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
            "ripple": [float(x) for part in nominal.ripple for x in part],
            "alpha": self.alpha,
            **{name: float(value or 0.0) for name, value in constants.items()},
        }

    def responses(self, equation: str) -> Iterator[Response]:
        """Yield what each effect adds to an equation; the torque at a breakaway is part of the
        torque.
        """
        for name, (shape, coefficients) in self._fitted[1].items():
            effect = EFFECTS[name]
            modelled = effect.enters if effect.modelled is None else effect.modelled
            columns = {e: c for e, c in effect.columns.items() if e in modelled}
            if equation == "torque" and "torque" not in columns and "breakaway" in columns:
                columns["torque"] = columns["breakaway"]
            if equation in columns:
                yield Response(effect, columns[equation], shape, coefficients)

    def torque(self, view: View) -> Array:
        """Return the torque that the motion requires, N m at the joint, shape (n,)."""
        found = [r for r in self.responses("torque") if not r.effect.on_drive]
        total = self._sum(self.nominal.torque(view), found, view)
        return total + carried(self.curve, "torque", view)

    def drive(self, view: View) -> Array:
        """Return the torque that the logged current produces, N m at the joint, shape (n,).

        What an effect changes is computed at the torque that the nominal model requires, as in the
        diagnosis: at the measured torque, it would explain a mismatch by itself.
        """
        found = [r for r in self.responses("torque") if r.effect.on_drive]
        return view.transmitted - self._sum(np.zeros(len(view.time)), found, view)

    def twist(self, view: View) -> Array:
        """Return motor_angle / i - angle up to a constant, rad, shape (n,)."""
        total = self._sum(np.zeros(len(view.time)), self.responses("transmission"), view)
        return total + carried(self.curve, "transmission", view)

    def voltage(self, view: View) -> Array:
        """Return the voltage that the logged current requires, V, shape (n,)."""
        total = self._sum(winding_voltage(view), self.responses("voltage"), view)
        return total + carried(self.curve, "voltage", view)

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
    recording = view.recording
    # The known loads supply a part of the required torque; the drive supplies the rest.
    asked = model.torque(view) - view.known
    found = [_one(view, "torque", model.drive(view), asked, ~view.moving)]
    if view.lag is not None:
        lag, twist = view.low_pass(view.lag), view.low_pass(model.twist(view))
        zero = float(np.median(lag - twist))
        found.append(
            Predicted(
                "transmission", recording.name, recording.role, view.kept_times, lag - zero, twist
            )
        )
    known = recording.bench.resistance is not None and recording.bench.back_emf_constant is not None
    if view.voltage is not None and view.current is not None and known:
        dark = ~view.low_pass.untouched(np.isnan(view.voltage))
        found.append(_one(view, "voltage", np.nan_to_num(view.voltage), model.voltage(view), dark))
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
    """Return the nominal parameters of a dataset without its effects, with intervals, by the
    default estimator; ``rng`` is that of :func:`identify`.

    The diagnosis uses equation errors, which do not resolve the falling branch of friction under
    load. The default estimator refines its values by prediction errors, but accepts the refined
    values only if no physics is missing; therefore the identified effects are subtracted first.

    Raises:
        RecordingError: The recordings do not determine the model.
    """
    fitted = without_effects(dataset.part("fit"), model, bandwidth_Hz)
    return identify(dataclasses.replace(dataset, recordings=tuple(fitted)), rng=rng)


def _without(recording: Recording, view: View, model: CorrectedModel) -> Recording:
    plain = dataclasses.replace(model, effects={}, curve=None)
    added = (model.torque(view) - plain.torque(view)) - (model.drive(view) - plain.drive(view))
    measured = recording.channels
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


class _Namespace:
    """Attributes by name."""

    def __init__(self, **given: Any) -> None:
        self.__dict__.update(given)


class Signals:
    """Signals of one recording with the names of :class:`identification.views.view.View`, SI, at
    the joint except those of the motor; arrays of shape (n,).
    """

    def __init__(
        self,
        m: Any,
        time: Array,
        angle: Array,
        velocity: Array,
        acceleration: Array,
        contact_force: Any = 0.0,
        weight_mass: float = 0.0,
        current: Any = 0.0,
        voltage: Any = 0.0,
        supply: Any = None,
        known: Any = 0.0,
        known_inertia: float = 0.0,
        run_start: float = 0.0,
        number: int = 1,
    ) -> None:
        """Compute the signals.

        Args:
            m: Nominal parameters and bench constants.
            time: s, evenly spaced.
            angle: rad.
            velocity: rad/s; zero at rest.
            acceleration: rad/s^2.
            contact_force: F_P, N.
            weight_mass: Mass on the lever, or of the weight that turns with the joint, kg.
            current: Logged current, A.
            voltage: Logged voltage, V.
            supply: Supply voltage, V; without it the greatest voltage is used.
            known: Torque of a weight that turns with the joint, less its inertia torque, N m.
            known_inertia: Inertia of the weight that turns with the joint, kg m^2.
            run_start: Time from the start of the first recording to the start of this recording, s.
            number: Number of the recording, from 1.

        Raises:
            ValueError: The times are not evenly spaced.
        """
        steps = np.diff(time)
        if np.max(steps) > 1.5 * np.median(steps):
            raise ValueError(
                f"time: samples must be evenly spaced, but the longest step is {np.max(steps):g} s "
                f"and the median step {np.median(steps):g} s; interpolate all signals to an even "
                "grid first"
            )
        one = np.ones(len(time))
        moving = np.maximum.accumulate(np.where(velocity != 0.0, np.arange(len(time)), 0))
        self.time, self.run_time = time, run_start + time - time[0]
        self.step = float(time[-1] - time[0]) / (len(time) - 1)
        self.angle, self.velocity, self.acceleration = angle, velocity, acceleration
        self.sense, self.still = np.sign(velocity)[moving], velocity == 0.0
        self.rest_time = rest_times(time, velocity)
        self.moment, self.known = contact_force * m["L1"] * one, known * one
        self.hanging = (known + known_inertia * acceleration) * one
        self.loaded = bool(np.any(self.moment != 0.0))
        self.burdened = bool(np.any(self.known))
        self.current, self.voltage = current * one, voltage * one
        self.supply = None if supply is None else supply * one
        self.transmitted = m["ampere_torque"] * self.current
        self.torque = self.transmitted + self.known
        self.motor, self.drive_angle, self.lag = m["i"] * angle, angle, None
        self.motor_speed = m["i"] * velocity
        self.rotor_acceleration = np.gradient(velocity, self.step)
        self.index, self.voltage_is_computed = number - 1, False
        bench = _Namespace(
            resistance=m["R"],
            inductance=m["L"],
            back_emf_constant=m["Ke"],
            moment_arm=m["L1"],
            gear_ratio=m["i"],
            ampere_torque=m["ampere_torque"],
        )
        self.recording = _Namespace(
            bench=bench,
            pendulum=None,
            weight_mass=weight_mass,
            time=time,
            period=self.step,
            channels={"current": self.current},
            averaged=(),
        )

    def with_velocity(self, velocity: Array) -> Signals:
        """Return the signals with another velocity of the joint."""
        other = Signals.__new__(Signals)
        other.__dict__.update({**self.__dict__, "velocity": velocity})
        return other

    def __getitem__(self, name: str) -> Any:
        """Return a signal by its name."""
        return getattr(self, name)


def rest_times(time: Array, velocity: Array) -> Array:
    """Return the duration of rest at each sample, s, shape (n,): at rest the time since the rest
    began, in motion the duration of the last rest.
    """
    out = np.zeros(len(time))
    began = -1
    for k in range(1, len(time)):
        if velocity[k] == 0.0 and began < 0:
            began = k
        out[k] = time[k] - time[began] if began >= 0 else out[k - 1]
        if velocity[k] != 0.0:
            began = -1
    return out
