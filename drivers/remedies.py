"""Base classes of device interfaces: checks of the identity of a device, and corrections of its
unit of speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

KNOWN_SPREAD: Final = 2.2
"""Greatest ratio between the unit of speed that is computed from a motion and a known unit, at
which the two count as equal. Known units differ by far more. The computed unit is inexact because
the drive rounds the speed to whole units.
"""
MEASURED_SPREAD: Final = 1.5
"""Greatest error factor of a unit of speed that is computed from a motion of some hundredths of a
radian, without rounding: on most simulated benches with stick-slip the factor was 0.74 to 1.42.
"""


class SpeedRemedies:
    """Corrections of a wrong unit of the reported speed of a drive."""

    def speed_remedy(self, factor: float) -> str:
        """Return a text on how to correct a reported speed of ``factor`` times the true speed."""
        return "correct the drive's unit of speed in the bench file"

    def nearest_speed_factor(self, factor: float, spread: float) -> float:
        """Return the factor of the nearest known unit of speed, if its ratio to the rough
        ``factor`` is within ``spread``; otherwise the rough factor.
        """
        return factor

    def speed_settings(self, factor: float) -> Sequence[tuple[str, str | float | None]]:
        """Return the keys in the drive's section of the bench file, and their values, that correct
        a speed reported as ``factor`` times the true speed; empty if no key corrects it.
        """
        return ()


class Recognised:
    """Evidence that a device is not the one that was assumed."""

    def identity_doubts(self) -> Iterator[str]:
        """Yield a text for each difference between the device and its description.

        Raises:
            LinkError: The device cannot be reached.
        """
        yield from ()
