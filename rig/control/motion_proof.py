"""Compares what drive and joint encoder report of a motion with each other and the bench file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.errors import ConfigurationError
from drivers.interfaces import Servo
from rig.common.sample import Sample
from rig.config.sequence import Array
from rig.wiring.devices import Nominal

BLOCK_S: Final = 0.02
"""Time over which samples are averaged, s; the speed of a first pass hardly changes in it."""
LEAST_RAD: Final = 0.004  # least travel in one direction that is evaluated, rad at the joint
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
"""Share at the start of a travel in which the motor crosses the play and twists the gear."""
_SAME_EMF: Final = 0.15
"""Greatest |ln(measured / stated back-EMF constant)| at which the stated one is confirmed."""
_LEAST_EMF: Final = 0.55
"""Slightly below 1 / sqrt(3), the ratio if one constant is between lines, the other per phase."""
_EMF_CERTAINTY: Final = 0.08
_EMF_INFLATION: Final = 3.0
"""Factor by which the standard error is increased, because neighbouring blocks are correlated."""


@dataclass(frozen=True)
class Motion:
    """Fresh samples under power, SI units, arrays of shape (n,); motor values at the joint."""

    time: Array
    motor: Array  # angle of the motor encoder over the gear ratio
    joint: Array  # angle of the joint encoder
    velocity: Array  # joint speed as the drive reports it
    current: Array
    voltage: Array  # motor voltage, NaN if the drive reports none
    torque: Array  # motor torque, NaN if the drive reports none beside the current

    @classmethod
    def of(cls, rows: Array) -> Motion:
        """Return the motion of rows (n, 7) in the order of the attributes, without NaN rows."""
        return cls(*rows[np.isfinite(rows[:, :5]).all(axis=1)].T)


def speed_factor(motion: Motion, least: float = LEAST_RAD) -> float:
    """Return the ratio of reported speed to change of position; NaN if the travel is too short."""
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
    """Return the coefficients of two regressors by the normal equations, which are fast."""
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


def travels(motor: Array) -> list[tuple[int, int]]:
    """Return first and last index of each travel in one direction of at least :data:`LEAST_RAD`."""
    found: list[tuple[int, int]] = []
    low = high = begin = 0
    way = 0
    for at, angle in enumerate(motor.tolist()):
        if angle > motor[high]:
            high = at
        if angle < motor[low]:
            low = at
        if way >= 0 and motor[high] - angle >= LEAST_RAD:
            if way:
                found.append((begin, high))
            begin, way, low = high, -1, at
        elif way <= 0 and angle - motor[low] >= LEAST_RAD:
            if way:
                found.append((begin, low))
            begin, way, high = low, 1, at
    if way:
        found.append((begin, high if way > 0 else low))
    return [(a, b) for a, b in found if b - a > 1]


def current_sense(motion: Motion) -> float:
    """Return the relative work of the current, -1 to 1; NaN unless the joint moved both ways."""
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
    """Return whether the ratio of a value to ``first`` is nearer to 1 than that to ``second``."""
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
    """Return the back-EMF constant by eq. 1, V s/rad (NaN if unknown), and if it is certain."""
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
    if len(motion.time) < 2:
        return 1
    return max(2, round(BLOCK_S / max(float(np.median(np.diff(motion.time))), 1e-6)))


def _means(values: Array, size: int) -> Array:
    """Return the mean of each block, from its second sample to the first of the next block."""
    count = (len(values) - 1) // size
    return np.asarray(values[1 : 1 + count * size].reshape(count, size).mean(axis=1))


SPEED, SHAFT, WORK, CONSTANT = (
    "speed against position",
    "joint encoder against motor encoder",
    "current against motion",
    "torque constant",
)
SPEED_BAND: Final = (0.25, 4.0)
"""Range of the ratio of reported to true speed in which the unit of the speed counts as right.
Filters, and samples that miss the peaks of stick-slip, change the ratio less (to 0.33 at one count
per cycle); a wrong unit changes the ratio more, for example rpm for degrees per second by a factor
of 6.
"""
RATIO_TOLERANCE: Final = 0.1
"""Relative difference of the encoders' travels that play and twist may cause."""
TORQUE_BAND: Final = (1.0 / 1.5, 1.5)
"""Range of the ratio of found to stated torque constant within which the stated constant counts as
right. Data sheets, magnets and temperature cause differences of 20 %; wrong definitions (peak or
root mean square, motor or joint) cause larger differences.
"""
STANDS_STILL: Final = 0.005
"""Share of the motor encoder's travel below which the joint encoder counts as standing still."""
SHAFT_SPREAD: Final = 1.3
"""Greatest ratio of the encoders' travels, of the larger to the smaller, at which the encoders
count as turning 1:1. This ratio is large, because before a trip the motor encoder moves only a few
counts.
"""
NO_TORQUE: Final = (
    "the torque constant cannot be compared with a measurement: the drive reports neither a "
    "torque beside its current nor a usable motor voltage, and the bench file states no rated "
    "torque and current. Set servo.voltage_object, or state the rated values; an "
    "identification of this bench shows a change of the torque constant"
)


