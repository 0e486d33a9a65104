"""Base classes of device interfaces: identity, checks and remedies of a device."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

KNOWN_SPREAD: Final = 2.2
"""Ratio between the unit of speed that a motion shows and a known unit, up to which they count as
equal. Known units differ by far more; at low speed, rounding to whole units changes the measured
one.
"""
MEASURED_SPREAD: Final = 1.5
"""Ratio up to which a motion of some hundredths of a radian shows a unit of speed without rounding:
0.74 to 1.42 on most simulated benches with stick and slip.
"""


class SpeedRemedies:
    """Corrections of a wrong unit of the reported speed of a drive."""

    def speed_remedy(self, factor: float) -> str:
        """Return the correction, as text, for a reported speed of ``factor`` times the true
        speed.
        """
        return "correct the unit of its speed in the bench file"

    def nearest_speed_factor(self, factor: float, spread: float) -> float:
        """Return the factor of the known unit that is nearest to a rough factor, if the ratio of
        the two factors is within ``spread``; else the rough factor.
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
        """Yield each difference between the device and its description.

        Raises:
            LinkError: The device cannot be reached.
        """
        yield from ()
