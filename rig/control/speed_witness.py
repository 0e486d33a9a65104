"""Holds the speed that a drive reports against the change of the position that it reports.

Units of speed differ between drives (counts per second, rpm), and a limit on a speed in a wrong
unit limits nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from drivers.errors import ConfigurationError
from drivers.interfaces import Servo
from rig.common.sample import Sample

STEP_RAD: Final = 0.01
"""Joint travel of one comparison, rad; several counts of any motor encoder behind a gear."""
STEPS: Final = 3
"""Comparisons after which it is decided."""
LONGEST_S: Final = 1.0
"""A travel that takes longer is not compared, as an offset of the speed would be added up."""
BAND: Final = (0.25, 4.0)
"""Ratio of reported to true speed that is taken for the same unit. Filters, and samples that miss
the short peaks of stick and slip, change it by less (0.7 in the slow ramp), units by more: rpm and
degrees per second differ by 6.
"""


@dataclass
class _Travel:
    """A travel that is compared: since when, s, from which angle, rad, to which time, and the
    travel that the reported speed adds up to, rad.
    """

    begun_s: float
    angle: float
    last_s: float
    reported: float = 0.0


class SpeedWitness:
    """Compares until it is decided.

    Args:
        servo: The drive, which names the remedy.
        gear_ratio: Motor turns per joint turn.
    """

    def __init__(self, servo: Servo, gear_ratio: float) -> None:
        self._servo = servo
        self._gear_ratio = gear_ratio
        self._travel: _Travel | None = None
        self._products = self._squares = 0.0
        self._left = STEPS

    def decided(self, sample: Sample) -> bool:
        """Take a sample; returns True once the speed is known to be in the unit of the bench file.

        Raises:
            ConfigurationError: It is not.
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
        if not BAND[0] <= factor <= BAND[1]:
            raise ConfigurationError(
                f"the speed that the drive reports is {factor:.4g} times the change of its "
                f"position, must be {BAND[0]:g} to {BAND[1]:g} times: "
                f"{self._servo.speed_remedy(factor)}"
            )
        return True