@dataclass(frozen=True)
class Change:
    """Value to set in the bench file; None removes the key."""

    section: str
    key: str
    value: str | float | None

    def record(self) -> dict[str, str | float | None]:
        """Return the record for a result file."""
        return {"key": f"{self.section}.{self.key}", "value": self.value}

    def __str__(self) -> str:
        if self.value is None:
            return f"no {self.section}.{self.key}"
        shown = f"{self.value:.4g}" if isinstance(self.value, float) else self.value
        return f"{self.section}.{self.key}: {shown}"


@dataclass(frozen=True)
class Contradiction:
    """Two reports, or a report and the bench file, that contradict each other."""

    what: str
    factor: float  # found value over the expected value
    words: str
    # Values to set in the bench file; empty if the bench or the drive must be changed.
    changes: tuple[Change, ...] = ()
    rough: bool = False  # whether the factor is computed from few counts
    open: bool = False  # whether two factors are possible, both of which `words` states

    @property
    def above(self) -> bool:
        """Whether the found value is above the expected value."""
        return self.factor > 1.0


def wrong_speed(
    factor: float, servo: Servo, rough: bool = False, other: float | None = None
) -> Contradiction:
    """Return the contradiction of a speed ``factor``, or perhaps ``other``, times the true one."""
    words = (
        f"the speed that the drive reports is {factor:.4g} times the change of its position; it "
        f"must be {SPEED_BAND[0]:g} to {SPEED_BAND[1]:g} times: {servo.speed_remedy(factor)}"
    )
    if other is not None:
        words += f"; or the factor is {other:.4g}: {servo.speed_remedy(other)}"
    if rough:
        words += "; few counts show this factor, so compare the unit with the manual of the drive"
    changes = tuple(Change("servo", key, value) for key, value in servo.speed_settings(factor))
    return Contradiction(SPEED, factor, words, changes, rough, other is not None)


def wrong_shaft(factor: float, nominal: Nominal) -> Contradiction:
    """Return the contradiction, with its cause, for encoders with different travels."""
    gear = nominal.gear_ratio
    found = (
        f"the joint encoder travels {factor:.4g} times as far as the motor encoder over the gear "
        f"ratio of {gear:g}"
    )
    size, sign = abs(factor), Change("encoder", "sign", -nominal.encoder_sign)
    changes = (sign,) if factor < 0.0 else ()
    if size < STANDS_STILL:
        changes = ()
        remedy = (
            "the joint encoder stands still: check its coupling, and whether it is the "
            "encoder of this joint"
        )
    elif abs(size - 1.0) <= 2.0 * RATIO_TOLERANCE and changes:
        remedy = f"set {sign}, or reverse servo.sign if the drive counts in the opposite direction"
    elif 1.0 / SHAFT_SPREAD <= size / gear <= SHAFT_SPREAD:
        changes = ()
        remedy = (
            "both encoders turn 1:1, so that both are on the same side of the gear: mount the "
            "joint encoder on the joint, or set machine.gear_ratio: 1 if there is no gear"
        )
    else:
        ratio = Change("machine", "gear_ratio", float(f"{gear / size:.4g}"))
        changes = (*changes, ratio)
        remedy = (
            f"set {' and '.join(map(str, changes))}, if the counts per turn of both encoders "
            "are right"
        )
    return Contradiction(SHAFT, factor, f"{found}: {remedy}", changes)


