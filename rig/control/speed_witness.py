"""Compares the speed that a drive reports with the change of its position: finds wrong units.

Units of speed differ between drives (counts per second, rpm). With a wrong unit, the limit on the
speed has no effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from drivers.errors import ConfigurationError
from drivers.interfaces import Servo
from rig.common.sample import Sample
from rig.control.motion_words import SPEED_BAND

STEP_RAD: Final = 0.01
"""Joint travel of one comparison, rad; several counts of a motor encoder before a gear."""
STEPS: Final = 3
"""Number of comparisons for a decision."""
LONGEST_S: Final = 1.0
"""Longest time of a travel, s; a slower travel is not compared, because an offset of the speed
would dominate the sum of the speeds.
"""


@dataclass
class _Travel:
    """A travel for one comparison: start time, s; start angle, rad; time of the last sample, s; and
    the integral of the reported speed, rad.
    """

    begun_s: float
    angle: float
    last_s: float
    reported: float = 0.0


class SpeedWitness:
    """Compares speed and position until the unit of the speed is known.

    Args:
        servo: The drive, whose method returns the remedy.
        gear_ratio: Motor turns per joint turn.
    """

    def __init__(self, servo: Servo, gear_ratio: float) -> None:
        self._servo = servo
        self._gear_ratio = gear_ratio
        self._travel: _Travel | None = None
        self._products = self._squares = 0.0
        self._left = STEPS

    def decided(self, sample: Sample) -> bool:
        """Process a sample; return True if the speed is known to have the unit of the bench file.

        Raises:
            ConfigurationError: The speed has another unit.
        """
        angle = sample.motor_angle / self._gear_ratio
        travel = self._travel
        if not sample.fresh or travel is None or sample.time - travel.begun_s > LONGEST_S:
            self._travel = _Travel(sample.time, angle, sample.time)
            return False
        travel.reported += sample.velocity * (sample.time - travel.last_s)
        travel.last_s = sample.time
        moved = angle - travel.angle
        if abs(moved) < STEP_RAD:
            return False
        self._products += moved * travel.reported
        self._squares += moved * moved
        self._travel = _Travel(sample.time, angle, sample.time)
        self._left -= 1
        if self._left:
            return False
        factor = self._products / self._squares
        if not SPEED_BAND[0] <= factor <= SPEED_BAND[1]:
            raise ConfigurationError(
                f"the speed that the drive reports is {factor:.4g} times the change of its "
                f"position; it must be {SPEED_BAND[0]:g} to {SPEED_BAND[1]:g} times: "
                f"{self._servo.speed_remedy(factor)}"
            )
        return True
