"""Preprocesses gas-generator recordings for the diagnosis: averages the pressure, and computes the
throat area from the valve angle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.model.gas_generator import (
    GasGenerator,
    ValveGeometry,
    throat_area,
    throat_derivatives,
)
from identification.recording import Array, Recording, RecordingError

# Lists the nominal constants of the gas generator with their tolerances.
#
# All constants are fitted together with the effects, each with a prior whose standard deviation is
# its tolerance; otherwise a throat that is 0.02 mm wider than in the drawing would count as
# missing physics.


@dataclass(frozen=True)
class Constant:
    """A constant that has one value in all recordings.

    Attributes:
        unit: Unit, SI.
        tolerance: Standard deviation of the prior: a share of the value if ``relative``, else in
            the unit.
        relative: Whether the logarithm of the constant is fitted.
    """

    unit: str
    tolerance: float
    relative: bool = False

    def moved(self, value: float, steps: float) -> float:
        """Return a value that is ``steps`` tolerances from the nominal value."""
        return (
            value * math.exp(self.tolerance * steps)
            if self.relative
            else value + self.tolerance * steps
        )

    def steps(self, nominal: float, value: float) -> float:
        """Return the deviation of a value from the nominal value, in tolerances; the inverse of
        :meth:`moved`.
        """
        return (math.log(value / nominal) if self.relative else value - nominal) / self.tolerance


CONSTANTS: Mapping[str, Constant] = {
    "a": Constant("m/s", 0.1, relative=True),  # at 1 MPa; scatter between propellant lots
    "n": Constant("1", 0.03),  # uncertainty of a strand burner measurement
    "C_r": Constant("m/s", 0.05, relative=True),
    "d": Constant("m", 2.5e-5),
    "D": Constant("m", 2.5e-5),
    "b": Constant("m", 2.5e-5),
    "angle_zero": Constant("rad", math.radians(0.05)),  # true less measured angle
    "pressure_zero": Constant(
        "Pa", 3e3
    ),  # measured less true pressure, of a transducer tared before ignition
    "delay": Constant("s", 1e-3),  # delay of the pressure relative to the angle
}
"""Constants by name, in the order in which they are fitted."""
PROPELLANT = ("a", "n", "C_r")
"""Constants that neither a drawing nor a calibration states."""
VOLUME = Constant("m^3", 0.3, relative=True)
"""Free volume of the chamber at the first row of each recording, without igniter and grain."""
PRESSURE = Constant("Pa", 0.01, relative=True)
"""Pressure at the first row of each recording; the tolerance is a scale for the fit, not a
prior.
"""


_SENSORS = ("angle_zero", "pressure_zero", "delay")


def nominal_constants(g: GasGenerator) -> dict[str, float]:
    """Return the nominal constants of a gas generator and its sensors, by the names of
    :data:`CONSTANTS`.
    """
    return {
        **{name: getattr(g, name) for name in PROPELLANT},
        "d": g.valve.d,
        "D": g.valve.D,
        "b": g.valve.b,
        **dict.fromkeys(_SENSORS, 0.0),
    }


ROW_S = 0.005
"""Duration over which samples are averaged to one row, s; the time constant of the chamber's
outflow is ten times as long.
"""
LEAST_ROWS = 50
_FIRST_ROWS = 4
_TURN, _SIZE = math.radians(0.05), 2.5e-5
"""Steps of numerical derivatives, rad and m, which are about the tolerances of encoder and
valve.
"""
_SPREAD_PER_MAD = 1.4826
_THIRD_DIFFERENCE = math.sqrt(20.0)
"""Standard deviation of the third differences of white noise of unit variance."""


@dataclass(frozen=True)
class Burn:
    """One recording of a burning gas generator as rows; throat and pressure are means over the same
    samples.

    Attributes:
        recording: The recording.
        index: Index among the recordings under diagnosis.
        time: Time since the first sample of the recording, s, shape (n,).
        areas: A_t and its derivatives with respect to the thickness of a deposit, shape (3, n).
        shifts: Derivatives of A_t by angle, d, D and b, shape (4, n).
        angle: rad, shape (n,).
        pressure: Pa, shape (n,).
    """

    recording: Recording
    index: int
    time: Array
    areas: Array
    shifts: Array
    angle: Array
    pressure: Array

    @property
    def first_pressure(self) -> float:
        """Mean pressure of the first rows, Pa, which is the start value of a fit."""
        return float(np.mean(self.pressure[:_FIRST_ROWS]))

    @property
    def opening_rate(self) -> Array:
        """dA_t/dt, m^2/s, shape (n,)."""
        return np.asarray(np.gradient(self.areas[0], self.time))


def has_gas_channels(recording: Recording) -> bool:
    """Whether a recording allows a diagnosis of the gas generator, that is, has constants of a gas
    generator, a pressure and a valve angle.
    """
    return (
        recording.bench.gas_generator is not None
        and {"pressure", "angle"} <= recording.channels.keys()
    )


def burns(recordings: Sequence[Recording]) -> tuple[Burn, ...]:
    """Return recordings as rows.

    Raises:
        RecordingError: A recording has no pressure or no angle, is too short, or has a pressure of
            zero.
    """
    return tuple(_burn(recording, index) for index, recording in enumerate(recordings))


def generator(burn: Burn) -> GasGenerator:
    """Return the nominal constants of a recording's gas generator."""
    found = burn.recording.bench.gas_generator
    assert found is not None
    return found