def wrong_sense(sense: float, nominal: Nominal) -> Contradiction:
    """Return the contradiction if the current works against the motion."""
    stated = nominal.current_sign
    changes = () if stated is None else (Change("servo", "current_sign", -stated),)
    remedy = f"set {changes[0]}" if changes else "reverse the scale of its signal in the bench file"
    words = (
        f"the current works against the motion in both directions (relative work {sense:.2f}, "
        f"must be above {-SENSE:g}), but friction consumes work, so that the sign of the current "
        f"is wrong: {remedy}, or correct the sign with the maker's tool"
    )
    return Contradiction(WORK, sense, words, changes)


def wrong_torque(constant: float, source: str, nominal: Nominal) -> Contradiction:
    """Return the contradiction between the found and the stated torque constant."""
    stated = nominal.torque_constant_N_m_A
    factor = constant / stated
    if factor < 0.0:
        words = (
            "torque 6077h and current 6078h of the drive have opposite signs; correct the drive "
            "with its maker's tool"
        )
        return Contradiction(CONSTANT, factor, words)
    change = Change("machine", "torque_constant_N_m_A", float(f"{constant:.4g}"))
    words = (
        f"by {source} the motor gives {constant:.4g} N m/A, the bench file says {stated:.4g} "
        f"N m/A: the ratio {factor:.3g} must be {TORQUE_BAND[0]:.2g} to {TORQUE_BAND[1]:g}: set "
        f"{change}, or correct the rated values"
    )
    return Contradiction(CONSTANT, factor, words, (change,))


INSTANT_SPREAD: Final = 15.0
"""Uncertainty, as a ratio, of the factor of the reported speed early in a motion, because a drive
may report the peak of a slip that lasts less than a cycle. A common unit whose factor is within
this ratio counts as the drive's unit.
"""
SURER_SPREAD: Final = 3.0
"""Uncertainty of this factor, as a ratio, for the whole of a short motion until standstill."""
ROUGH_COUNTS: Final = 30
"""Number of motor positions up to which a factor is rough; beyond, it is right within 2.2."""
LEAST_INSTANT: Final = 4.0
"""Least ratio of one sample's speed to the change of position that explains a trip by the unit."""
_BY_MOTION: Final = (SPEED, SHAFT, WORK)


@dataclass(frozen=True)
class Proof:
    """Result of the comparison of a motion; a factor that it did not determine is NaN."""

    found: dict[str, float]
    contradictions: tuple[Contradiction, ...]

    @property
    def moved(self) -> bool:
        """Whether the joint moved far enough for the comparisons."""
        return not any(math.isnan(self.found[name]) for name in _BY_MOTION)

    @property
    def unproven(self) -> str:
        """What a motion without load cannot determine, for the operator; empty for nothing."""
        return NO_TORQUE if math.isnan(self.found[CONSTANT]) else ""

    @property
    def words(self) -> str:
        """All contradictions as text for the operator."""
        return "; ".join(item.words for item in self.contradictions)


def prove(
    motion: Motion, nominal: Nominal, servo: Servo, tolerance: float = RATIO_TOLERANCE
) -> Proof:
    """Make all comparisons that the motion permits; ``tolerance`` is of the encoders' travels."""
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
        wrong.append(wrong_sense(sense, nominal))
    if not _same(constant / nominal.torque_constant_N_m_A, TORQUE_BAND):
        wrong.append(wrong_torque(constant, source, nominal))
    return Proof(found, tuple(wrong))


