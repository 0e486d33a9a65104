"""Applies the targets of a simulated CiA 402 drive in each mode of operation (6060h)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from drivers.clock import NS, SimulatedClock
from drivers.mock.canopen.dictionary import key
from drivers.mock.drive_homing import HM, Homing
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.sampler import Sampler
from drivers.mock.wires.timer import Timer

PP, CSP, CSV, CST = 1, 8, 9, 10
"""Modes of operation."""
_MODE: Final = key(0x6060)
_CONTROLWORD: Final = key(0x6040)
_TARGET_TORQUE: Final = key(0x6071)
_TARGET: Final = key(0x607A)
_TARGET_MIN: Final = key(0x607D, 1)
_TARGET_MAX: Final = key(0x607D, 2)
_MAX_SPEED: Final = key(0x607F)
_PROFILE_SPEED: Final = key(0x6081)
_PROFILE_ACCELERATION: Final = key(0x6083)
_PROFILE_DECELERATION: Final = key(0x6084)
_TORQUE_OFFSET: Final = key(0x60B2)
_TARGET_SPEED: Final = key(0x60FF)
_NEW: Final = 1 << 4
_PROFILE_NS: Final = 1_000_000
_BIT_12: Final = 0x1000
"""Bit of the statusword: the drive follows its target, or has accepted a set-point."""


class Mover:
    """Commands the machine according to the mode and the targets in the dictionary.

    Args:
        sampler: Access to the machine.
        clock: Simulated time.
        values: The drive's dictionary.
        counts_per_rad: Motor counts per radian of the motor.
        speed_unit: Unit of the drive's speeds, counts/s.
        acceleration_unit: Unit of the drive's accelerations, counts/s^2.
        current_A: Motor current of one unit of torque.

    Attributes:
        homing: Homing of the drive, and the zero that the last homing has set.
    """

    def __init__(
        self,
        sampler: Sampler,
        clock: SimulatedClock,
        values: dict[int, int],
        counts_per_rad: float,
        speed_unit: float,
        acceleration_unit: float,
        current_A: float,
    ) -> None:
        self.demand = 0.0
        self.acknowledged = False
        self._sampler = sampler
        self._machine: SimulatedMachine = sampler.machine
        self._clock = clock
        self._values = values
        self._counts_per_rad = counts_per_rad
        self.speed_unit, self.acceleration_unit = speed_unit, acceleration_unit
        self._current_A = current_A
        self.homing = Homing(
            sampler,
            clock,
            values,
            counts_per_rad,
            lambda: self.speed_unit,
            lambda: self.acceleration_unit,
        )
        self._gear = self._machine.constants.motor.gear_ratio
        self._profile = Timer(clock, self._advance_profile)
        self._speed = 0.0
        self._goal = 0.0
        self._word = 0

    @property
    def positions(self) -> bool:
        """Whether the drive closes its position loop, so that it has a following error."""
        return self._values[_MODE] not in (CSV, CST)

    @property
    def flags(self) -> int:
        """Bits of the statusword that depend on the mode, while the drive operates."""
        mode = self._values[_MODE]
        if mode == HM:
            return self.homing.flags
        follows = mode in (CSP, CSV, CST) or (mode == PP and self.acknowledged)
        return _BIT_12 if follows else 0

    def start(self, counts: int) -> None:
        """Start at a position in motor counts, when the power is switched on."""
        self.demand = self._goal = float(counts)
        self._speed = 0.0
        self.acknowledged = False
        self._word = self._values[_CONTROLWORD]
        mode = self._values[_MODE]
        self._machine.control(position=self.positions, speed=mode != CST)
        if mode == PP:
            self._profile.start(self._clock.now_ns() + _PROFILE_NS)
        elif mode == HM:
            self.homing.begin(counts)

    def stop(self) -> None:
        """End the profile or the homing."""
        self._profile.stop()
        self.homing.stop()

    def follow(self, period_ns: int) -> bool:
        """Follow the targets; return whether a limit has changed a target."""
        move: Callable[[int], bool] | None = {
            CSP: self._position,
            CSV: self._spin,
            CST: self._push,
            PP: self._set_point,
            HM: self._home,
        }.get(self._values[_MODE])
        return move is not None and move(period_ns)

    def _clamped(self) -> float:
        """Return the target within its limits, in the motor's counts."""
        values = self._values
        target = min(max(values[_TARGET], values[_TARGET_MIN]), values[_TARGET_MAX])
        return float(target - self.homing.shift)

    def _position(self, period_ns: int) -> bool:
        values, target = self._values, self._clamped()
        reach = values[_MAX_SPEED] * self.speed_unit * period_ns / NS
        step = target - self.demand
        if step > reach or step < -reach:
            target = self.demand + math.copysign(reach, step)
        self.demand = target
        self._machine.track(target, period_ns)
        self._machine.feed(values[_TORQUE_OFFSET] * self._current_A)
        return target + self.homing.shift != values[_TARGET]

    def _spin(self, _period_ns: int) -> bool:
        values = self._values
        speed = min(max(values[_TARGET_SPEED], -values[_MAX_SPEED]), values[_MAX_SPEED])
        self._machine.spin(speed * self.speed_unit / self._counts_per_rad / self._gear)
        return speed != values[_TARGET_SPEED]

    def _push(self, _period_ns: int) -> bool:
        values = self._values
        torque = values[_TARGET_TORQUE]
        motor_rad_s = self._sampler.peek(self._clock.now_ns()).motor_velocity_rad_s
        speed = motor_rad_s * self._counts_per_rad / self.speed_unit
        if abs(speed) > values[_MAX_SPEED] and torque * speed > 0.0:
            torque = 0
        self._machine.feed(torque * self._current_A)
        return torque != values[_TARGET_TORQUE]

    def _set_point(self, _period_ns: int) -> bool:
        word = self._values[_CONTROLWORD]
        if word & ~self._word & _NEW:
            self._goal = self._clamped()
            self.acknowledged = True
        elif not word & _NEW:
            self.acknowledged = False
        self._word = word
        goal = self._goal + self.homing.shift
        return goal != self._values[_TARGET] and self.acknowledged

    def _home(self, _period_ns: int) -> bool:
        self.homing.obey()
        return False

    def _advance_profile(self) -> None:
        """Take one step of a profile with constant accelerations to the set-point."""
        self._sampler.advance(self._clock.now_ns())
        values, dt = self._values, _PROFILE_NS / NS
        acceleration = values[_PROFILE_ACCELERATION] * self.acceleration_unit
        deceleration = values[_PROFILE_DECELERATION] * self.acceleration_unit
        greatest = min(values[_PROFILE_SPEED], values[_MAX_SPEED]) * self.speed_unit
        left = self._goal - self.demand
        # This is the speed from which whole steps of the deceleration end at the set-point.
        half = deceleration * dt / 2.0
        allowed = min(math.sqrt(half * half + 2.0 * deceleration * abs(left)) - half, greatest)
        wanted = math.copysign(allowed, left) if left else 0.0
        rising = abs(wanted) > abs(self._speed) and wanted * self._speed >= 0.0
        change = (acceleration if rising else deceleration) * dt
        self._speed += min(max(wanted - self._speed, -change), change)
        if abs(left) < 0.5 and abs(self._speed) <= change:
            self.demand, self._speed = self._goal, 0.0
        else:
            self.demand += self._speed * dt
        self._machine.track(self.demand, _PROFILE_NS)
        self._profile.start(self._clock.now_ns() + _PROFILE_NS)
