"""Checks every sample against the limits before the next command; a latch stores the first
violation.

Except for the latch, the module has no state. The check is a stop function in software, not an
emergency stop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Any

from rig.common.sample import Sample
from rig.planning.limits import GasLimits, Limits
from rig.planning.predicted_load import LESS_ANYWHERE
from rig.wiring.runaway import SIGNS

RUNNING_MASK = 0x6F
RUNNING = 0x27  # statusword 6041h under mask 6Fh: operation enabled


class Check(Enum):
    """The quantity that violated its limit."""

    NOT_RESET = "not reset"
    SAMPLE_AGE = "sample age"
    PAUSE = "sample age after a pause of this computer"
    DRIVE_STATE = "drive state"
    ANGLE = "joint angle"
    SPEED = "joint speed"
    RUNAWAY = "speed of a joint that runs away from its target"
    CURRENT = "motor current"
    TORQUE = "joint torque"
    FOLLOWING_ERROR = "following error"
    DISAGREEMENT = "encoder against drive"
    TEMPERATURE = "motor temperature"
    SUPPLY = "DC link voltage"
    PRESSURE = "chamber pressure"
    CONTACT_FORCE = "contact force"
    LATENESS = "lateness of the control cycle"
    SLEEP = "sleep of the computer"
    STAGE_TIME = "time under power in this stage"


_REMEDY = {
    Check.NOT_RESET: "confirm the weight at the prompt",
    Check.SAMPLE_AGE: "check the bus cabling, termination and load, then run again",
    Check.PAUSE: "close other programs on this computer, then run again",
    Check.DRIVE_STATE: "read the drive's error code (603Fh), remove its cause, then run again",
    Check.ANGLE: "reduce the amplitude or the centre, or check the encoder offset",
    Check.SPEED: "reduce amplitude or frequency, or check the drive gains for oscillation",
    Check.RUNAWAY: f"the power was cut without a ramp: {SIGNS}",
    Check.CURRENT: "look for jamming or a weight above the plan, then run again",
    Check.TORQUE: "look for jamming or a weight above the plan, then run again",
    Check.FOLLOWING_ERROR: "check the drive gains and that the joint moves freely",
    Check.DISAGREEMENT: "check the coupling, and sign, counts and offset of encoder and drive in "
    "the bench file; if the supply of a homed drive was off after the homing, home it again",
    Check.TEMPERATURE: "let the motor cool, then run again",
    Check.SUPPLY: "check the supply and, where the drive feeds back, its brake resistor, then run "
    "again",
    Check.PRESSURE: "look for a clogged throat or a valve that closed too far, and let the "
    "generator burn out",
    Check.CONTACT_FORCE: "look at the pressure, or open the valve further, and let the generator "
    "burn out",
    Check.LATENESS: "close other programs on this computer, or lower cycle_Hz, then run again",
    Check.SLEEP: "nothing watches the drive meanwhile: switch the sleep of this computer off (lid, "
    "idle time, battery), then run again",
    Check.STAGE_TIME: "find the cause of the delay, or raise time_limit_s of the stage",
}

AGAINST = f"the joint moves against the command: {SIGNS}"
"""Remedy of a trip that a drive of the wrong sign has caused."""
MOVED = frozenset({Check.ANGLE, Check.SPEED, Check.CURRENT, Check.TORQUE, Check.FOLLOWING_ERROR})
"""Trips by the motion of the joint."""
AGAIN = ", then run again"
"""End of a remedy after which the run can be repeated without other changes."""


def remedy(check: Check, trip: Mapping[str, Any] = MappingProxyType({})) -> str:
    """Return the remedy of a trip, which the operator must apply before the next motion."""
    if trip.get("against"):
        return AGAINST
    if foreseen(trip):
        return (
            f"the plan predicts a peak of {trip['predicted']:.4g} {trip['unit']}, which is above "
            f"this limit: {LESS_ANYWHERE}"
        )
    return _REMEDY[check].removesuffix(AGAIN)


def foreseen(trip: Mapping[str, Any]) -> bool:
    """Return whether the predicted peak is above the limit that tripped, which may be negative."""
    return bool((trip.get("predicted") or 0.0) > abs(trip.get("limit", math.inf)))


@dataclass(frozen=True, slots=True)
class Trip:
    """A limit that was exceeded, with the sample that exceeded it."""

    check: Check
    value: float
    limit: float
    unit: str
    time: float
    against: bool = False

    @property
    def message(self) -> str:
        """Message with value, limit, unit, time and remedy."""
        return f"{self.event}; {AGAINST if self.against else _REMEDY[self.check]}"

    @property
    def event(self) -> str:
        """Message with value, limit, unit and time; the advice after a run has the remedy."""
        return f"{self.found} at {self.time:.3f} s"

    @property
    def now(self) -> str:
        """Message with value, limit and unit, for a value read outside a run."""
        return f"{self.found}; {_REMEDY[self.check]}"

    @property
    def found(self) -> str:
        """Value, limit and unit, without a remedy."""
        if self.check is Check.DRIVE_STATE:
            return f"statusword {int(self.value):04X}h is not OPERATION ENABLED"
        if self.check is Check.SLEEP:
            return f"the computer slept for {self.value:.1f} s"
        if self.check is Check.NOT_RESET:
            return "the safety latch is open: its reset was not requested"
        return (
            f"{self.check.value} {_show(self.value, self.unit)} is beyond its limit "
            f"{_show(self.limit, self.unit)}"
        )


def check(sample: Sample, age: float, late: float, limits: Limits) -> Trip | None:
    """Return the first limit that one sample violates, or None.

    Each condition is written as "inside the limit", so that NaN counts as outside.

    Args:
        sample: The new sample.
        age: Time since the last complete sample, s.
        late: Delay of the start of the cycle, s.
        limits: The limits of this run.
    """
    time = sample.time
    if not late <= limits.lateness:
        return Trip(Check.LATENESS, late, limits.lateness, "s", time)
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
        return Trip(
            Check.FOLLOWING_ERROR, abs(sample.following_error), limits.following_error, "rad", time
        )
    disagreement = abs(sample.motor_angle / limits.gear_ratio - angle)
    if not disagreement <= limits.encoder_disagreement:
        return Trip(Check.DISAGREEMENT, disagreement, limits.encoder_disagreement, "rad", time)
    watched = limits.reports_temperature and limits.temperature != math.inf
    if watched and not sample.temperature <= limits.temperature:
        return Trip(Check.TEMPERATURE, sample.temperature, limits.temperature, "deg C", time)
    supply = sample.supply_voltage
    watched = limits.reports_supply and limits.supply_min != -math.inf
    if watched and not limits.supply_min <= supply <= limits.supply_max:
        bound = limits.supply_min if supply < limits.supply_min else limits.supply_max
        return Trip(Check.SUPPLY, supply, bound, "V", time)
    return None if limits.gas is None else _check_gas(sample, limits.gas)


def _check_gas(sample: Sample, limits: GasLimits) -> Trip | None:
    pressure = sample.pressure
    if not pressure <= limits.pressure:
        return Trip(Check.PRESSURE, pressure, limits.pressure, "Pa", sample.time)
    force = (pressure - limits.back_pressure) * limits.area(sample.angle)
    if not force <= limits.contact_force:
        return Trip(Check.CONTACT_FORCE, force, limits.contact_force, "N", sample.time)
    return None


def check_stage_time(elapsed: float, limit: float, time: float) -> Trip | None:
    """Compare the time with power on in a stage, s, with the limit on this time, s."""
    if not elapsed <= limit:
        return Trip(Check.STAGE_TIME, elapsed, limit, "s", time)
    return None


class Latch:
    """Keeps the first trip. At the start the latch is open (tripped).

    To close the latch, a request of the operator (:meth:`ask`) and a sample inside every limit
    (:meth:`reset`) are necessary. A request is valid for one reset. Request and reset cause no
    motion.
    """

    def __init__(self) -> None:
        self._trip: Trip | None = _NOT_RESET
        self._asked = False

    @property
    def trip(self) -> Trip | None:
        """The trip that keeps the latch open, or None if the latch is closed."""
        return self._trip

    def open(self) -> None:
        """Open the latch at the regular end of a stage, and cancel a reset request."""
        self._trip = _NOT_RESET
        self._asked = False

    def ask(self) -> None:
        """Store the operator's request for the next reset."""
        self._asked = True

    def reset(self, sample: Sample, age: float, late: float, limits: Limits) -> Trip | None:
        """Close the latch if this was requested and the sample is inside every limit."""
        if self._asked:
            self._trip = check(sample, age, late, limits)
            self._asked = False
        elif self._trip is None:
            self._trip = _NOT_RESET
        return self._trip

    def judge(self, sample: Sample, age: float, late: float, limits: Limits) -> Trip | None:
        """Check a sample. An open latch stays open for all later samples."""
        if self._trip is None:
            self._trip = check(sample, age, late, limits)
        return self._trip


_NOT_RESET = Trip(Check.NOT_RESET, 0.0, 0.0, "1", 0.0)


def _show(value: float, unit: str) -> str:
    """Return a value as text, angles in degrees as well, because the bench file states degrees."""
    if unit in ("rad", "rad/s"):
        degrees = unit.replace("rad", "deg")
        return f"{value:.4g} {unit} ({math.degrees(value):.4g} {degrees})"
    return f"{value:.4g} {unit}"
