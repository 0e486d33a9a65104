"""The corrected model: nominal parameters, identified effects, and an empirical curve of the
remaining mismatch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from identification.corrected.motor import DRIVE, VOLTAGE, nominal_voltage
from identification.corrected.torque import TORQUE, nominal_torque
from identification.corrected.transmission import TRANSMISSION
from identification.diagnosis.result import Curve
from identification.numerics.arrays import Array
from identification.recording import Recording

Signals = Mapping[str, object]
PARAMETERS = (
    "J",
    "Mc",
    "Ms",
    "omega_sf",
    "sigma_2",
    "mu_c",
    "mu_s",
    "omega_sL",
    "mu_2",
    "mu_gc",
    "mu_gs",
    "offset",
)
COORDINATES = {"angle": "angle", "speed": "velocity", "time": "time"}
"""Coordinates of an empirical curve, with the signal of each coordinate."""


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

    def numbers(self, recording: Recording) -> dict[str, float]:
        """Return the nominal parameters and the bench constants by the names that the model
        functions use; unknown values are 0.
        """
        bench = recording.bench
        known = {name: float(self.parameters.get(name, 0.0)) for name in PARAMETERS}
        constants = {
            "R": bench.resistance,
            "L": bench.inductance,
            "Ke": bench.back_emf_constant,
            "L1": bench.moment_arm,
            "i": bench.gear_ratio,
            "ampere_torque": recording.bench.ampere_torque,
        }
        given = {name: float(value or 0.0) for name, value in constants.items()}
        return {**known, **self._load(), "alpha": self.alpha, **given}

    def _load(self) -> dict[str, float]:
        """Return the identified load torque as a function of angle: coefficients of sin, cos, the
        angle and 1.
        """
        torque, zero = (
            self.effects.get("gravity_imbalance", {}).get(n, 0.0) for n in ("torque_Nm", "zero_rad")
        )
        slope, rest = (
            self.effects.get("return_spring", {}).get(n, 0.0)
            for n in ("stiffness_Nm_rad", "rest_rad")
        )
        return {
            "load_sine": torque * math.cos(zero),
            "load_cosine": -torque * math.sin(zero),
            "load_slope": slope,
            "load_constant": -slope * rest,
        }

    def torque(self, s: Signals, m: Mapping[str, float]) -> Array:
        """Return the torque that the motion requires, N m at the joint, shape (n,)."""
        total = nominal_torque(s, m) + self._added(TORQUE, s, m)
        return total + carried(self.curve, "torque", s)

    def drive(self, s: Signals, m: Mapping[str, float]) -> Array:
        """Return the torque that the logged current produces, N m at the joint, shape (n,)."""
        return np.asarray(s["drive"]) + self._added(DRIVE, s, m)

    def twist(self, s: Signals, m: Mapping[str, float]) -> Array:
        """Return motor_angle / i - angle up to a constant, rad, shape (n,)."""
        return self._added(TRANSMISSION, s, m) + carried(self.curve, "transmission", s)

    def voltage(self, s: Signals, m: Mapping[str, float]) -> Array:
        """Return the voltage that the logged current requires, V, shape (n,)."""
        return (
            nominal_voltage(s, m) + self._added(VOLTAGE, s, m) + carried(self.curve, "voltage", s)
        )

    def _added(self, table: Mapping[str, object], s: Signals, m: Mapping[str, float]) -> Array:
        total = np.zeros(len(np.asarray(s["time"])))
        for name, given in self.effects.items():
            function = table.get(name)
            if callable(function):
                total = total + function(s, m, **given)
        return total


def carried(curve: Curve | None, equation: str, s: Signals) -> Array:
    """Return the empirical curve at the signals, shape (n,); 0 if the curve belongs to another
    equation or is None.
    """
    n = len(np.asarray(s["time"]))
    if curve is None or curve.equation != equation or curve.coordinate not in COORDINATES:
        return np.zeros(n)
    along = np.asarray(s[COORDINATES[curve.coordinate]])
    value = np.interp(along, curve.grid, curve.value)
    return np.asarray(np.asarray(s["sense"]) * value if curve.against_motion else value)
