"""Record of one effect in the catalogue: equation, violated assumption, where the effect shows, and
the experiment that distinguishes the effect from similar effects.
"""

from __future__ import annotations

from dataclasses import dataclass

_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect, with its SI unit and its plausible range."""

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
        assumption: Assumption of the paper that the effect violates.
        shows_in: Equation in which the effect shows: ``torque``, ``transmission``, ``voltage``,
            ``breakaway`` or ``pressure``.
        coordinate: Coordinate over which the effect shows, a colon, and how the effect shows.
        parameters: Parameters with units and plausible ranges.
        look_alikes: Names of the most similar effects.
        experiment: Experiment that distinguishes the effect from these.
        sentence: Sentence that states the effect, with parameters in braces.
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
