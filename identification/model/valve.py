"""Throat area and impacted area of the gate valve (Fig. 3) as functions of the valve angle.

A plate of width b with a hole of diameter d swings in its own plane on the radius L1 over an
opening of diameter D. The covered part of the opening is the impacted area A_s, the rest is the
throat area: A_s + A_t = pi D^2/4.

In the plate's frame, the opening's centre lies at a distance L1 sin(theta) from the plate's centre
line and 2 L1 sin(theta/2) from the hole's centre. Every area is then a sum of circular segments:
the plate's edges cut the opening, and the intersection of opening and hole is divided by the line
through their two intersection points (the radical line).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from identification.numerics.arrays import Array


@dataclass(frozen=True)
class ValveGeometry:
    """Dimensions of Fig. 3, m.

    Attributes:
        d: Diameter of the hole in the plate, the least throat.
        D: Diameter of the opening, the greatest throat.
        b: Width of the plate.
        L1: Radius on which the hole swings.
    """

    d: float = 0.025
    D: float = 0.040
    b: float = 0.054
    L1: float = 0.095

    def __post_init__(self) -> None:
        """Check the dimensions.

        Raises:
            ValueError: A dimension is not positive, or the hole does not fit into the plate.
        """
        small = [
            f"{name} = {value:g} m"
            for name, value in vars(self).items()
            if not 0.0 < value < math.inf
        ]
        if small:
            raise ValueError(
                f"{', '.join(small)}: dimensions of the valve must be positive and finite"
            )
        if self.d > self.b:
            raise ValueError(
                f"the hole, d = {self.d:g} m, is wider than its plate, b = {self.b:g} m; "
                "check whether d and b are exchanged"
            )

    @property
    def opening_area(self) -> float:
        """pi D^2/4, m^2, the sum of impacted area and throat at every angle."""
        return 0.25 * math.pi * self.D**2

    @property
    def clearing_angle(self) -> float:
        """Angle above which the plate covers no part of the opening, rad; infinite if the plate is
        so wide that it covers a part at every angle.
        """
        reach = 0.5 * (self.b + self.D) / self.L1
        return math.asin(reach) if reach <= 1.0 else math.inf


PAPER = ValveGeometry()
"""Dimensions that the paper gives."""


def throat_area(angle: Array, geometry: ValveGeometry = PAPER) -> Array:
    """Return the throat area A_t, m^2, an array of the shape of ``angle``.

    Args:
        angle: Valve angle theta_r, rad, of any shape; 0 where hole and opening are concentric,
            within +-pi/2.
        geometry: Dimensions.
    """
    angle = np.abs(angle)
    opening, hole, half = 0.5 * geometry.D, 0.5 * geometry.d, 0.5 * geometry.b
    beside = geometry.L1 * np.sin(angle)
    past_the_edges = _cap(opening, half - beside) + _cap(opening, half + beside)
    apart = np.maximum(2.0 * geometry.L1 * np.sin(0.5 * angle), 1e-12 * geometry.D)
    to_line = 0.5 * (apart + (opening**2 - hole**2) / apart)
    through_the_hole = _cap(opening, to_line) + _cap(hole, apart - to_line)
    return np.asarray(past_the_edges + through_the_hole)


def impacted_area(angle: Array, geometry: ValveGeometry = PAPER) -> Array:
    """Return the impacted area A_s, on which the pressure difference acts (eq. 10), m^2, an array
    of the shape of ``angle``.
    """
    return np.asarray(geometry.opening_area - throat_area(angle, geometry))


def _cap(radius: float, distance: Array) -> Array:
    """Return the area of a disc beyond a line at a signed distance from its centre; 0 or the whole
    disc if the line does not cut the disc.
    """
    x = np.clip(distance, -radius, radius)
    chord = np.sqrt(np.maximum(radius**2 - x**2, 0.0))
    return np.asarray(radius**2 * np.arctan2(chord, x) - x * chord)
