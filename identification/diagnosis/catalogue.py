"""The catalogue as one table: what an effect is, what it breaks, how it shows and what separates it from its likes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect: SI unit and plausible range."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Entry:
    """One row of the catalogue, in words; how it is computed stands in :mod:`identification.diagnosis.terms`.

    Attributes:
        name: Stable name.
        group: motor, transmission, friction, device or sensing.
        equation: Governing equation.
        assumption: What of the paper it breaks.
        shows_in: Equation in which it shows: ``torque``, ``transmission``, ``voltage`` or ``breakaway``.
        coordinate: Coordinate or regime where it shows.
        parameters: With units and plausible ranges.
        look_alikes: Names of the nearest ones.
        experiment: What separates it from them.
        sentence: The finding, with parameters in braces.
    """

    name: str
    group: str
    equation: str
    assumption: str
    shows_in: str
    coordinate: str
    parameters: tuple[Quantity, ...]
    look_alikes: tuple[str, ...]
    experiment: str
    sentence: str
