"""Homing of the simulated drive (6060h = 6): methods 17, 18, 35 and 37."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from drivers.clock import NS, SimulatedClock
from drivers.mock.canopen.dictionary import OUT_OF_RANGE, SdoAbortError, key
from drivers.mock.sampler import Sampler
from drivers.mock.wires.timer import Timer

HM: Final = 6
METHODS: Final = (17, 18, 35, 37)
"""Homing methods that object 60E3h lists."""
REACHED: Final = 0x0400
ATTAINED: Final = 0x1000
ERROR: Final = 0x2000
"""Bits of the statusword in homing mode."""
_CONTROLWORD: Final = key(0x6040)
_OFFSET: Final = key(0x607C)
_METHOD: Final = key(0x6098)
_SEARCH: Final = key(0x6099, 1)
_ZERO: Final = key(0x6099, 2)
_ACCELERATION: Final = key(0x609A)
_WINDOW: Final = key(0x6065)
_START: Final = 1 << 4
_STEP_NS: Final = 1_000_000
_TOO_LITTLE_A: Final = 0.2
_BLOCKED_DEG: Final = 1.0
"""Lag of the joint behind the target from which the joint counts as blocked, deg; half of the
following-error limit if this is less.
"""


def check_method(_subindex: int, value: int) -> None:
    """Refuse a homing method that the drive does not have.

    Raises:
        SdoAbortError: The drive does not have this method.
    """
    if value not in METHODS:
        raise SdoAbortError(OUT_OF_RANGE)


class Homing:
    """Homing of the simulated drive: moves the machine to a switch, and sets the zero of the
    drive's position.

    The limit switches are closed where the true joint angle is beyond them.

    Args:
        sampler: Access to the machine.
        clock: Simulated time.
        values: The drive's dictionary.
        counts_per_rad: Motor counts per radian of the motor.
        speed_unit: Function that returns the unit of the drive's speeds, counts/s.
        acceleration_unit: Function that returns the unit of its accelerations, counts/s^2.

    Attributes:
        shift: Drive position less the motor's counts.
        switches_deg: Joint angles of the limit switches, or None for switches that never close.
        endless: Whether a homing never ends.
        jammed: Whether the motor has too little torque to move the joint, as with a jammed joint.
    """

    def __init__(
        self,
        sampler: Sampler,
        clock: SimulatedClock,
        values: dict[int, int],
        counts_per_rad: float,
        speed_unit: Callable[[], float],
        acceleration_unit: Callable[[], float],
    ) -> None:
        self.shift = 0
        self.switches_deg: tuple[float, float] | None = (-20.0, 20.0)
        self.endless = self.jammed = False
        self._sampler, self._clock, self._values = sampler, clock, values
        self._counts_per_rad, self._speed_unit = counts_per_rad, speed_unit
        self._acceleration_unit = acceleration_unit
        self._gear = sampler.machine.constants.motor.gear_ratio
        self._timer = Timer(clock, self._advance)
        self._bits = REACHED
        self._word = 0
        self._demand = self._speed = 0.0
        self._found = self._home = False

    @property
    def flags(self) -> int:
        """Bits of the statusword."""
        return self._bits

    def begin(self, counts: int) -> None:
        """Hold the position when the power is switched on in homing mode; the homing starts at a
        rising edge of bit 4.
        """
        self._bits = REACHED
        self._word = self._values[_CONTROLWORD]
        self._demand, self._speed = float(counts), 0.0

    def stop(self) -> None:
        """End the motion, because the power is switched off or the drive brakes."""
        self._timer.stop()

    def obey(self) -> None:
        """Start the homing at a rising edge of bit 4 of the controlword, and interrupt the homing
        at a falling edge.
        """
        word = self._values[_CONTROLWORD]
        rising, falling = word & ~self._word & _START, ~word & self._word & _START
        self._word = word
        if falling and not self._bits & (ATTAINED | ERROR):
            self._halt(REACHED)
        if not rising:
            return
        self._bits = 0
        self._found = self._home = False
        reading = self._sampler.peek(self._clock.now_ns())
        self._demand, self._speed = float(reading.motor_counts), 0.0
        if self.jammed:
            self._sampler.machine.limit_current(_TOO_LITTLE_A)
        if self._values[_METHOD] in (17, 18):
            self._timer.start(self._clock.now_ns() + _STEP_NS)
        elif not self.endless:
            self._set_zero(reading.motor_counts)
            self._bits = REACHED | ATTAINED

    def _set_zero(self, counts: int) -> None:
        self.shift = self._values[_OFFSET] - counts

    def _halt(self, bits: int) -> None:
        self._timer.stop()
        self._bits = bits
        self._sampler.machine.track(self._demand, _STEP_NS)

    def _advance(self) -> None:
        """Take one step: move to the switch, then slowly away from it; the edge of the switch is
        the home position.
        """
        now = self._clock.now_ns()
        self._sampler.advance(now)
        reading = self._sampler.peek(now)
        if abs(reading.following_error_counts) > self._blocked():
            self._demand = float(reading.motor_counts)
            self._halt(REACHED | ERROR)
            return
        side = -1 if self._values[_METHOD] == 17 else 1
        closed = self._closed(side)
        if closed and not self._found:
            self._found = True
        elif self._found and not closed and not self._home and not self.endless:
            self._home = True
            self._set_zero(reading.motor_counts)
        speed = -self._values[_ZERO] if self._found else self._values[_SEARCH]
        wanted = 0.0 if self._home else side * speed * self._speed_unit()
        change = self._values[_ACCELERATION] * self._acceleration_unit() * _STEP_NS / NS
        self._speed += min(max(wanted - self._speed, -change), change)
        if self._home and self._speed == 0.0:
            self._halt(REACHED | ATTAINED)
            return
        self._demand += self._speed * _STEP_NS / NS
        self._sampler.machine.track(self._demand, _STEP_NS)
        self._timer.start(now + _STEP_NS)

    def _closed(self, side: int) -> bool:
        if self.switches_deg is None:
            return False
        angle = math.degrees(self._sampler.machine.truth().angle_rad)
        low, high = self.switches_deg
        return angle <= low if side < 0 else angle >= high

    def _blocked(self) -> float:
        counts = math.radians(_BLOCKED_DEG) * self._gear * self._counts_per_rad
        return min(counts, 0.5 * self._values[_WINDOW])
