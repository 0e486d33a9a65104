"""Simulated CiA 402 servo drive: speaks the CANopen protocol and moves the simulated machine."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from drivers.clock import NS, SimulatedClock
from drivers.epos.frames import (
    ERROR,
    NMT,
    OBJECT,
    SEGMENT_BYTES,
    TOGGLE,
    TOTAL,
    FrameDecoder,
    Opcode,
    encode,
    segment,
)
from drivers.mock.canopen import dictionary as od
from drivers.mock.canopen.dictionary import (
    OUT_OF_RANGE,
    WRONG_LENGTH,
    SdoAbortError,
    clamp_i16,
    key,
)
from drivers.mock.canopen.node import COMMUNICATION, PROFILE, Nmt, SimulatedNode
from drivers.mock.plant.machine import DrivenMachine, Reading
from drivers.mock.power_state import FAULT_RESET, POWERED, TRANSITIONS, Command, State, command
from drivers.mock.sampler import Sampler, encoder_resolution
from drivers.mock.traits import DRIVE_EDS as DRIVE_EDS
from drivers.mock.traits import OwnObjects, Traits
from drivers.mock.wires.bus import SimulatedBus, Timer

HM: Final = 6
METHODS: Final = (17, 18, 35, 37)  # homing methods that object 60E3h lists
REACHED: Final = 0x0400
ATTAINED: Final = 0x1000
HOMING_ERROR: Final = 0x2000  # bits of the statusword in homing mode
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
"""Lag from which the joint counts as blocked, deg; at most half of the error limit."""


def check_method(_subindex: int, value: int) -> None:
    """Refuse a homing method that the drive does not have."""
    if value not in METHODS:
        raise SdoAbortError(OUT_OF_RANGE)


class Homing:
    """Homing of the simulated drive: moves the machine to a switch, and sets the zero of the
    drive's position.

    The limit switches are closed where the true joint angle is beyond them.

    Attributes:
        shift: Drive position less the motor's counts.
        switches_deg: Joint angles of the limit switches, or None for switches that never close.
        endless: Whether a homing never ends.
        jammed: Whether the motor has too little torque to move the joint, as with a jammed joint.
    """

    def __init__(self, mover: Mover) -> None:
        self.shift = 0
        self.switches_deg: tuple[float, float] | None = (-20.0, 20.0)
        self.endless = self.jammed = False
        self._mover = mover
        self._sampler, self._clock, self._values = mover.sampler, mover.clock, mover.values
        self._timer = Timer(mover.clock, self._advance)
        self._bits = REACHED
        self._word = 0
        self._demand = self._speed = 0.0
        self._found = self._home = False

    @property
    def flags(self) -> int:
        """Bits of the statusword."""
        return self._bits

    def begin(self, counts: int) -> None:
        """Hold the position; the homing starts at a rising edge of bit 4."""
        self._bits = REACHED
        self._word = self._values[_CONTROLWORD]
        self._demand, self._speed = float(counts), 0.0

    def stop(self) -> None:
        """End the motion, because the power is switched off or the drive brakes."""
        self._timer.stop()

    def obey(self) -> None:
        """Start at a rising edge of bit 4 of the controlword, interrupt at a falling edge."""
        word = self._values[_CONTROLWORD]
        rising, falling = word & ~self._word & _START, ~word & self._word & _START
        self._word = word
        if falling and not self._bits & (ATTAINED | HOMING_ERROR):
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
        """Take one step: to the switch, then slowly away from it; its edge is the home position."""
        now = self._clock.now_ns()
        self._sampler.advance(now)
        reading = self._sampler.peek(now)
        if abs(reading.following_error_counts) > self._blocked():
            self._demand = float(reading.motor_counts)
            self._halt(REACHED | HOMING_ERROR)
            return
        side = -1 if self._values[_METHOD] == 17 else 1
        closed = self._closed(side)
        if closed and not self._found:
            self._found = True
        elif self._found and not closed and not self._home and not self.endless:
            self._home = True
            self._set_zero(reading.motor_counts)
        speed = -self._values[_ZERO] if self._found else self._values[_SEARCH]
        wanted = 0.0 if self._home else side * speed * self._mover.speed_unit
        change = self._values[_ACCELERATION] * self._mover.acceleration_unit * _STEP_NS / NS
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
        counts = math.radians(_BLOCKED_DEG) * self._mover.gear * self._mover.counts_per_rad
        return min(counts, 0.5 * self._values[_WINDOW])


PP, CSP, CSV, CST = 1, 8, 9, 10  # modes of operation
_MODE: Final = key(0x6060)

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
    """Commands the machine according to the mode and the targets in the dictionary."""

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
        self.sampler = sampler
        self._machine: DrivenMachine = sampler.machine
        self.clock = clock
        self.values = values
        self.counts_per_rad = counts_per_rad
        self.speed_unit, self.acceleration_unit = speed_unit, acceleration_unit
        self._current_A = current_A
        self.gear = self._machine.constants.motor.gear_ratio
        self.homing = Homing(self)  # homing of the drive, and the zero that the last homing has set
        self._profile = Timer(clock, self._advance_profile)
        self._speed = 0.0
        self._goal = 0.0
        self._word = 0

    @property
    def positions(self) -> bool:
        """Whether the drive closes its position loop, so that it has a following error."""
        return self.values[_MODE] not in (CSV, CST)

    @property
    def flags(self) -> int:
        """Bits of the statusword that depend on the mode, while the drive operates."""
        mode = self.values[_MODE]
        if mode == HM:
            return self.homing.flags
        follows = mode in (CSP, CSV, CST) or (mode == PP and self.acknowledged)
        return _BIT_12 if follows else 0

    def start(self, counts: int) -> None:
        """Start at a position in motor counts, when the power is switched on."""
        self.demand = self._goal = float(counts)
        self._speed = 0.0
        self.acknowledged = False
        self._word = self.values[_CONTROLWORD]
        mode = self.values[_MODE]
        self._machine.control(position=self.positions, speed=mode != CST)
        if mode == PP:
            self._profile.start(self.clock.now_ns() + _PROFILE_NS)
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
        }.get(self.values[_MODE])
        return move is not None and move(period_ns)

    def _clamped(self) -> float:
        """Return the target within its limits, in the motor's counts."""
        values = self.values
        target = min(max(values[_TARGET], values[_TARGET_MIN]), values[_TARGET_MAX])
        return float(target - self.homing.shift)

    def _position(self, period_ns: int) -> bool:
        values, target = self.values, self._clamped()
        reach = values[_MAX_SPEED] * self.speed_unit * period_ns / NS
        step = target - self.demand
        if step > reach or step < -reach:
            target = self.demand + math.copysign(reach, step)
        self.demand = target
        self._machine.track(target, period_ns)
        self._machine.feed(values[_TORQUE_OFFSET] * self._current_A)
        return target + self.homing.shift != values[_TARGET]

    def _spin(self, _period_ns: int) -> bool:
        values = self.values
        speed = min(max(values[_TARGET_SPEED], -values[_MAX_SPEED]), values[_MAX_SPEED])
        self._machine.spin(speed * self.speed_unit / self.counts_per_rad / self.gear)
        return speed != values[_TARGET_SPEED]

    def _push(self, _period_ns: int) -> bool:
        values = self.values
        torque = values[_TARGET_TORQUE]
        motor_rad_s = self.sampler.peek(self.clock.now_ns()).motor_velocity_rad_s
        speed = motor_rad_s * self.counts_per_rad / self.speed_unit
        if abs(speed) > values[_MAX_SPEED] and torque * speed > 0.0:
            torque = 0
        self._machine.feed(torque * self._current_A)
        return torque != values[_TARGET_TORQUE]

    def _set_point(self, _period_ns: int) -> bool:
        word = self.values[_CONTROLWORD]
        if word & ~self._word & _NEW:
            self._goal = self._clamped()
            self.acknowledged = True
        elif not word & _NEW:
            self.acknowledged = False
        self._word = word
        goal = self._goal + self.homing.shift
        return goal != self.values[_TARGET] and self.acknowledged

    def _home(self, _period_ns: int) -> bool:
        self.homing.obey()
        return False

    def _advance_profile(self) -> None:
        """Take one step of a profile with constant accelerations to the set-point."""
        self.sampler.advance(self.clock.now_ns())
        values, dt = self.values, _PROFILE_NS / NS
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
        self._profile.start(self.clock.now_ns() + _PROFILE_NS)


