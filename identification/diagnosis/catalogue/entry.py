"""Record of one effect in the catalogue: equation, violated assumption, where it shows, and the
experiment that distinguishes it from similar effects.
"""

from __future__ import annotations

from dataclasses import dataclass

_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect: SI unit and plausible range."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Entry:
    """One row of the catalogue, in words.

    The computation of an effect is in :mod:`identification.diagnosis.terms`, for the gas generator
    in :mod:`identification.diagnosis.gas.terms`.

    Attributes:
        name: Stable name.
        group: motor, transmission, friction, device, sensing or gas generator.
        equation: Governing equation.
        assumption: Assumption of the paper that it violates.
        shows_in: Equation in which it shows: ``torque``, ``transmission``, ``voltage``,
            ``breakaway`` or ``pressure``.
        coordinate: Coordinate or regime where it shows.
        parameters: Parameters with units and plausible ranges.
        look_alikes: Names of the most similar effects.
        experiment: Experiment that distinguishes it from these.
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


def title(name: str) -> str:
    """Return a stable name as words, such as ``asymmetric Coulomb`` of ``asymmetric_coulomb``."""
    return " ".join(_PROPER.get(word, word) for word in name.split("_"))
