"""Base class of simulated drives with their own CAN frames: power stage, target, watchdog.

The subclasses pack frames with their own code, not with the codec under test.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, Final

from drivers.clock import SimulatedClock
from drivers.mock.plant.machine import Reading
from drivers.mock.sampler import Sampler, encoder_resolution
from drivers.mock.wires.bus import SimulatedBus, Timer

WATCHDOG_NS: Final = 100_000_000
"""Time without a target after which a drive with power on goes into fault."""
_MS: Final = 1_000_000
_IDLE_NS: Final = 20_000_000
_LONGEST_STEP_NS: Final = 20_000_000


class CanDrive(ABC):
    """A drive that is either off or follows a target; when the power is switched off, the motor
    coasts.

    Attributes:
        powered: Whether the power stage is on.
        fault_code: Cause of the fault; 0 without a fault. In a fault the power is off.
    """

    lost_code: ClassVar[int]
    """Fault code after a time-out of the watchdog."""

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock, sampler: Sampler) -> None:
        self.powered = False
        self.fault_code = 0
        self._clock = clock
        self._sampler = sampler
        self._machine = sampler.machine
        increments, turns = encoder_resolution(self._machine.constants)
        self._counts_per_rad = increments / turns / math.tau
        self._demand = 0.0
        self._speed_rad_s = math.inf
        self._fed_ns = -_LONGEST_STEP_NS
        self._latched: Reading = sampler.peek(clock.now_ns())
        self._watchdog = Timer(clock, self._check_watchdog)
        self._port = bus.attach()

    @abstractmethod
    def boot(self) -> None:
        """Start receiving and sending, as after power-on."""

    def fail(self, code: int) -> None:
        """Go into fault with the fault code of an internal cause."""
        self.fault_code = code
        self._switch(False)

    def _switch(self, on: bool) -> None:
        """Switch the power stage; when switched on, the drive first holds the present position."""
        now = self._clock.now_ns()
        self._sampler.advance(now)
        if on == self.powered:
            return
        self.powered = on
        self._machine.power(on)
        if on:
            self._demand = float(self._sampler.peek(now).motor_counts)
            self._fed_ns = now
            self._watchdog.start(now + WATCHDOG_NS)

    def _sample(self) -> None:
        """Sample the sensors, as the drive does when it receives a command."""
        self._latched = self._sampler.latch(self._clock.now_ns())

    def _target(self, motor_rad: float, torque_N_m: float = 0.0) -> None:
        """Follow a target and add a torque at the motor; the drive reaches the target after the
        time since the last target, in whole milliseconds.
        """
        now = self._clock.now_ns()
        step_ns = min(max(round((now - self._fed_ns) / _MS), 1) * _MS, _LONGEST_STEP_NS)
        self._fed_ns = now
        self._sample()
        if not self.powered:
            return
        reach = self._speed_rad_s * self._counts_per_rad * step_ns * 1e-9
        wanted = motor_rad * self._counts_per_rad
        self._demand = min(max(wanted, self._demand - reach), self._demand + reach)
        self._machine.track(self._demand, step_ns)
        self._machine.feed(torque_N_m / self._machine.constants.motor.torque_constant_N_m_A)

    def _reading(self) -> Reading:
        """Return the reading that was taken at the last command, or a new reading if the last
        command is too old.
        """
        now = self._clock.now_ns()
        return self._latched if now - self._fed_ns < _IDLE_NS else self._sampler.peek(now)

    def _motor_rad(self, reading: Reading) -> float:
        return reading.motor_counts / self._counts_per_rad

    def _check_watchdog(self) -> None:
        due = self._fed_ns + WATCHDOG_NS
        if not self.powered:
            return
        if due > self._clock.now_ns():
            self._watchdog.start(due)
        else:
            self.fail(self.lost_code)