FOLLOWING_ERROR: Final = 0x8611
CONNECTION_LOST: Final = 0x8100

_VOLTAGE: Final = key(0x2100)
_TEMPERATURE: Final = key(0x2101)
_ON_ABORT: Final = key(0x6007)
_ERROR_CODE: Final = key(0x603F)

_STATUSWORD: Final = key(0x6041)

_MODE_DISPLAY: Final = key(0x6061)
_POSITION: Final = key(0x6064)

_VELOCITY: Final = key(0x606C)
_MAX_TORQUE: Final = key(0x6072)
_MAX_CURRENT: Final = key(0x6073)
_TORQUE: Final = key(0x6077)
_CURRENT: Final = key(0x6078)
_DC_LINK: Final = key(0x6079)
_FOLLOWING: Final = key(0x60F4)

_WINDOW_OFF: Final = 0xFFFFFFFF
_NO_LIMIT: Final = 0xFFFFFFFF  # value of 607Fh in a drive whose speed is not limited
_VOLTAGE_ENABLED: Final = 0x0010
_REMOTE: Final = 0x0200
_TARGET_REACHED: Final = 0x0400
_INTERNAL_LIMIT: Final = 0x0800
_FOLLOWING_ERROR_BIT: Final = 0x2000
_RAMP_SETTLE_NS: Final = 20_000_000
_MS: Final = 1_000_000
_LONGEST_PERIOD: Final = 20
"""Greatest time between targets for a drive that measures this time to interpolate, ms."""
_WHOLE: Final = 1e-6  # tolerance, in units, for a value that should be a whole number of units
_AT_LIMIT: Final = 0.98
"""Ratio of mean current to limit from which the current counts as limited; it has noise."""


