"""Modes of operation of a CiA 402 drive (6060h), and the commands that each mode sends to follow a
position.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import ClassVar, Final, Literal, NamedTuple

from drivers import servo_limits
from drivers.canopen import cia402
from drivers.canopen.position_loop import (
    AT_REST,
    LoopGains,
    LoopLimits,
    LoopState,
    derived,
    step,
)
from drivers.errors import ConfigurationError, StateError
from drivers.interfaces import ServoLimits
from drivers.objects import ObjectAddress, ProcessChannel
from drivers.units import ServoScales

ModeName = Literal["csp", "csv", "cst", "pp"]
OUTPUT_PDO: Final = 1
TARGET_POSITION: Final = (0x607A, 0)
TARGET_SPEED: Final = (0x60FF, 0)
TARGET_TORQUE: Final = (0x6071, 0)
TORQUE_OFFSET: Final = (0x60B2, 0)
STALE_CYCLES: Final = 3
"""Number of successive exchanges without a complete answer after which the commanded speed or
torque is 0.
"""
SPEED_OVER: Final = 2
"""Number of exchanges over which the position loop computes the speed from positions."""
COARSE: Final = 0.05
"""Torque that one count of the computed speed may cause in the position loop, as a share of the
torque limit; above this share the computed speed is too coarse.
"""
_INT16: Final = range(-(1 << 15), 1 << 15)
_INT32: Final = range(-(1 << 31), 1 << 31)


class Observed(NamedTuple):
    """State of the drive at the last exchange: statusword, joint angle and speed, and whether the
    answer was complete.
    """

    statusword: int
    angle_rad: float
    speed_rad_s: float
    fresh: bool


class Motion(ABC):
    """One mode of operation.

    Attributes:
        mode: Value of 6060h.
        words: Name of the mode.
        target: Object that holds the command of this mode.
        unheld: Objects of limits that a drive need not obey in this mode.
        needs_watch: Whether the mode is safe only with a drive that detects a lost master by
            itself.
        follows: Whether the drive follows the commands of the exchanges, and does not move by
            itself.
        remarks: Sentences with what the operator must know of this mode.
        offset: Torque offset, in units of 60B2h.
        takes_offset: Whether the torque offset is sent.
    """

    mode: ClassVar[int]
    words: ClassVar[str]
    target: ClassVar[ObjectAddress]
    unheld: ClassVar[frozenset[ObjectAddress]] = frozenset()
    needs_watch: ClassVar[bool] = False
    follows: ClassVar[bool] = True
    remarks: ClassVar[tuple[str, ...]] = ()

    def __init__(self) -> None:
        self.offset = 0
        self.takes_offset = False
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
        """Store the limits that this program enforces; a limit of NaN does not change the stored
        limit.
        """
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
        """Put the command into the PDO of the next exchange.

        Args:
            channel: The drive.
            word: Controlword.
            counts: Position to follow.
            observe: Function that returns the state of the drive at the last exchange.
        """


class CyclicPosition(Motion):
    """Cyclic synchronous position: the drive has the position loop.

    Args:
        torque_offset: Whether the torque offset 60B2h is sent.
    """

    mode = 8
    words = "cyclic synchronous position"
    target = TARGET_POSITION

    def __init__(self, torque_offset: bool = False) -> None:
        super().__init__()
        self.takes_offset = torque_offset

    @property
    def outputs(self) -> tuple[ObjectAddress, ...]:
        """Objects that are sent with the controlword."""
        return (self.target, TORQUE_OFFSET) if self.takes_offset else (self.target,)

    def stage(
        self, channel: ProcessChannel, word: int, counts: int, observe: Callable[[], Observed]
    ) -> None:
        """Put controlword, position and torque offset into the PDO of the next exchange."""
        if self.takes_offset:
            channel.stage(OUTPUT_PDO, word, counts, self.offset)
        else:
            channel.stage(OUTPUT_PDO, word, counts)


class _HostLoop(Motion):
    """Base of the modes in which this program closes the position loop.

    A command is sent in one exchange: if no new command follows, or after several exchanges with
    incomplete samples, the next exchange sends the command 0.

    Args:
        scales: Units of the drive.
        gains: Gains that the bench file states, 0 for each gain that is derived from the cycle
            time.
        inertia_kg_m2: Inertia at the joint, for a torque command.
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
        self._limits: LoopLimits | None = None
        self._state: LoopState = AT_REST
        self._before: LoopState = AT_REST
        self._stepped_in = -1
        self._stale = 0
        self._passed: deque[tuple[int, float]] = deque(maxlen=SPEED_OVER + 1)

    def begin(self, cycle_s: float) -> None:
        """Derive the gains of the loop from the cycle time."""
        self._cycle_s = cycle_s
        self._gains = derived(cycle_s, self._inertia, self._stated)

    def take_limits(self, limits: ServoLimits) -> None:
        """Store the limits, which the position loop in this program enforces."""
        held = self._limits
        fields = {
            "angle_min_rad": limits.angle_min_rad,
            "angle_max_rad": limits.angle_max_rad,
            "speed_rad_s": limits.speed_rad_s,
            "torque_N_m": limits.torque_N_m,
            "deceleration_rad_s2": limits.quick_stop_deceleration_rad_s2,
        }
        found = {
            name: getattr(held, name, math.nan) if math.isnan(value) else value
            for name, value in fields.items()
        }
        if not any(map(math.isnan, found.values())):
            self._limits = LoopLimits(**found)

    def reset(self) -> None:
        """Clear the state of the motion; raise :class:`StateError` if the limits have not been
        set.
        """
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
        """Put the controlword and the command of the position loop into the PDO of the next
        exchange; the command is 0 unless the controlword commands operation.
        """
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
    """Cyclic synchronous velocity: the drive closes the speed loop, and this program the position
    loop.
    """

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

    Args:
        scales: Units of the drive.
        acceleration_rad_s2: Acceleration and deceleration of the profile, at the joint.
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
        """Objects that the mode needs, each with its purpose."""
        return {
            **super().needed,
            servo_limits.PROFILE_SPEED: "it limits the speed of the profile",
        }

    def settings(self, limits: ServoLimits) -> Iterator[tuple[ObjectAddress, int]]:
        """Yield speed, acceleration and deceleration of the profile."""
        unit = self._scales.joint_speed_unit_rad_s
        if not math.isnan(limits.speed_rad_s):
            yield servo_limits.PROFILE_SPEED, math.floor(limits.speed_rad_s / unit + 1e-6)
            for address in (servo_limits.PROFILE_ACCELERATION, servo_limits.PROFILE_DECELERATION):
                units = self._acceleration / self._scales.joint_acceleration_unit_rad_s2
                yield address, max(1, round(units))

    def reset(self) -> None:
        """Clear the state of the motion; the next set-point has no bit "new set-point"."""
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
