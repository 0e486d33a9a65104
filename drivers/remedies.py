"""What a device says of itself and of its remedies, beside its work; bases of the interfaces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

KNOWN_SPREAD: Final = 2.2
"""Ratio up to which a unit of speed that a motion shows is one of those with a name; these differ
by far more, and at low speed rounding to whole units changes a measured one.
"""
MEASURED_SPREAD: Final = 1.5
"""Ratio up to which a motion of some hundredths of a radian shows a unit of speed without rounding:
0.74 to 1.42 on most simulated benches with stick and slip.
"""


class SpeedRemedies:
    """What corrects the speed of a drive."""

    def speed_remedy(self, factor: float) -> str:
        """Return what to change where the reported speed is ``factor`` times the true one."""
        return "correct the unit of its speed in the bench file"

    def nearest_speed_factor(self, factor: float, spread: float) -> float:
        """Return the factor that a speed in another known unit would be reported with, the nearest
        to a rough one that is right up to ``spread``, a ratio; that one where there is none.
        """
        return factor

    def speed_settings(self, factor: float) -> Sequence[tuple[str, str | float | None]]:
        """Return the keys of the bench file's drive, and their values, that correct a speed which
        is reported as ``factor`` times the true one; none where no key does.
        """
        return ()


class Recognised:
    """What shows that a device is another one than it is taken for."""

    def identity_doubts(self) -> Iterator[str]:
        """Yield in which way the device is another one than its description says.

        Raises:
            LinkError: The device cannot be reached.
        """
        yield from ()
