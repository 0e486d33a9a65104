"""Lists the nominal constants of the gas generator with their tolerances.

All constants are fitted together with the effects, each with a prior whose standard deviation is
its tolerance; otherwise a throat that is 0.02 mm wider than in the drawing would count as missing
physics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from identification.model.gas_generator import GasGenerator


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
