"""Simulated CiA 402 servo drive: speaks the CANopen protocol and moves the simulated machine."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final

from drivers.clock import SimulatedClock
from drivers.mock.canopen import dictionary as od
from drivers.mock.canopen.dictionary import SdoAbortError, clamp_i16, key
from drivers.mock.canopen.node import COMMUNICATION, PROFILE, Nmt, SimulatedNode
from drivers.mock.drive_homing import HM, check_method
from drivers.mock.drive_modes import CST, CSV, PP, Mover
from drivers.mock.plant.machine import Reading
from drivers.mock.power_state import FAULT_RESET, POWERED, TRANSITIONS, Command, State, command
from drivers.mock.resolution import encoder_resolution
from drivers.mock.sampler import Sampler
from drivers.mock.traits import OwnObjects, Traits
from drivers.mock.wires.bus import SimulatedBus
from drivers.mock.wires.timer import Timer

DRIVE_EDS: Final = Path(__file__).with_name("drive.eds")
FOLLOWING_ERROR: Final = 0x8611
CONNECTION_LOST: Final = 0x8100

_VOLTAGE: Final = key(0x2100)
_TEMPERATURE: Final = key(0x2101)
_ON_ABORT: Final = key(0x6007)
_ERROR_CODE: Final = key(0x603F)
_CONTROLWORD: Final = key(0x6040)
_STATUSWORD: Final = key(0x6041)
_MODE: Final = key(0x6060)
_MODE_DISPLAY: Final = key(0x6061)
_POSITION: Final = key(0x6064)
_WINDOW: Final = key(0x6065)
_VELOCITY: Final = key(0x606C)
_MAX_TORQUE: Final = key(0x6072)
_MAX_CURRENT: Final = key(0x6073)
_TORQUE: Final = key(0x6077)
_CURRENT: Final = key(0x6078)
_DC_LINK: Final = key(0x6079)
_FOLLOWING: Final = key(0x60F4)

_WINDOW_OFF: Final = 0xFFFFFFFF
_NO_LIMIT: Final = 0xFFFFFFFF
"""Value of 607Fh in a drive whose speed is not limited."""
_VOLTAGE_ENABLED: Final = 0x0010
_REMOTE: Final = 0x0200
_TARGET_REACHED: Final = 0x0400
_INTERNAL_LIMIT: Final = 0x0800
_FOLLOWING_ERROR_BIT: Final = 0x2000
_RAMP_SETTLE_NS: Final = 20_000_000
_MS: Final = 1_000_000
_LONGEST_PERIOD: Final = 20
"""Greatest time between targets for a drive that measures this time to interpolate, ms."""
_WHOLE: Final = 1e-6
"""Tolerance, in units, for a value that should be a whole number of units."""
_AT_LIMIT: Final = 0.98
"""Ratio of the mean current to its limit from which the current counts as limited; less than 1,
because the measured mean contains noise.
"""


@dataclass(frozen=True)
class Rating:
    """Rated values of the drive; its units of current and torque are thousandths of the rated
    values.

    Attributes:
        current_A: Rated motor current (6075h).
        torque_N_m: Rated motor torque (6076h), or None for the torque at the rated current.
    """

    current_A: float = 15.0
    torque_N_m: float | None = None


class QuickStop(IntEnum):
    """Values of 605Ah: kind of the stop, and whether the drive stays in QUICK STOP ACTIVE."""

    DISABLE = 0
    SLOW_DOWN = 1
    RAMP = 2
    SLOW_DOWN_AND_STAY = 5
    RAMP_AND_STAY = 6


class SimulatedDrive(SimulatedNode):
    """A simulated servo, in cyclic synchronous position mode unless ``traits`` offer others.

    Positions are motor encoder counts; speeds and accelerations are counts per second (squared)
    unless ``traits`` say otherwise; 6078h is the mean current since the last SYNC, per
    mille of 6075h. 60B2h (per mille of 6076h) adds torque to the position loop's output while
    targets are followed, but not in ramps. The power stage is on only in the states of
    :data:`POWERED`.

    Attributes:
        traits: Differences of this drive from other drives.
        power_state: State of the power drive system.
        entered: Function that is called with each new state at the time of the change.
        speed_unit: Counts per second of one unit of 606Ch and 607Fh; see :meth:`use_speed_unit`.
        deaf_to: Orders that the drive ignores.
        homing: Homing of the drive, and the zero that the last homing has set.
        current_sign: Sign of 6077h and 6078h for a torque that increases the position.
    """

    def __init__(
        self,
        bus: SimulatedBus,
        clock: SimulatedClock,
        node_id: int,
        sampler: Sampler,
        clock_offset_us: int = 0,
        rating: Rating | None = None,
        traits: Traits | None = None,
    ) -> None:
        super().__init__(bus, clock, node_id, DRIVE_EDS, clock_offset_us)
        self.traits = traits or Traits()
        self._own = OwnObjects(self.traits)
        self._own.add_to(self.objects)
        self.remote_frames = self.traits.remote_frames
        self.power_state = State.SWITCH_ON_DISABLED
        self.entered: list[Callable[[State], None]] = []
        self.current_sign = 1
        self.deaf_to: frozenset[Command] = frozenset()
        self._sampler = sampler
        self._machine = sampler.machine
        self._motor = self._machine.constants.motor
        self._increments, self._revolutions = encoder_resolution(self._machine.constants)
        counts_per_turn = self._increments / self._revolutions
        self._counts_per_rad = counts_per_turn / (2.0 * math.pi)
        self.speed_unit = self.traits.speed_unit(counts_per_turn)
        rating = rating or Rating()
        torque_constant = self._motor.torque_constant_N_m_A
        self._rated_current_mA = round(rating.current_A * 1e3)
        torque = rating.torque_N_m or torque_constant * rating.current_A
        self._rated_torque = round(torque / self.traits.rated_torque_unit_N_m)
        self._per_mille_A = 1e6 / self._rated_current_mA
        self._per_mille_torque_A = 1e3 * torque_constant / torque
        self._ramp = Timer(clock, self._ramp_done)
        self._last_word = 0
        self._mover = Mover(
            sampler,
            clock,
            self._values,
            self._counts_per_rad,
            self.speed_unit,
            self.traits.acceleration_unit(counts_per_turn),
            1.0 / self._per_mille_torque_A,
        )
        self.homing = self._mover.homing
        self._period_ns = _MS
        # A drive without 60C2h measures the time between targets.
        self._told_period = key(0x60C2, 1) in self.objects.entries
        self._followed_ns = 0
        self._flags, objects = 0, self.objects
        objects.checks[0x6060] = self._check_mode
        objects.checks[0x605A] = _check_quick_stop
        objects.checks[0x6098] = check_method
        objects.checks[0x60C2] = self._check_disabled
        objects.written[0x6060] = lambda _sub, value: self._values.__setitem__(_MODE_DISPLAY, value)
        objects.written[0x60C2] = lambda _sub, _value: self._read_period()
        objects.written[0x6072] = objects.written[0x6073] = lambda _sub, _value: (
            self._limit_current()
        )
        objects.written[0x6040] = lambda _sub, _value: self._outputs()
        self.restore()

    def restore(self) -> None:
        """Return to SWITCH ON DISABLED, and store this machine's constants in the dictionary."""
        values = self._values
        values[key(0x6075)] = self._rated_current_mA
        values[key(0x6076)] = self._rated_torque
        if _ON_ABORT not in self.objects.entries:
            values[_ON_ABORT] = 0  # a drive without 6007h does not react to a lost master
        self._own.restore(values, self._rated_current_mA * 1e-3)
        for index in (0x6084, 0x6085):
            values[key(index)] = round(values[key(index)] / self._mover.acceleration_unit)
        values[key(0x608F, 1)], values[key(0x608F, 2)] = self._increments, self._revolutions
        values[_MAX_CURRENT] = self._greatest(self._per_mille_A)
        values[_MAX_TORQUE] = self._greatest(self._per_mille_torque_A)
        self._limit_current()
        self._last_word = self._flags = self.homing.shift = 0
        self._read_period()
        self._enter(State.SWITCH_ON_DISABLED)

    def use_speed_unit(self, counts_per_s: float) -> None:
        """From now on, report and accept speeds in another unit, as drives of some makes do."""
        values = self._values
        for address in (key(0x607F), key(0x6084), key(0x6085)):
            if values[address] != _NO_LIMIT:
                values[address] = round(values[address] * self.speed_unit / counts_per_s)
        self._mover.acceleration_unit *= counts_per_s / self.speed_unit
        self.speed_unit = self._mover.speed_unit = counts_per_s

    def halt(self) -> None:
        """Switch the power off immediately."""
        self._enter(State.SWITCH_ON_DISABLED)

    def refresh(self) -> None:
        """Update measured values without ending the averaging period."""
        self._measure(self._sampler.peek(self._clock.now_ns()))

    def latch(self) -> None:
        """Sample all values at a SYNC, end the averaging period, and check the following error."""
        reading = self._sampler.latch(self._clock.now_ns())
        self._measure(reading)
        self._watch_following(reading)

    def supervise(self) -> None:
        """Check the following error while no SYNC arrives."""
        self._watch_following(self._sampler.peek(self._clock.now_ns()))

    def _watch_following(self, reading: Reading) -> None:
        window = self._values[_WINDOW]
        if (
            window != _WINDOW_OFF
            and self.power_state is State.OPERATION_ENABLED
            and self._mover.positions
            and abs(reading.following_error_counts) > window
        ):
            self._flags |= _FOLLOWING_ERROR_BIT
            self._fault(FOLLOWING_ERROR, PROFILE)

    def act(self) -> None:
        """Execute controlword and target position."""
        word = self._values[_CONTROLWORD]
        if word != self._last_word or self.power_state is not State.OPERATION_ENABLED:
            self._obey(word)
        if self.power_state is State.OPERATION_ENABLED:
            self._follow()
        self._show_status()

    def fail(self, code: int) -> None:
        """Go into fault by an internal cause: send ``code`` by EMCY, then react by 605Eh."""
        self._fault(code, PROFILE)
        self._show_status()

    def connection_lost(self, code: int) -> None:
        """React to the loss of the master by 6007h, but not in states without power."""
        if self.power_state in (State.SWITCH_ON_DISABLED, State.FAULT_REACTION, State.FAULT):
            return
        match self._values[_ON_ABORT]:
            case 1:
                self._fault(code or CONNECTION_LOST, COMMUNICATION, announce=False)
            case 2:
                self._enter(State.SWITCH_ON_DISABLED)
            case 3 if self.power_state is not State.QUICK_STOP_ACTIVE:
                self._enter(TRANSITIONS[self.power_state, Command.QUICK_STOP])
        self._show_status()

    def _measure(self, reading: Reading) -> None:
        values = self._values
        self.stamp(self._sampler.time_ns)
        values[_POSITION] = reading.motor_counts + self.homing.shift
        speed = reading.motor_velocity_rad_s * self._counts_per_rad
        values[_VELOCITY] = round(speed / self.speed_unit)
        current = reading.current_A * self._per_mille_A
        values[_CURRENT] = clamp_i16(self.current_sign * round(current))
        torque = reading.current_A * self._per_mille_torque_A
        values[_TORQUE] = clamp_i16(self.current_sign * round(torque))
        values[_DC_LINK] = round(reading.supply_V * 1e3)
        values[_VOLTAGE] = clamp_i16(round(reading.voltage_V * 1e2))
        values[_TEMPERATURE] = round(reading.temperature_C * 1e1)
        values[_FOLLOWING] = round(reading.following_error_counts)
        self._own.measure(values, reading, self.current_sign)

    def _obey(self, word: int) -> None:
        rising = word & ~self._last_word
        self._last_word = word
        if self.power_state is State.FAULT:
            if rising & FAULT_RESET:
                self._values[_ERROR_CODE] = 0
                self._flags = 0
                self._enter(State.SWITCH_ON_DISABLED)
                self.clear_errors()
            return
        order = command(word)
        if order in self.deaf_to:
            return
        following = TRANSITIONS.get((self.power_state, order))
        if following is None:
            return
        leaves_stop = (
            self.power_state is State.QUICK_STOP_ACTIVE and order is Command.ENABLE_OPERATION
        )
        # Transition 16 exists only if the drive stays in QUICK STOP ACTIVE after the ramp.
        if not leaves_stop or self.objects.integer(0x605A) >= QuickStop.SLOW_DOWN_AND_STAY:
            self._enter(following)

    def _enter(self, state: State) -> None:
        self._ramp.stop()
        self._mover.stop()
        self._sampler.advance(self._clock.now_ns())
        was = self.power_state
        self.power_state = state
        for told in self.entered:
            told(state)
        self._flags &= ~_TARGET_REACHED
        if state is State.OPERATION_ENABLED:
            self._machine.power(True)
            self._mover.start(self._sampler.peek(self._clock.now_ns()).motor_counts)
        elif state not in POWERED:
            self._machine.power(False)
        elif state is State.QUICK_STOP_ACTIVE and was is not state:
            self._quick_stop(QuickStop(self.objects.integer(0x605A)))
        self._show_status()

    def _quick_stop(self, option: QuickStop) -> None:
        match option:
            case QuickStop.DISABLE:
                self._enter(State.SWITCH_ON_DISABLED)
            case QuickStop.SLOW_DOWN | QuickStop.SLOW_DOWN_AND_STAY:
                self._brake(self.objects.integer(0x6084))
            case QuickStop.RAMP | QuickStop.RAMP_AND_STAY:
                self._brake(self.objects.integer(0x6085))

    def _brake(self, units: int) -> None:
        deceleration = units * self._mover.acceleration_unit
        now = self._clock.now_ns()
        speed = abs(self._sampler.peek(now).motor_velocity_rad_s) * self._counts_per_rad
        self._machine.brake(deceleration / self._counts_per_rad / self._motor.gear_ratio)
        self._ramp.start(now + round(speed / deceleration * 1e9) + _RAMP_SETTLE_NS)

    def _ramp_done(self) -> None:
        if self.power_state is State.FAULT_REACTION:
            self._enter(State.FAULT)
        elif self.objects.integer(0x605A) < QuickStop.SLOW_DOWN_AND_STAY:
            self._enter(State.SWITCH_ON_DISABLED)
        else:
            self._flags |= _TARGET_REACHED
            self._show_status()
        self.announce()

    def _fault(self, code: int, register: int, announce: bool = True) -> None:
        self._values[_ERROR_CODE] = code
        if announce:
            self.emergency(code, register)
        reaction = self.objects.integer(0x605E)
        if self.power_state not in POWERED or reaction == 0:
            self._enter(State.FAULT)
            return
        self._enter(State.FAULT_REACTION)
        self._brake(self.objects.integer(0x6084 if reaction == 1 else 0x6085))

    def _follow(self) -> None:
        if not self._told_period:
            now = self._clock.now_ns()
            past = now - self._followed_ns
            self._period_ns = min(max(round(past / _MS), 1), _LONGEST_PERIOD) * _MS
            self._followed_ns = now
        limited = self._mover.follow(self._period_ns)
        greatest = _AT_LIMIT * self._current_limit * self._per_mille_A
        if limited or abs(self._values[_CURRENT]) >= greatest:
            self._flags |= _INTERNAL_LIMIT
        else:
            self._flags &= ~_INTERNAL_LIMIT

    def _show_status(self) -> None:
        word = self.power_state | self._flags | _VOLTAGE_ENABLED
        if self.state is Nmt.OPERATIONAL:
            word |= _REMOTE
        if self.power_state is State.OPERATION_ENABLED:
            word |= self._mover.flags
        self._values[_STATUSWORD] = word << 16 * (self.traits.status_share or 0)

    def _greatest(self, per_mille_A: float) -> int:
        """Return the current limit of the control loops in thousandths, rounded up to the drive's
        unit.
        """
        limit = self._machine.constants.loops.current_limit_A * per_mille_A
        return min(0xFFFF, math.ceil(limit - _WHOLE))

    def _limit_current(self) -> None:
        torque, current = self._values[_MAX_TORQUE], self._values[_MAX_CURRENT]
        self._current_limit = min(torque / self._per_mille_torque_A, current / self._per_mille_A)
        self._machine.limit_current(self._current_limit)

    def _read_period(self) -> None:
        value, exponent = self.objects.integer(0x60C2, 1), self.objects.integer(0x60C2, 2)
        self._period_ns = value * 10 ** (9 + exponent)

    def _check_mode(self, _subindex: int, value: int) -> None:
        if value and not (value > 0 and self.traits.modes >> value - 1 & 1):
            raise SdoAbortError(od.OUT_OF_RANGE)
        loops = {value, self._values[_MODE]} & {CSV, CST, PP, HM}
        if loops and self.power_state in POWERED and value != self._values[_MODE]:
            raise SdoAbortError(od.DEVICE_STATE)

    def _check_disabled(self, _subindex: int, _value: int) -> None:
        if self.power_state in POWERED:
            raise SdoAbortError(od.DEVICE_STATE)


def _check_quick_stop(_subindex: int, value: int) -> None:
    if value not in tuple(QuickStop):
        raise SdoAbortError(od.OUT_OF_RANGE)
