"""Defines the record of the limits that a drive does not enforce and of the values that it does not
report.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Lacks:
    """Limits and values that a drive lacks.

    Attributes:
        limits: Fields of :class:`~drivers.interfaces.ServoLimits` that the drive does not enforce.
        temperature: Whether the drive does not report its temperature.
        supply: Whether the drive does not report its supply voltage.
        words: Text for the operator, one sentence for each limit or value.
    """

    limits: frozenset[str] = frozenset()
    temperature: bool = False
    supply: bool = False
    words: tuple[str, ...] = ()


NOTHING = Lacks()
"""Record of a drive that enforces all limits and reports all values."""