def noise(burns: Sequence[Burn]) -> float:
    """Return the scatter of the pressure from row to row, Pa, from the median third difference; at
    least the quantisation error.

    Raises:
        RecordingError: The pressure does not change at all.
    """
    differences = np.concatenate([np.diff(b.pressure, n=3) for b in burns])
    scatter = _SPREAD_PER_MAD * float(np.median(np.abs(differences))) / _THIRD_DIFFERENCE
    steps = np.diff(np.unique(np.concatenate([b.pressure for b in burns])))
    if not steps.size:
        raise RecordingError(
            f"{burns[0].recording.name}: the pressure channel is constant; check whether the "
            "pressure transducer was logged"
        )
    return max(scatter, float(np.min(steps)) / math.sqrt(12.0))


def _burn(recording: Recording, index: int) -> Burn:
    missing = {"pressure", "angle"} - recording.channels.keys()
    g = recording.bench.gas_generator
    if missing or g is None:
        what = " and ".join(sorted(missing)) or "bench.gas_generator"
        raise RecordingError(
            f"{recording.name}: the recording has no {what}, but a gas generator is diagnosed from "
            "pressure and valve angle"
        )
    per_row = max(1, round(ROW_S / recording.period))
    count = len(recording.time) // per_row
    if count < LEAST_ROWS:
        raise RecordingError(
            f"{recording.name}: the {len(recording.time)} samples give {count} averages over "
            f"{ROW_S * 1e3:g} ms; at least {LEAST_ROWS} averages are needed"
        )

    def mean(values: Array) -> Array:
        return np.asarray(
            values[..., : count * per_row].reshape(*values.shape[:-1], count, per_row).mean(axis=-1)
        )

    time, angle, pressure = (
        mean(recording.channels[name]) for name in ("time", "angle", "pressure")
    )
    lowest = float(np.min(pressure))
    if not lowest > 0.0:
        raise RecordingError(
            f"{recording.name}: the pressure falls to {lowest:g} Pa; the channel must be the "
            "absolute pressure in Pa, only while the gas generator burns"
        )
    measured = recording.channels["angle"]
    areas, shifts = (
        mean(throat_derivatives(measured, g.valve)),
        mean(throat_shifts(measured, g.valve)),
    )
    return Burn(recording, index, time - float(recording.time[0]), areas, shifts, angle, pressure)


def throat_shifts(angle: Array, valve: ValveGeometry) -> Array:
    """Return the derivatives of A_t with respect to angle (m^2/rad), d, D and b (m), by central
    differences, shape (4, n).
    """
    by_angle = throat_area(angle + _TURN, valve) - throat_area(angle - _TURN, valve)
    by_size = [
        throat_area(angle, replace(valve, **{name: value + _SIZE}))
        - throat_area(angle, replace(valve, **{name: value - _SIZE}))
        for name, value in (("d", valve.d), ("D", valve.D), ("b", valve.b))
    ]
    return np.stack([by_angle / (2.0 * _TURN), *(change / (2.0 * _SIZE) for change in by_size)])