@dataclass(frozen=True)
class Rating:
    """Rated values of the drive; it reports current and torque in thousandths of these values."""

    current_A: float = 15.0  # rated motor current (6075h)
    # Rated motor torque (6076h), or None for the torque at the rated current.
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
        self.traits = traits or Traits()  # differences of this drive from other drives
        self._own = OwnObjects(self.traits)
        self._own.add_to(self.objects)
        self.remote_frames = self.traits.remote_frames
        self.power_state = State.SWITCH_ON_DISABLED  # state of the power drive system
        # Function that is called with each new state at the time of the change.
        self.entered: list[Callable[[State], None]] = []
        self.current_sign = 1  # sign of 6077h and 6078h for a torque that increases the position
        self.deaf_to: frozenset[Command] = frozenset()  # orders that the drive ignores
        self._sampler = sampler
        self._machine = sampler.machine
        self._motor = self._machine.constants.motor
        self._increments, self._revolutions = encoder_resolution(self._machine.constants)
        counts_per_turn = self._increments / self._revolutions
        self._counts_per_rad = counts_per_turn / (2.0 * math.pi)
        # Counts per second of one unit of 606Ch and 607Fh; see `use_speed_unit`.
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
        # Homing of the drive, and the zero that the last homing has set.
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
        objects.written[0x6040] = lambda _sub, _value: self.act()
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
        """Return the current limit of the loops in thousandths, rounded up."""
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


UNKNOWN_COMMAND: Final = 0x0F00FFBF
WRONG_NODE: Final = 0x0F00FFB9
_BAD_TOGGLE: Final = 0x05030000
_EPOS_SERIAL_TARGET: Final = 0x607A
_MEANS: Final = (0x6077, 0x6078)  # torque and current, which are means since the last read
_EPOS_SERIAL_VOLTAGE: Final = 0x2100
_SUPERVISION_NS: Final = 1_000_000
_VALUE_BYTES: Final = 4
_CONTROL: Final = struct.Struct("B")


