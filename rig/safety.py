"""The limits of a run and the check made on every sample before the next command goes out.

Pure functions and one latch. This is a stop function in software, not an emergency stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from rig.sample import Sample

RUNNING_MASK = 0x6F
RUNNING = 0x27
"""Statusword 6041h under mask 6Fh: operation enabled."""


class Check(Enum):
    """What a trip was about."""

    NOT_RESET = "not reset"
    SAMPLE_AGE = "sample age"
    DRIVE_STATE = "drive state"
    ANGLE = "joint angle"
    SPEED = "joint speed"
    CURRENT = "motor current"
    TORQUE = "joint torque"
    FOLLOWING_ERROR = "following error"
    DISAGREEMENT = "encoder against drive"
    TEMPERATURE = "motor temperature"


_REMEDY = {
    Check.NOT_RESET: "reset the latch with all inputs good",
    Check.SAMPLE_AGE: "check the bus cabling, termination and load, then run again",
    Check.DRIVE_STATE: "read the drive's error code (603Fh), remove its cause, then run again",
    Check.ANGLE: "reduce the amplitude or the centre, or check the encoder offset",
    Check.SPEED: "reduce amplitude or frequency, or check the drive gains for oscillation",
    Check.CURRENT: "look for jamming or a weight above the plan, then run again",
    Check.TORQUE: "look for jamming or a weight above the plan, then run again",
    Check.FOLLOWING_ERROR: "check the drive gains and that the joint moves freely",
    Check.DISAGREEMENT: "check the coupling, and sign, counts and offset of encoder and drive in the bench file",
    Check.TEMPERATURE: "let the motor cool, then run again",
}


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits in SI units at the joint, with the two constants that the checks need.

    ``torque_per_ampere`` is Km i, N m/A; ``gear_ratio`` is i.
    """

    angle_min: float
    angle_max: float
    speed: float
    torque: float
    current: float
    following_error: float
    encoder_disagreement: float
    temperature: float
    sample_age: float
    torque_per_ampere: float
    gear_ratio: float


@dataclass(frozen=True, slots=True)
class Trip:
    """A limit that was broken, by which sample.

    Attributes:
        check: Which check.
        value: What was found.
        limit: What was allowed: the bound that was crossed.
        unit: Of both.
        time: Of the sample, s since the start of the run.
    """

    check: Check
    value: float
    limit: float
    unit: str
    time: float

    @property
    def message(self) -> str:
        """Value, limit, unit, when and what to do."""
        if self.check is Check.DRIVE_STATE:
            found = f"statusword {int(self.value):04X}h is not OPERATION ENABLED"
        elif self.check is Check.NOT_RESET:
            found = "the safety latch has not been reset"
        else:
            found = (
                f"{self.check.value} {_show(self.value, self.unit)} is beyond its limit {_show(self.limit, self.unit)}"
            )
        return f"{found} at {self.time:.3f} s; {_REMEDY[self.check]}"


def check(sample: Sample, age: float, limits: Limits) -> Trip | None:
    """Compare one sample with the limits.

    Written as "inside", so that a value that is not a number trips.

    Args:
        sample: The sample just received.
        age: Time since the last fresh sample, s.
        limits: The limits of this run.

    Returns:
        The first limit broken, or None.
    """
    time = sample.time
    if not age <= limits.sample_age:
        return Trip(Check.SAMPLE_AGE, age, limits.sample_age, "s", time)
    if sample.statusword & RUNNING_MASK != RUNNING:
        return Trip(Check.DRIVE_STATE, sample.statusword, RUNNING, "1", time)
    angle = sample.angle
    if not limits.angle_min <= angle <= limits.angle_max:
        bound = limits.angle_min if angle < limits.angle_min else limits.angle_max
        return Trip(Check.ANGLE, angle, bound, "rad", time)
    if not abs(sample.velocity) <= limits.speed:
        return Trip(Check.SPEED, abs(sample.velocity), limits.speed, "rad/s", time)
    current = abs(sample.current)
    if not current <= limits.current:
        return Trip(Check.CURRENT, current, limits.current, "A", time)
    if not current * limits.torque_per_ampere <= limits.torque:
        return Trip(Check.TORQUE, current * limits.torque_per_ampere, limits.torque, "N m", time)
    if not abs(sample.following_error) <= limits.following_error:
        return Trip(Check.FOLLOWING_ERROR, abs(sample.following_error), limits.following_error, "rad", time)
    disagreement = abs(sample.motor_angle / limits.gear_ratio - angle)
    if not disagreement <= limits.encoder_disagreement:
        return Trip(Check.DISAGREEMENT, disagreement, limits.encoder_disagreement, "rad", time)
    if not sample.temperature <= limits.temperature:
        return Trip(Check.TEMPERATURE, sample.temperature, limits.temperature, "deg C", time)
    return None


class Latch:
    """Remembers the first trip. Starts tripped; only :meth:`reset` closes it."""

    def __init__(self) -> None:
        self._trip: Trip | None = Trip(Check.NOT_RESET, 0.0, 0.0, "1", 0.0)

    @property
    def trip(self) -> Trip | None:
        """The trip that holds the latch open, or None when it is closed."""
        return self._trip

    def reset(self, sample: Sample, age: float, limits: Limits) -> Trip | None:
        """Close the latch if the sample is inside every limit; else hold that trip.

        Returns:
            None when the latch is now closed.
        """
        self._trip = check(sample, age, limits)
        return self._trip

    def judge(self, sample: Sample, age: float, limits: Limits) -> Trip | None:
        """Check a sample. Once open, the latch stays open whatever the later samples say."""
        if self._trip is None:
            self._trip = check(sample, age, limits)
        return self._trip


def _show(value: float, unit: str) -> str:
    """Show angles in degrees as well, since the bench file states them so."""
    if unit in ("rad", "rad/s"):
        degrees = unit.replace("rad", "deg")
        return f"{value:.4g} {unit} ({math.degrees(value):.4g} {degrees})"
    return f"{value:.4g} {unit}"
