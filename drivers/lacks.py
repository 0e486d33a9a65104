"""What a drive neither holds nor tells, so that only the host checks it, or nothing does."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Lacks:
    """What is missing in a drive.

    Attributes:
        limits: Fields of :class:`~drivers.interfaces.ServoLimits` that the drive does not hold.
        temperature: Whether it does not report its temperature.
        supply: Whether it does not report its supply voltage.
        words: All of it for the operator, one sentence each.
    """

    limits: frozenset[str] = frozenset()
    temperature: bool = False
    supply: bool = False
    words: tuple[str, ...] = ()


NOTHING = Lacks()
"""A drive that holds and tells everything."""
