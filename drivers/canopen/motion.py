"""Modes of operation of a CiA 402 drive (6060h), and the commands that each mode sends."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Literal, NamedTuple

from drivers import servo_limits
from drivers.canopen import cia402
from drivers.errors import ConfigurationError, StateError
from drivers.interfaces import KNOWN_SPREAD, MEASURED_SPREAD, ServoLimits, SpeedRemedies
from drivers.objects import ObjectAddress, ProcessChannel, optional
from drivers.units import ServoScales

FASTEST_1_S: Final = 60.0
"""Greatest position gain that is derived from the cycle time, 1/s; common drives have this gain."""
GAIN_CYCLES: Final = 0.06
"""Product of position gain and cycle time for a derived gain. A sample is two cycles old when the
command computed from it acts, so that the delay reduces the phase margin by 0.12 rad (7 deg).
"""
SPEED_CYCLES: Final = 0.15
"""Product of speed-loop bandwidth and cycle time; the delay takes 0.3 rad (17 deg) of phase."""
RATIO: Final = 0.4  # greatest ratio of a derived position gain to the bandwidth of the speed loop


@dataclass(frozen=True)
class LoopGains:
    """Gains of the position loop and the speed loop."""

    position_1_s: float  # speed command per position error, 1/s
    # Torque command per speed error, N m s/rad; 0 for a drive that is commanded by a speed.
    speed_N_m_s_rad: float = 0.0
    reset_1_s: float = 0.0  # inverse reset time of the speed loop, 1/s


class LoopState(NamedTuple):
    """Last target, rad (NaN without a target), and integral of the speed controller, N m."""

    target_rad: float = math.nan
    integral_N_m: float = 0.0


AT_REST: Final = LoopState()


def derived(
    cycle_s: float, inertia_kg_m2: float | None, wanted: LoopGains | None = None
) -> LoopGains:
    """Return the gains for a cycle time; gains in ``wanted`` that are not 0 are kept.

    Args:
        cycle_s: Control cycle, s.
        inertia_kg_m2: Inertia at the joint, or None for a drive that is commanded by a speed.
        wanted: Gains that the bench file states, 0 for each gain that it does not state.
    """
    stated = wanted or LoopGains(0.0)
    bandwidth_1_s = SPEED_CYCLES / cycle_s
    position = min(FASTEST_1_S, GAIN_CYCLES / cycle_s)
    if inertia_kg_m2 is None:
        return LoopGains(stated.position_1_s or position)
    speed = stated.speed_N_m_s_rad or inertia_kg_m2 * bandwidth_1_s
    if inertia_kg_m2 > 0.0:
        position = min(position, RATIO * speed / inertia_kg_m2)
    return LoopGains(stated.position_1_s or position, speed, stated.reset_1_s or position / 2.0)


def step(
    state: LoopState,
    gains: LoopGains,
    limits: ServoLimits,
    cycle_s: float,
    target_rad: float,
    angle_rad: float,
    speed_rad_s: float,
) -> tuple[LoopState, float, float]:
    """Return the new state, the speed command and the torque command of one cycle.

    The commands do not move the joint beyond an end of the angle range: near an end, the speed
    command is limited to a speed from which the joint can still stop before the end. A torque that
    would increase a speed above the speed limit is replaced by 0.

    Args:
        state: State after the last cycle.
        gains: Gains; without a speed gain the torque command is 0.
        limits: Limits of the commands; the joint stops before an end of the angle range with the
            deceleration of the quick stop.
        cycle_s: Control cycle, s.
        target_rad: Joint angle to follow.
        angle_rad: Joint angle as last measured.
        speed_rad_s: Joint speed as last measured.

    Raises:
        ConfigurationError: A value is not finite.
    """
    if not math.isfinite(target_rad + angle_rad + speed_rad_s):
        raise ConfigurationError(
            f"the inputs of the position loop are target {target_rad:g} rad, angle "
            f"{angle_rad:g} rad and speed {speed_rad_s:g} rad/s, but all must be finite; check the "
            "drive's process data"
        )
    ahead = 0.0 if math.isnan(state.target_rad) else (target_rad - state.target_rad) / cycle_s
    wanted = ahead + gains.position_1_s * (target_rad - angle_rad)
    up = _stopping(limits.angle_max_rad - angle_rad, limits)
    down = _stopping(angle_rad - limits.angle_min_rad, limits)
    speed = min(max(wanted, -down), up)
    if not gains.speed_N_m_s_rad:
        return LoopState(target_rad), speed, 0.0
    error = speed - speed_rad_s
    integral = state.integral_N_m + (gains.speed_N_m_s_rad * gains.reset_1_s * cycle_s * error)
    asked = gains.speed_N_m_s_rad * error + integral
    torque = min(max(asked, -limits.torque_N_m), limits.torque_N_m)
    if torque != asked and torque * error > 0.0:
        integral = state.integral_N_m  # anti-windup: no further integration at the torque limit
    if abs(speed_rad_s) > limits.speed_rad_s and torque * speed_rad_s > 0.0:
        torque = 0.0
    return LoopState(target_rad, integral), speed, torque


def _stopping(distance_rad: float, limits: ServoLimits) -> float:
    """Return the greatest speed toward an end of the angle range at this distance, rad/s."""
    if distance_rad <= 0.0:
        return 0.0
    return min(
        limits.speed_rad_s, math.sqrt(2.0 * limits.quick_stop_deceleration_rad_s2 * distance_rad)
    )


_ENFORCED: Final = (
    *("angle_min_rad", "angle_max_rad", "speed_rad_s", "torque_N_m"),
    "quick_stop_deceleration_rad_s2",
)
"""Fields of the limits that the position loop enforces."""
ModeName = Literal["csp", "csv", "cst", "pp"]
OUTPUT_PDO: Final = 1
TARGET_POSITION: Final = (0x607A, 0)
TARGET_SPEED: Final = (0x60FF, 0)
TARGET_TORQUE: Final = (0x6071, 0)
TORQUE_OFFSET: Final = (0x60B2, 0)
STALE_CYCLES: Final = 3
"""Number of exchanges without a complete answer after which the command is 0."""
SPEED_OVER: Final = 2
"""Number of exchanges over which the position loop computes the speed from positions."""
COARSE: Final = 0.05
"""Share of the torque limit from which one count of the computed speed is too coarse."""
_INT16: Final = range(-(1 << 15), 1 << 15)
_INT32: Final = range(-(1 << 31), 1 << 31)


class Observed(NamedTuple):
    """State of the drive at the last exchange; ``fresh`` if the answer was complete."""

    statusword: int
    angle_rad: float
    speed_rad_s: float
    fresh: bool


class Motion(ABC):
    """One mode of operation."""

    mode: ClassVar[int]  # value of 6060h
    words: ClassVar[str]  # name of the mode
    target: ClassVar[ObjectAddress]  # object that holds the command of this mode
    # Objects of limits that a drive need not obey in this mode.
    unheld: ClassVar[frozenset[ObjectAddress]] = frozenset()
    # Whether the mode is safe only with a drive that detects a lost master by itself.
    needs_watch: ClassVar[bool] = False
    # Whether the drive follows the commands of the exchanges, and does not move by itself.
    follows: ClassVar[bool] = True
    # Sentences with what the operator must know of this mode.
    remarks: ClassVar[tuple[str, ...]] = ()

    def __init__(self) -> None:
        self.offset = 0  # torque offset, in units of 60B2h
        self.takes_offset = False  # whether the torque offset is sent
        self._cycle_s = 0.0

    @property
    def outputs(self) -> tuple[ObjectAddress, ...]:
        """Objects that are sent with the controlword."""
        return (self.target,)

    @property
    def needed(self) -> Mapping[ObjectAddress, str]:
        """Objects that the mode needs, each with its purpose."""
        return {self.target: "it carries the command of a run"}

    def settings(self, limits: ServoLimits) -> Iterator[tuple[ObjectAddress, int]]:
        """Yield objects and values that are written into the drive together with the limits."""
        yield from ()

    def take_limits(self, limits: ServoLimits) -> None:
        """Store the limits that this program enforces; NaN does not change a stored limit."""
        del limits  # the drive enforces the limits

    def begin(self, cycle_s: float) -> None:
        """Prepare the mode for a control cycle."""
        self._cycle_s = cycle_s

    def reset(self) -> None:
        """Clear the state of the motion, before the drive gets power.

        Raises:
            StateError: A value is missing without which motion must not start.
        """
        self.offset = 0

    @abstractmethod
    def stage(
        self, channel: ProcessChannel, word: int, counts: int, observe: Callable[[], Observed]
    ) -> None:
        """Put the command into the PDO of the next exchange."""


class CyclicPosition(Motion):
    """Cyclic synchronous position: the drive has the position loop."""

    mode = 8
    words = "cyclic synchronous position"
    target = TARGET_POSITION

    def __init__(self, torque_offset: bool = False) -> None:
        super().__init__()
        self.takes_offset = torque_offset

    @property
    def outputs(self) -> tuple[ObjectAddress, ...]:
        return (self.target, TORQUE_OFFSET) if self.takes_offset else (self.target,)

    def stage(
        self, channel: ProcessChannel, word: int, counts: int, observe: Callable[[], Observed]
    ) -> None:
        if self.takes_offset:
            channel.stage(OUTPUT_PDO, word, counts, self.offset)
        else:
            channel.stage(OUTPUT_PDO, word, counts)


class _HostLoop(Motion):
    """Base of the modes in which this program closes the position loop.

    A command is sent in one exchange: if no new command follows, or after several exchanges with
    incomplete samples, the next exchange sends the command 0.
    """

    needs_watch = True
    remarks = (
        "this program closes the position loop, and this program, not the drive, enforces the "
        "limits of angle and following error",
    )
    unheld = frozenset(
        {servo_limits.POSITION_MIN, servo_limits.POSITION_MAX, servo_limits.FOLLOWING_WINDOW}
    )

    def __init__(
        self, scales: ServoScales, gains: LoopGains, inertia_kg_m2: float | None = None
    ) -> None:
        super().__init__()
        self._scales = scales
        self._stated = gains
        self._inertia = inertia_kg_m2
        self._gains = gains
        self._limits: ServoLimits | None = None
        self._state: LoopState = AT_REST
        self._before: LoopState = AT_REST
        self._stepped_in = -1
        self._stale = 0
        self._passed: deque[tuple[int, float]] = deque(maxlen=SPEED_OVER + 1)

    def begin(self, cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._gains = derived(cycle_s, self._inertia, self._stated)

    def take_limits(self, limits: ServoLimits) -> None:
        stated = {name: getattr(limits, name) for name in _ENFORCED}
        known = {name: value for name, value in stated.items() if not math.isnan(value)}
        found = replace(self._limits or limits, **known)
        if not any(math.isnan(getattr(found, name)) for name in _ENFORCED):
            self._limits = found

    def reset(self) -> None:
        if self._limits is None:
            raise StateError(
                f"in mode {self.words} this program, and not the drive, enforces the limits, and "
                "no limits have been set; set the limits before the reset"
            )
        self._state = self._before = AT_REST
        self._stepped_in = -1
        self._stale = 0
        self._passed.clear()

    def stage(
        self, channel: ProcessChannel, word: int, counts: int, observe: Callable[[], Observed]
    ) -> None:
        """Stage the command of the position loop; it is 0 unless operation is commanded."""
        value = 0
        if word == cia402.ENABLE_OPERATION:
            value = self._value(channel.cycle, self._scales.joint_angle_rad(counts), observe())
        channel.stage_once(OUTPUT_PDO, (word, value), (word, 0))

    def _value(self, cycle: int, target_rad: float, seen: Observed) -> int:
        if cycle != self._stepped_in:
            self._stepped_in, self._before = cycle, self._state
            self._stale = 0 if seen.fresh else self._stale + 1
            if seen.fresh:
                self._passed.append((cycle, seen.angle_rad))
        if self._stale > STALE_CYCLES or self._limits is None:
            self._state = AT_REST
            return 0
        self._state, speed, torque = step(
            self._before,
            self._gains,
            self._limits,
            self._cycle_s,
            target_rad,
            seen.angle_rad,
            self._speed(seen, self._limits.torque_N_m),
        )
        return self._units(speed, torque)

    def _speed(self, seen: Observed, torque_N_m: float) -> float:
        """Return the joint speed from the change of the position; this speed does not depend on the
        unit of the drive's speed. If the resolution of this speed would cause too much torque, the
        drive's own speed is returned.
        """
        then, before = self._passed[0] if self._passed else (0, 0.0)
        now, angle = self._passed[-1] if self._passed else (0, 0.0)
        if now == then:
            return 0.0
        count = abs(self._scales.joint_rad_per_count) / (SPEED_OVER * self._cycle_s)
        if count * self._gains.speed_N_m_s_rad > COARSE * torque_N_m:
            return seen.speed_rad_s
        return (angle - before) / ((now - then) * self._cycle_s)

    @abstractmethod
    def _units(self, speed_rad_s: float, torque_N_m: float) -> int:
        """Return the command in the units of the drive."""


class CyclicSpeed(_HostLoop):
    """Cyclic synchronous velocity: this program closes the position loop only."""

    mode = 9
    words = "cyclic synchronous velocity"
    target = TARGET_SPEED

    def _units(self, speed_rad_s: float, torque_N_m: float) -> int:
        units = round(self._scales.sign * speed_rad_s / self._scales.joint_speed_unit_rad_s)
        return _within(units, _INT32, self.target)


class CyclicTorque(_HostLoop):
    """Cyclic synchronous torque: this program closes the position loop and the speed loop."""

    mode = 10
    words = "cyclic synchronous torque"
    target = TARGET_TORQUE
    unheld = _HostLoop.unheld | {servo_limits.MAX_SPEED}
    remarks = (
        "this program closes the position and speed loops, and this program, not the drive, "
        "enforces the limits of angle, following error and speed; but a speed limit that the bench "
        "file states for the drive is enforced by the drive",
    )

    def _units(self, speed_rad_s: float, torque_N_m: float) -> int:
        units = round(self._scales.sign * torque_N_m / self._scales.joint_torque_unit_N_m)
        return _within(units, _INT16, self.target)


def _within(units: int, allowed: range, target: ObjectAddress) -> int:
    if units not in allowed:
        raise ConfigurationError(
            f"the command {units} is beyond the range of object {target[0]:04X}h: check the "
            "scales in the bench file"
        )
    return units


class ProfilePosition(Motion):
    """Profile position: each new set-point immediately replaces the previous set-point (bits 4 and
    5 of the controlword, bit 12 of the statusword). The profile of the drive ends at the last
    set-point.
    """

    mode = 1
    words = "profile position"
    target = TARGET_POSITION
    remarks = (
        "the joint follows the command in ramps, with a distance of the square of the speed over "
        "twice the acceleration",
    )
    _NEW: Final = 1 << 4
    _AT_ONCE: Final = 1 << 5
    _ACKNOWLEDGED: Final = 1 << 12

    def __init__(self, scales: ServoScales, acceleration_rad_s2: float) -> None:
        super().__init__()
        self._scales = scales
        self._acceleration = acceleration_rad_s2
        self._raised = False
        self._staged_in = -1

    @property
    def needed(self) -> Mapping[ObjectAddress, str]:
        return {**super().needed, servo_limits.PROFILE_SPEED: "it limits the speed of the profile"}

    def settings(self, limits: ServoLimits) -> Iterator[tuple[ObjectAddress, int]]:
        unit = self._scales.joint_speed_unit_rad_s
        if not math.isnan(limits.speed_rad_s):
            yield servo_limits.PROFILE_SPEED, math.floor(limits.speed_rad_s / unit + 1e-6)
            for address in (servo_limits.PROFILE_ACCELERATION, servo_limits.PROFILE_DECELERATION):
                units = self._acceleration / self._scales.joint_acceleration_unit_rad_s2
                yield address, max(1, round(units))

    def reset(self) -> None:
        self._raised = False
        self._staged_in = -1

    def stage(
        self, channel: ProcessChannel, word: int, counts: int, observe: Callable[[], Observed]
    ) -> None:
        """Put the set-point into the PDO of the next exchange. The bit "new set-point" is set in
        every other exchange, after the drive has accepted the last set-point.
        """
        if word == cia402.ENABLE_OPERATION:
            if channel.cycle != self._staged_in:
                self._staged_in = channel.cycle
                seen = observe()
                running = seen.statusword & 0x6F == 0x27
                taken = bool(seen.statusword & self._ACKNOWLEDGED)
                if seen.fresh and running and taken is self._raised:
                    self._raised = not self._raised
            word |= self._AT_ONCE | (self._NEW if self._raised else 0)
        channel.stage(OUTPUT_PDO, word, counts)


UNIT: Final[ObjectAddress] = (0x60A9, 0)
"""SI unit of the velocity (CiA 402-2): power of ten, numerator, denominator, reserved."""
ACCELERATION_UNIT: Final[ObjectAddress] = (0x60AA, 0)
"""SI unit of the acceleration (CiA 402-2): power of ten, numerator, denominator, reserved."""
RPM: Final = 2.0 * math.pi / 60.0  # speed of one turn per minute, rad/s
_NUMERATORS: Final[Mapping[int, float]] = {0x10: 1.0, 0x41: math.pi / 180.0, 0xB4: 2.0 * math.pi}
"""Codes of CiA 303-2 for radian, degree and revolution, to the angle in rad."""
_DENOMINATORS: Final[Mapping[int, float]] = {0x03: 1.0, 0x47: 60.0, 0x48: 3600.0}
"""Codes of the time units second, minute and hour, to the time in s."""
_RPM_CODE: Final = 0xC0
_SQUARE_SECOND: Final = 0x57  # codes in 60AAh for revolutions per minute and for the square second
_POWERS: Final = (-3, -2, -1, 1, 2, 3)
"""Powers of ten by which the true unit may differ from the unit in the bench file."""
_SAME: Final = 0.01  # relative difference up to which two units count as equal
_UNUSUAL: Final = 3.0
"""A decimal multiple is chosen in place of a named unit only if, on a logarithmic scale, the
distance to the named unit is more than so many times the distance to the multiple.
"""
_WORDS: Final[Mapping[str, str]] = {"rpm": "rpm", "counts_per_s": "counts per second"}


def decode(word: int) -> float | None:
    """Return the motor speed of one unit of 60A9h, rad/s, or None if it has no SI meaning."""
    numerator = _NUMERATORS.get(word >> 16 & 0xFF)
    denominator = _DENOMINATORS.get(word >> 8 & 0xFF)
    if numerator is None or denominator is None:
        return None
    power = word >> 24 & 0xFF
    return numerator / denominator * 10.0 ** (power - 256 if power > 127 else power)


def decode_acceleration(word: int) -> float | None:
    """Return the motor acceleration of one unit of 60AAh, rad/s^2, or None without SI meaning."""
    if word >> 8 & 0xFF == _SQUARE_SECOND:
        return decode(word & ~0xFF00 | 0x0300)
    if word >> 16 & 0xFF == _RPM_CODE:
        found = decode(word & ~0xFF0000 | 0xB40000)
        return None if found is None else found / 60.0
    return None


def stated_unit_problems(
    channel: ProcessChannel, scales: ServoScales
) -> Iterator[ConfigurationError]:
    """Yield an error for each unit that the drive states (60A9h, 60AAh) and that differs from the
    unit in the bench file; a drive without these objects, or with a unit that is none of SI, states
    no unit.
    """
    for name, symbol, unit, address, meaning in (
        ("speed", "rad/s", scales.motor_speed_unit_rad_s, UNIT, decode),
        (
            "acceleration",
            "rad/s^2",
            scales.motor_acceleration_unit_rad_s2,
            ACCELERATION_UNIT,
            decode_acceleration,
        ),
    ):
        word = optional(channel.read, *address) if channel.describes(*address) else None
        told = None if word is None else meaning(word & 0xFFFFFFFF)
        if word is None or told is None or abs(told - unit) <= _SAME * told:
            continue
        setting = f"set servo.acceleration_unit_rad_s2: {told:.6g}"
        if address == UNIT:
            setting = SpeedUnit(scales).words(told, exact=True)
        yield ConfigurationError(
            f"unit of the {name}, {address[0]:04X}h: {told:.6g} {symbol} "
            f"({word & 0xFFFFFFFF:08X}h) in the drive, but {unit:.6g} {symbol} in the bench file: "
            f"{setting}"
        )


class SpeedUnit(SpeedRemedies):
    """The unit of the drive's speed (606Ch) beside those that drives have."""

    def __init__(self, scales: ServoScales) -> None:
        self._scales = scales

    def speed_remedy(self, factor: float) -> str:
        if factor == 0.0:
            return (
                "the speed 606Ch reads 0 while the position 6064h changes: the drive does not "
                "measure the speed, or its unit of the speed is too coarse for this motion; set a "
                "finer unit with the maker's tool, and state this unit in "
                "servo.velocity_unit_rad_s"
            )
        if factor < 0.0:
            return (
                "the speed 606Ch has the opposite sign of the change of the position 6064h; "
                "correct the sign with the maker's tool"
            )
        return self.words(self._own / factor)

    def speed_settings(self, factor: float) -> tuple[tuple[str, str | float | None], ...]:
        if factor <= 0.0:
            return ()
        name, unit = self._recognised(self._own / factor)
        if name in self._named:
            return (("velocity_unit_rad_s", None), ("velocity_unit", name))
        return (("velocity_unit", None), ("velocity_unit_rad_s", float(f"{unit:.4g}")))

    def nearest_speed_factor(self, factor: float, spread: float) -> float:
        """Return the factor of the nearest named unit if its ratio to the rough ``factor`` is
        within ``spread``, else the power of ten nearest to the rough factor; the present unit is
        excluded.
        """
        if factor <= 0.0:
            return factor
        named = _nearest(self._own / factor, self._others, spread)
        if named is not None:
            return self._own / named[1]
        return 10.0 ** (round(math.log10(factor)) or math.copysign(1.0, math.log10(factor)))

    def words(self, found: float, exact: bool = False) -> str:
        """Return the setting for a unit, rad/s; ``exact`` is false if a motion gave the unit."""
        name, unit = self._recognised(found, exact)
        if name is not None and name in self._named:
            return f"the unit of 606Ch is {_WORDS[name]}: set servo.velocity_unit: {name}"
        setting = f"set servo.velocity_unit_rad_s: {unit:.4g}"
        if exact:
            return f"the unit of 606Ch is {name}: {setting}" if name is not None else setting
        if name is not None:
            return f"the unit of 606Ch is probably {name}; check the drive's manual, then {setting}"
        return (
            f"one unit of 606Ch is about {unit:.4g} rad/s; look up the exact unit in the drive's "
            f"manual, or {setting}"
        )

    @property
    def _own(self) -> float:
        return self._scales.motor_speed_unit_rad_s

    @property
    def _named(self) -> dict[str, float]:
        """Units that have a name in the bench file."""
        return {"rpm": RPM, "counts_per_s": self._scales.count_rad}

    @property
    def _others(self) -> dict[str, float]:
        """Named units that differ from the unit in the bench file."""
        return {name: unit for name, unit in self._named.items() if not self._is_own(unit)}

    def _is_own(self, unit: float) -> bool:
        return abs(unit - self._own) <= _SAME * self._own

    def _recognised(self, unit: float, exact: bool = False) -> tuple[str | None, float]:
        """Return name and value of the known unit that a value belongs to; the name is None if
        there is no such unit. Known are the named units, and decimal multiples of the unit in the
        bench file, because in many drives a power of ten of the unit can be set.

        A measured value may differ from the true unit by rounding, and by peaks of the speed
        between samples. A decimal multiple is less likely than a named unit. A decimal multiple is
        therefore chosen only if the nearest named unit is farther from the value than the error of
        a measured motion, and if the multiple is much nearer.
        """
        own = next((_WORDS[n] for n, u in self._named.items() if self._is_own(u)), None)
        multiples = {
            f"{10.0**power:g} {own or 'times the stated unit'}": self._own * 10.0**power
            for power in _POWERS
        }
        one = 1.0 + _SAME
        named = _nearest(unit, self._others, one if exact else KNOWN_SPREAD)
        decimal = _nearest(unit, multiples, one if exact else MEASURED_SPREAD)
        if named is None or decimal is None:
            return named or decimal or (None, unit)
        apart = _apart(unit, named[1])
        usual = apart <= math.log(MEASURED_SPREAD) or apart <= _UNUSUAL * _apart(unit, decimal[1])
        return named if usual else decimal


def _nearest(unit: float, known: Mapping[str, float], spread: float) -> tuple[str, float] | None:
    """Return name and value of the nearest known unit within a factor of ``spread``, or None."""
    if not known:
        return None
    name = min(known, key=lambda name: _apart(unit, known[name]))
    return (name, known[name]) if _apart(unit, known[name]) <= math.log(spread) else None


def _apart(first: float, second: float) -> float:
    return abs(math.log(first / second))
