"""Ratios between the reports of a drive and of a joint encoder in a motion: of speed, travel, work
and torque constant.

The functions depend only on the samples. Where possible, the work along the path is compared,
because noise averages out in the work, and the work of the inertia cancels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from rig.config.sequence import Array
from rig.wiring.devices import Nominal

BLOCK_S: Final = 0.02
"""Time over which samples are averaged, s; a block has at least two samples. The speed of a first
pass hardly changes within one block.
"""
LEAST_RAD: Final = 0.004
"""Least travel in one direction that is evaluated, rad at the joint."""
HINT_COUNTS: Final = 4
"""Least number of different positions of an encoder that an explanation of a trip requires."""
SENSE: Final = 0.3
"""Relative work of the current. Below the negative of this value, the sign of the current counts as
wrong, because the motor must do work against friction in both directions; if the magnitude is
smaller than this value, no torque constant is computed from the torque.
"""
_JUMP_SHARE: Final = 0.7
"""Share of a travel that must occur within one sample for the travel to count as a jump."""
_COLLINEAR: Final = 1e-9
_MOVING_SHARE: Final = 0.1
_SETTLED_SHARE: Final = 0.4
"""Share at the start of a travel that is not evaluated, because the motor first crosses the play
and twists the gear.
"""
_SAME_EMF: Final = 0.15
"""Greatest magnitude of the logarithm of the ratio of measured to stated back-EMF constant at which
the stated constant is confirmed.
"""
_LEAST_EMF: Final = 0.55
"""Least ratio of back-EMF constant to torque constant. The ratio is 1 / sqrt(3) if one constant is
stated between lines and the other per phase; the limit is slightly smaller.
"""
_EMF_CERTAINTY: Final = 0.08
_EMF_INFLATION: Final = 3.0
"""Factor by which the standard error is increased, because neighbouring blocks are correlated."""


@dataclass(frozen=True)
class Motion:
    """Fresh samples under power, SI units, arrays of shape (n,); motor values at the joint.

    Attributes:
        time: Time of the samples.
        motor: Angle of the motor encoder over the gear ratio.
        joint: Angle of the joint encoder.
        velocity: Joint speed as the drive reports it.
        current: Motor current.
        voltage: Motor voltage, NaN if the drive reports none.
        torque: Motor torque, NaN if the drive reports none beside the current.
    """

    time: Array
    motor: Array
    joint: Array
    velocity: Array
    current: Array
    voltage: Array
    torque: Array

    @classmethod
    def of(cls, rows: Array) -> Motion:
        """Return the motion of an array of shape (n, 7), whose columns are the attributes in order;
        rows in which time, an angle, speed or current is not finite are left out.
        """
        return cls(*rows[np.isfinite(rows[:, :5]).all(axis=1)].T)


def speed_factor(motion: Motion, least: float = LEAST_RAD) -> float:
    """Return the ratio of the reported speed to the change of the position, or NaN if the travel is
    too short.
    """
    if len(motion.time) < 2:
        return math.nan
    size = _block(motion)
    # A trip occurs in the last block, which is not complete.
    edges = np.append(np.arange(0, len(motion.time) - 1, size), len(motion.time) - 1)
    moved = np.diff(motion.motor[edges])
    mean = motion.velocity[1:] * np.diff(motion.time)
    reported = np.diff(np.concatenate(([0.0], np.cumsum(mean)))[edges])
    if len(moved) == 0 or np.sum(np.abs(moved)) < max(least, 1e-9):
        return math.nan
    return float(np.sum(moved * reported) / np.sum(moved * moved))


def shaft_factor(motion: Motion) -> float:
    """Return the ratio of the joint encoder's travel to the motor encoder's travel, or NaN if the
    travel is too short.

    The ratio is found by least squares over all travels in one direction, with an offset for each
    travel that represents play and twist, and with a term in the speed that represents the time
    between the two readings.
    """
    parts = []
    size = _block(motion)
    for begin, end in ((a * size, b * size) for a, b in travels(motion.motor[::size])):
        inside = slice(begin + round(_SETTLED_SHARE * (end - begin)), end + 1)
        m, j, v = motion.motor[inside], motion.joint[inside], motion.velocity[inside]
        if len(m) < 4 or max(abs(m[-1] - m[0]), abs(j[-1] - j[0])) < 0.5 * LEAST_RAD:
            continue
        parts.append(np.column_stack([x - x.mean() for x in (m, v, j)]))
    if not parts:
        return math.nan
    table = np.concatenate(parts)
    return _slope(table[:, 0], table[:, 1], table[:, 2])[0]


def _slope(first: Array, second: Array, values: Array) -> tuple[float, float]:
    """Return the coefficients of two regressors by least squares.

    The normal equations are solved, because this is fast enough between two control cycles. The
    second coefficient is zero if the second regressor is zero or proportional to the first
    regressor.
    """
    a, b, c = float(first @ first), float(first @ second), float(second @ second)
    p, q = float(first @ values), float(second @ values)
    determinant = a * c - b * b
    if determinant <= _COLLINEAR * a * c:
        return (p / a if a > 0.0 else math.nan), 0.0
    return (c * p - b * q) / determinant, (a * q - b * p) / determinant


def early_factor(motion: Motion) -> float:
    """Return the ratio of the joint encoder's travel to the motor encoder's travel from the few
    samples before a trip, or NaN if the samples do not agree with one ratio.

    A joint encoder with few different positions is not compared, because its step may be longer
    than the travel so far. If all positions of the joint encoder are equal, the travel must be
    longer than the encoder step, play and twist together.
    """
    shown = len(np.unique(motion.joint))
    if shown < HINT_COUNTS and (shown > 1 or float(np.ptp(motion.motor)) < LEAST_RAD):
        return math.nan
    # Samples at rest agree with every ratio and are left out.
    moved = (motion.motor != motion.motor[0]) | (motion.joint != motion.joint[0])
    begin = max(0, int(np.argmax(moved)) - 1)
    m, j = (x[begin:] - x[0] for x in (motion.motor, motion.joint))
    v = motion.velocity[begin:]
    slope, delay = _slope(m, v, j)
    rest, span = j - slope * m - delay * v, float(np.max(np.abs(j - m)))
    if span <= 0.0 or float(np.sqrt(np.mean(rest**2))) > 0.1 * span:
        return math.nan
    return slope


def turn_alike(motion: Motion, nominal: Nominal) -> bool:
    """Return whether motor and joint encoder may turn 1:1, within one count of the motor encoder.

    A jump of the position within one sample does not count as a turn.
    """
    steps = np.abs(np.diff(motion.joint))
    counts = np.diff(np.unique(motion.motor))
    way = float(np.ptp(motion.joint))
    if len(counts) == 0 or way < LEAST_RAD or float(steps.max()) > _JUMP_SHARE * way:
        return False
    low, high = (float(np.ptp(motion.motor)) + side * float(counts.min()) for side in (-1, 1))
    return low * nominal.gear_ratio <= way <= high * nominal.gear_ratio


def travels(motor: Array, least: float = LEAST_RAD) -> list[tuple[int, int]]:
    """Return the first and the last index of each travel in one direction of at least ``least``,
    rad.
    """
    found: list[tuple[int, int]] = []
    low = high = begin = 0
    way = 0
    for at, angle in enumerate(motor.tolist()):
        if angle > motor[high]:
            high = at
        if angle < motor[low]:
            low = at
        if way >= 0 and motor[high] - angle >= least:
            if way:
                found.append((begin, high))
            begin, way, low = high, -1, at
        elif way <= 0 and angle - motor[low] >= least:
            if way:
                found.append((begin, low))
            begin, way, high = low, 1, at
    if way:
        found.append((begin, high if way > 0 else low))
    return [(a, b) for a, b in found if b - a > 1]


def current_sense(motion: Motion) -> float:
    """Return the work of the current divided by the sum of its magnitudes, from -1 to 1, or NaN
    unless the joint moved in both directions.
    """
    way = np.diff(motion.motor)
    up, down = float(way[way > 0].sum()), float(-way[way < 0].sum())
    if min(up, down) < LEAST_RAD:
        return math.nan
    work = motion.current[1:] * way
    # Both directions have the same weight, so that the work of a constant load cancels.
    ups, downs = (float(work[way * side > 0].sum()) / path for side, path in ((1, up), (-1, down)))
    amount = float(np.abs(work).sum()) / (up + down)
    return 0.5 * (ups + downs) / amount if amount > 0.0 else math.nan


def torque_constant(motion: Motion, nominal: Nominal) -> tuple[float, str]:
    """Return the torque constant computed from the motion, N m/A, and the source of the value; the
    constant is NaN if the motion does not determine it.

    The sources are, in order: the drive's torque against its current; the back-EMF constant from
    the voltage, which equals the torque constant in SI units; the rated values of the drive, unless
    an uncertain value from the voltage is nearer to the bench file than to the rated values.
    """
    if not math.isnan(constant := _by_torque(motion)):
        return constant, "the drive's torque 6077h against its current 6078h"
    induced, certain = emf_constant(motion, nominal)
    if certain:
        # For alternating current, data sheets state root-mean-square values; torque constant and
        # back-EMF constant of one motor then differ, although both are right.
        stated, emf = nominal.torque_constant_N_m_A, nominal.back_emf_constant_V_s_rad
        confirmed = emf is not None and abs(math.log(induced / emf)) < _SAME_EMF
        if confirmed and _LEAST_EMF <= induced / stated <= 1.0:
            return stated, "the voltage that the motion induces"
        return induced, "the voltage that the motion induces"
    if nominal.rated_torque_N_m is not None and nominal.rated_current_A is not None:
        rated = nominal.rated_torque_N_m / nominal.rated_current_A
        if not _nearer(induced, nominal.torque_constant_N_m_A, rated):
            return rated, "rated torque over rated current"
    return math.nan, ""


def _nearer(value: float, first: float, second: float) -> bool:
    """Return whether a value differs from ``first`` by a smaller factor than from ``second``; False
    for NaN.
    """
    if math.isnan(value) or first == second:
        return False
    return abs(math.log(value / first)) < abs(math.log(value / second))


def _by_torque(motion: Motion) -> float:
    size = _block(motion)
    way = np.diff(motion.motor[::size])
    if np.isnan(motion.torque).any() or np.abs(way).sum() < LEAST_RAD:
        return math.nan
    torque, current = (_means(x, size)[: len(way)] for x in (motion.torque, motion.current))
    worked = float(np.sum(current * way))
    amount = float(np.sum(np.abs(current * way)))
    return float(np.sum(torque * way)) / worked if abs(worked) > SENSE * amount else math.nan


def emf_constant(motion: Motion, nominal: Nominal) -> tuple[float, bool]:
    """Return the back-EMF constant, V s/rad, from U = R I + Ke omega with R free (eq. 1), and
    whether the constant is certain; the constant is NaN if the motion does not determine it.
    """
    size = _block(motion)
    ends = motion.motor[::size]
    if len(ends) < 12 or np.isnan(motion.voltage).any() or np.ptp(motion.motor) < LEAST_RAD:
        return math.nan, False
    speed = np.diff(ends) / np.diff(motion.time[::size]) * nominal.gear_ratio
    voltage, current = (_means(x, size)[: len(speed)] for x in (motion.voltage, motion.current))
    moving = np.abs(speed) > _MOVING_SHARE * np.max(np.abs(speed))
    if min(np.sum(speed[moving] > 0), np.sum(speed[moving] < 0)) < 4:
        return math.nan, False
    table = np.column_stack((speed, current, np.ones_like(speed)))[moving]
    solution, *_ = np.linalg.lstsq(table, voltage[moving], rcond=None)
    rest = voltage[moving] - table @ solution
    freedom = max(1, len(rest) - 3)
    try:
        spread = np.linalg.inv(table.T @ table)[0, 0] * float(rest @ rest) / freedom
    except np.linalg.LinAlgError:
        return math.nan, False
    constant = float(solution[0])
    if constant <= 0.0 or solution[1] <= 0.0:
        return math.nan, False
    certain = _EMF_INFLATION * math.sqrt(max(spread, 0.0)) <= _EMF_CERTAINTY * constant
    return constant, certain


def _block(motion: Motion) -> int:
    """Return the number of samples in a block."""
    if len(motion.time) < 2:
        return 1
    return max(2, round(BLOCK_S / max(float(np.median(np.diff(motion.time))), 1e-6)))


def _means(values: Array, size: int) -> Array:
    """Return the mean of each block over the samples from the second of the block to the first of
    the next block.
    """
    count = (len(values) - 1) // size
    return np.asarray(values[1 : 1 + count * size].reshape(count, size).mean(axis=1))
