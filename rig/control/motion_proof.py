"""Compares the reports of a drive and of a joint encoder in a motion with each other and with the
bench file: units, signs, gear ratio, torque constant.

The functions depend only on their arguments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.interfaces import Servo
from rig.control.motion_factors import (
    HINT_COUNTS,
    SENSE,
    Motion,
    current_sense,
    early_factor,
    shaft_factor,
    speed_factor,
    torque_constant,
    turn_alike,
)
from rig.control.motion_words import (
    CONSTANT,
    NO_TORQUE,
    RATIO_TOLERANCE,
    SHAFT,
    SPEED,
    SPEED_BAND,
    TORQUE_BAND,
    WORK,
    Contradiction,
    wrong_sense,
    wrong_shaft,
    wrong_speed,
    wrong_torque,
)
from rig.wiring.devices import Nominal

INSTANT_SPREAD: Final = 15.0
"""Uncertainty, as a ratio, of the factor of the reported speed early in a motion, because a drive
may report the peak of a slip that lasts less than a cycle. A common unit whose factor is within
this ratio counts as the drive's unit.
"""
SURER_SPREAD: Final = 3.0
"""Uncertainty of this factor, as a ratio, for the whole of a short motion until standstill."""
ROUGH_COUNTS: Final = 30
"""Number of different motor positions up to which a factor counts as rough; with more positions,
the factors of simulated benches are right within a ratio of 2.2.
"""
LEAST_INSTANT: Final = 4.0
"""Least ratio of the reported speed of one sample to the speed by the change of the position at
which a wrong unit of the speed explains a trip.
"""
_BY_MOTION: Final = (SPEED, SHAFT, WORK)


@dataclass(frozen=True)
class Proof:
    """Result of the comparison of a motion.

    Attributes:
        found: Factor of each quantity, found over expected value, or NaN if the motion did not
            determine it.
        contradictions: The comparisons whose factor is outside its tolerance.
    """

    found: dict[str, float]
    contradictions: tuple[Contradiction, ...]

    @property
    def moved(self) -> bool:
        """Whether the joint moved far enough for the comparisons."""
        return not any(math.isnan(self.found[name]) for name in _BY_MOTION)

    @property
    def unproven(self) -> str:
        """Text for the operator on the quantities that a motion without load cannot determine;
        empty if the motion determined all quantities.
        """
        return NO_TORQUE if math.isnan(self.found[CONSTANT]) else ""

    @property
    def words(self) -> str:
        """All contradictions as text for the operator."""
        return "; ".join(item.words for item in self.contradictions)


def prove(
    motion: Motion, nominal: Nominal, servo: Servo, tolerance: float = RATIO_TOLERANCE
) -> Proof:
    """Make all comparisons that the motion permits.

    Args:
        motion: The samples.
        nominal: Constants of the bench file.
        servo: The drive, which names the remedy for its speed.
        tolerance: Relative difference of the encoders' travels that is allowed.
    """
    speed, shaft, sense = speed_factor(motion), shaft_factor(motion), current_sense(motion)
    constant, source = torque_constant(motion, nominal)
    found = {
        SPEED: speed,
        SHAFT: shaft,
        WORK: sense,
        CONSTANT: constant / nominal.torque_constant_N_m_A,
    }
    wrong = []
    if not _same(speed, SPEED_BAND):
        wrong.append(wrong_speed(speed, servo))
    if not (math.isnan(shaft) or abs(shaft - 1.0) <= tolerance):
        wrong.append(wrong_shaft(shaft, nominal))
    if sense < -SENSE:
        wrong.append(wrong_sense(sense))
    if not _same(constant / nominal.torque_constant_N_m_A, TORQUE_BAND):
        wrong.append(wrong_torque(constant, source, nominal))
    return Proof(found, tuple(wrong))


def hint(
    motion: Motion,
    nominal: Nominal,
    servo: Servo,
    too_fast: bool = False,
    too_strong: bool = False,
) -> Contradiction | None:
    """Return the explanation of a trip or a fault early in a motion, or None if the samples do not
    explain it.

    Because there may be few samples, only large contradictions count, and the encoders are compared
    only if their angles are proportional to each other.

    Args:
        motion: The samples up to the trip.
        nominal: Constants of the bench file.
        servo: The drive, whose driver states the remedy for a wrong unit of speed.
        too_fast: Whether the reported speed exceeded its limit.
        too_strong: Whether the torque, computed from current and torque constant, exceeded its
            limit.
    """
    if len(motion.time) < 2:
        return None
    shaft = math.nan
    if turn_alike(motion, nominal):
        shaft = nominal.gear_ratio
    elif len(np.unique(motion.motor)) >= HINT_COUNTS:
        shaft = early_factor(motion)
    if not (math.isnan(shaft) or abs(shaft - 1.0) <= 2.0 * RATIO_TOLERANCE):
        return wrong_shaft(shaft, nominal)
    speed, counts = speed_factor(motion, least=0.0), len(np.unique(motion.motor))
    if not _same(speed, SPEED_BAND) and counts >= HINT_COUNTS:
        if counts > ROUGH_COUNTS:
            return wrong_speed(speed, servo)
        # A reported speed above its limit is not too small, although the sum of a few samples may
        # give a factor below one.
        if speed > 1.0 or not too_fast:
            return _rough_speed(speed, servo)
    if too_strong:
        constant, source = torque_constant(motion, nominal)
        if not _same(constant / nominal.torque_constant_N_m_A, TORQUE_BAND):
            return wrong_torque(constant, source, nominal)
    return _instant_speed(motion, servo) if too_fast else None


def _instant_speed(motion: Motion, servo: Servo) -> Contradiction | None:
    """Return the contradiction if the speed of the last sample is far above the change of the
    position, else None.

    The factor is rough: the position may have changed by one count in one cycle, or not at all if
    the position was read before the speed.
    """
    last = slice(-HINT_COUNTS, None)
    steps = servo.limit_steps()
    count = 0.0 if steps is None else steps.angle_rad
    way, time = np.abs(np.diff(motion.motor[last])), np.diff(motion.time[last])
    fastest = float(np.max(np.maximum(way, count) / np.maximum(time, 1e-9)))
    if fastest <= 0.0:
        return None
    factor = abs(float(motion.velocity[-1])) / fastest
    if factor < LEAST_INSTANT:
        return None
    return _rough_speed(factor, servo)


def surer(found: Contradiction, motion: Motion, servo: Servo) -> Contradiction:
    """Return the contradiction of the speed that the whole motion shows, including the samples
    until the joint stood still; if the whole motion shows no such contradiction, return ``found``.
    """
    factor = speed_factor(motion, least=0.0)
    if math.isnan(factor) or _same(factor, SPEED_BAND) or (factor > 1.0) is not found.above:
        return found
    if len(np.unique(motion.motor)) <= ROUGH_COUNTS:
        return _rough_speed(factor, servo)
    between = _rough_speed(factor, servo, SURER_SPREAD)
    return between if between.open else wrong_speed(factor, servo)


def _rough_speed(factor: float, servo: Servo, spread: float = INSTANT_SPREAD) -> Contradiction:
    """Return the contradiction for a rough factor: the factor of a common unit and, if a power of
    ten is nearer to the rough factor, this power of ten as well.
    """
    common = servo.nearest_speed_factor(factor, spread)
    decimal = servo.nearest_speed_factor(factor, 1.0)
    nearer = min(common, decimal) > 0.0 and _apart(decimal, factor) < _apart(common, factor)
    return wrong_speed(common, servo, rough=True, other=decimal if nearer else None)


def _apart(first: float, second: float) -> float:
    return abs(math.log(first / second))


def _same(factor: float, band: tuple[float, float]) -> bool:
    return math.isnan(factor) or band[0] <= factor <= band[1]