class SimulatedEposPort:
    """Answers requests from the drive's dictionary; a
    :class:`~drivers.mock.wires.serial_line.Station`.

    There is no SYNC on the serial line: a target takes effect when it is written, values are
    sampled when they are read, and the drive checks its following error every millisecond. Current
    and voltage are means between two reads of the current.
    """

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock, drive: SimulatedDrive) -> None:
        self._drive = drive
        self._objects = drive.objects
        self._clock = clock
        self._gateway = bus.attach()
        self._decoder = FrameDecoder()
        self._supervision = Timer(clock, self._supervise)
        own = (shown.address[0] for shown in drive.traits.own if shown.quantity == "current_A")
        self._means = {*_MEANS, *own}
        self._voltage = bytes(2)
        self._upload = b""
        self._toggle = 0
        self._services: Mapping[int, Callable[[bytes], bytes]] = {
            Opcode.READ_OBJECT: self._read_object,
            Opcode.WRITE_OBJECT: self._write_object,
            Opcode.INITIATE_SEGMENTED_READ: self._start_upload,
            Opcode.SEGMENT_READ: self._continue_upload,
            Opcode.SEND_NMT: self._send_nmt,
        }
        drive.entered.append(self._entered)

    def receive(self, data: bytes) -> bytes:
        """Return the answers to the valid frames that ``data`` completes."""
        return b"".join(
            encode(Opcode.ANSWER, self._answer(*frame)) for frame in self._decoder.feed(data)
        )

    def _answer(self, opcode: int, fields: bytes) -> bytes:
        service = self._services.get(opcode)
        try:
            if service is None:
                raise SdoAbortError(UNKNOWN_COMMAND)
            return ERROR.pack(0) + service(fields)
        except SdoAbortError as refusal:
            return ERROR.pack(refusal.code)
        except struct.error:
            return ERROR.pack(WRONG_LENGTH)

    def _read_object(self, fields: bytes) -> bytes:
        return self._read(*self._address(fields))[:_VALUE_BYTES].ljust(_VALUE_BYTES, b"\0")

    def _write_object(self, fields: bytes) -> bytes:
        index, subindex = self._address(fields)
        size = self._objects.entry(index, subindex).size
        self._write(index, subindex, fields[OBJECT.size :][: size or _VALUE_BYTES])
        return b""

    def _start_upload(self, fields: bytes) -> bytes:
        data = self._read(*self._address(fields))
        first, self._upload = data[: SEGMENT_BYTES - 1], data[SEGMENT_BYTES - 1 :]
        self._toggle = 0
        return TOTAL.pack(len(data)) + bytes([len(first)]) + first

    def _continue_upload(self, fields: bytes) -> bytes:
        (control,) = _CONTROL.unpack_from(fields)
        self._expect_toggle(control)
        chunk, self._upload = self._upload[: SEGMENT_BYTES - 1], self._upload[SEGMENT_BYTES - 1 :]
        answer = segment(chunk, self._toggle, not self._upload)
        self._toggle ^= TOGGLE
        return answer

    def _send_nmt(self, fields: bytes) -> bytes:
        node, command = NMT.unpack_from(fields)
        self._gateway.send(0x000, bytes([command & 0xFF, node & 0xFF]))
        return b""

    def _expect_toggle(self, control: int) -> None:
        if control & TOGGLE != self._toggle:
            raise SdoAbortError(_BAD_TOGGLE)

    def _address(self, fields: bytes) -> tuple[int, int]:
        node, index, subindex = OBJECT.unpack_from(fields)
        if node not in (0, self._drive.node_id):
            raise SdoAbortError(WRONG_NODE)
        return index, subindex

    def _read(self, index: int, subindex: int) -> bytes:
        if index in self._means:
            self._drive.latch()
            if key(_EPOS_SERIAL_VOLTAGE) in self._objects.entries:
                self._voltage = self._objects.read(_EPOS_SERIAL_VOLTAGE, 0)
        elif index == _EPOS_SERIAL_VOLTAGE and subindex == 0:
            return self._voltage
        else:
            self._drive.refresh()
        return self._objects.read(index, subindex)

    def _write(self, index: int, subindex: int, data: bytes) -> None:
        self._objects.write(index, subindex, data)
        if index == _EPOS_SERIAL_TARGET:
            self._drive.act()

    def _entered(self, state: State) -> None:
        if state in POWERED:
            self._supervision.start(self._clock.now_ns() + _SUPERVISION_NS)
        else:
            self._supervision.stop()

    def _supervise(self) -> None:
        self._supervision.start(self._clock.now_ns() + _SUPERVISION_NS)
        self._drive.supervise()