def hint(
    motion: Motion, nominal: Nominal, servo: Servo, too_fast: bool = False, too_strong: bool = False
) -> Contradiction | None:
    """Return the explanation of a trip or a fault early in a motion, or None if the samples do not
    explain it.

    Because there may be few samples, only large contradictions count, and the encoders are compared
    only if their angles are proportional to each other.
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
    """Return the contradiction if the last speed is far above the change of the position."""
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
    """Return the contradiction of the speed by the whole motion, if any, else ``found``."""
    factor = speed_factor(motion, least=0.0)
    if math.isnan(factor) or _same(factor, SPEED_BAND) or (factor > 1.0) is not found.above:
        return found
    if len(np.unique(motion.motor)) <= ROUGH_COUNTS:
        return _rough_speed(factor, servo)
    between = _rough_speed(factor, servo, SURER_SPREAD)
    return between if between.open else wrong_speed(factor, servo)


def _rough_speed(factor: float, servo: Servo, spread: float = INSTANT_SPREAD) -> Contradiction:
    """Return the contradiction by a common unit, and by a power of ten that is nearer."""
    common = servo.nearest_speed_factor(factor, spread)
    decimal = servo.nearest_speed_factor(factor, 1.0)
    nearer = min(common, decimal) > 0.0 and _apart(decimal, factor) < _apart(common, factor)
    return wrong_speed(common, servo, rough=True, other=decimal if nearer else None)


def _apart(first: float, second: float) -> float:
    return abs(math.log(first / second))


def _same(factor: float, band: tuple[float, float]) -> bool:
    return math.isnan(factor) or band[0] <= factor <= band[1]


MOST: Final = 20_000


class MotionWitness:
    """Collects samples under power."""

    def __init__(self, servo: Servo, nominal: Nominal) -> None:
        self._servo = servo
        self._nominal = nominal
        self._rows = np.empty((MOST, 7))
        self._count = self._braking = 0
        self._said, self._of = "", (False, False)

    def take(self, sample: Sample, motor_torque: float) -> None:
        """Store a sample, and the motor torque that the drive reports with it, N m."""
        self._braking = 0
        self._count += self._store(sample, motor_torque)

    def take_braking(self, sample: Sample, motor_torque: float) -> None:
        """Store a sample of the braking, which makes only the factor of the speed more accurate."""
        self._braking += self._store(sample, motor_torque)

    def _store(self, sample: Sample, motor_torque: float) -> bool:
        """Store a sample after the earlier samples; return False if the sample is not used."""
        at = self._count + self._braking
        if at == MOST or not sample.fresh:
            return False
        self._rows[at] = (
            sample.time,
            sample.motor_angle / self._nominal.gear_ratio,
            sample.angle,
            sample.velocity,
            sample.current,
            sample.voltage,
            motor_torque,
        )
        return True

    @property
    def motion(self) -> Motion:
        """The fresh samples that were collected so far."""
        return Motion.of(self._rows[: self._count])

    def prove(self, tolerance: float = RATIO_TOLERANCE) -> Proof:
        """Compare the collected samples; see :func:`rig.control.motion_proof.prove`."""
        return prove(self.motion, self._nominal, self._servo, tolerance)

    def require(self) -> Proof:
        """Compare as :meth:`prove` does; raise a ConfigurationError on a contradiction."""
        proof = self.prove()
        if proof.contradictions:
            raise ConfigurationError(proof.words)
        return proof

    def hint(self, too_fast: bool = False, too_strong: bool = False) -> Contradiction | None:
        """Return what explains a fault, or None; see :func:`rig.control.motion_proof.hint`."""
        found = hint(self.motion, self._nominal, self._servo, too_fast, too_strong)
        if found is None or found.what != SPEED or not self._braking:
            return found
        motion = Motion.of(self._rows[: self._count + self._braking])
        return surer(found, motion, self._servo)

    def explanation(self, too_fast: bool = False, too_strong: bool = False) -> str:
        """Return what explains a fault, or a trip of speed or torque; empty if nothing does."""
        try:
            found = self.hint(too_fast, too_strong)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            # An error while the explanation is made must not prevent the stop.
            return ""
        self._said = "" if found is None else f"; {found.words}"
        self._of = (too_fast, too_strong)
        return self._said

    def after_braking(self, message: str) -> str:
        """Return a message whose last explanation is replaced by the explanation after braking."""
        said = self._said
        if not said or said not in message:
            return message
        return message.replace(said, self.explanation(*self._of))


STEP_RAD: Final = 0.01
"""Joint travel of one comparison, rad; several counts of a motor encoder before a gear."""
STEPS: Final = 3
LONGEST_S: Final = 1.0
"""Longest travel that is compared, s: in a slower one an offset of the speed would dominate."""


@dataclass
class _Travel:
    """Start, s and rad, last time, s, and integral of the speed, rad, of one comparison."""

    begun_s: float
    angle: float
    last_s: float
    reported: float = 0.0


class SpeedWitness:
    """Compares speed and position until the unit of the speed is known."""

    def __init__(self, servo: Servo, gear_ratio: float) -> None:
        self._servo = servo
        self._gear_ratio = gear_ratio
        self._travel: _Travel | None = None
        self._products = self._squares = 0.0
        self._left = STEPS

    def decided(self, sample: Sample) -> bool:
        """Return whether the unit of the speed is known; raise a ConfigurationError if wrong."""
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
