"""Simulated servo drive with its own CAN frames (``dbc_drive.dbc``), states and watchdog.

The drive does not use CANopen. This module packs frames with its own code, not with the codec under
test, because otherwise drive and codec would have the same errors, and tests would not detect them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from enum import IntEnum
from pathlib import Path
from typing import Final

from drivers.clock import SimulatedClock
from drivers.dbc.codec import crc8_j1850
from drivers.mock.plant.machine import Reading
from drivers.mock.sampler import Sampler, encoder_resolution
from drivers.mock.wires.bus import SimulatedBus, Timer

DRIVE_DBC: Final = Path(__file__).with_name("dbc_drive.dbc")
STOP, COMMAND, LIMITS = 0x010, 0x110, 0x120
MOTION, POWER, STATUS, INFO, LIMITS_HELD = 0x190, 0x191, 0x1A0, 0x1B0, 0x1B1  # CAN identifiers

STOP_CODE: Final = 0xA5
COMMAND_LOST: Final = 0x11
FOLLOWING_ERROR: Final = 0x21
SERIAL_NUMBER: Final = 20417
FIRMWARE: Final = 0x0203

WATCHDOG_NS: Final = 100_000_000
DECELERATION_RAD_S2: Final = math.radians(2000.0)

COMMISSIONED: Final = struct.pack("<hhI", -900, 900, 2400 | 840 << 12 | 600 << 22)
"""``DRV_Limits`` after power-on: 9 motor turns, 240 rad/s, 25.2 A, 0.6 turns of error."""

_LIMIT_TURNS: Final = 0.01
_LIMIT_SPEED_RAD_S: Final = 0.1
_LIMIT_CURRENT_A: Final = 0.03
_LIMIT_ERROR_TURNS: Final = 0.001
_MS: Final = 1_000_000
_IDLE_NS: Final = 20_000_000
_STATUS_NS: Final = 100_000_000
_INFO_NS: Final = 200_000_000
_RAMP_SETTLE_NS: Final = 20_000_000
_LONGEST_STEP_NS: Final = 20_000_000
_CURRENT_A: Final = 0.015
_VELOCITY_RAD_S: Final = 0.01
_VOLTAGE_V: Final = 0.01
_TEMPERATURE_C: Final = 0.5
_COLDEST_C: Final = -40.0
_COUNTS_PER_TURN: Final = 4096


class State(IntEnum):
    """States of the drive, with the values of the signal ``State``."""

    OFF = 0
    READY = 1
    RUN = 2
    STOPPING = 3
    BRAKING = 4
    FAULT = 5


class Order(IntEnum):
    """Orders to the drive, with the values of the signal ``Order``."""

    OFF = 0
    READY = 1
    RUN = 2
    STOP = 3
    RESET = 4


TRANSITIONS: Final[Mapping[tuple[State, Order], State]] = {
    (State.OFF, Order.READY): State.READY,
    (State.READY, Order.RUN): State.RUN,
    (State.READY, Order.OFF): State.OFF,
    (State.READY, Order.STOP): State.OFF,
    (State.RUN, Order.READY): State.READY,
    (State.RUN, Order.OFF): State.OFF,
    (State.RUN, Order.STOP): State.STOPPING,
    (State.STOPPING, Order.OFF): State.OFF,
    (State.BRAKING, Order.OFF): State.FAULT,
    (State.FAULT, Order.RESET): State.OFF,
}
"""State transitions; a pair that is absent changes nothing."""

POWERED: Final = frozenset({State.RUN, State.STOPPING, State.BRAKING})
"""States in which the power stage is on."""


class DbcDrive:
    """The drive. Each command makes it sample its sensors, execute, and answer with two frames."""

    def __init__(
        self, bus: SimulatedBus, clock: SimulatedClock, sampler: Sampler, clock_offset_us: int = 0
    ) -> None:
        self.state = State.OFF  # state of the drive
        self.fault_code = 0  # cause of the fault; 0 without fault
        # Function that is called with each new state at the time of the change.
        self.entered: list[Callable[[State], None]] = []
        self.deaf_to: frozenset[Order] = frozenset()  # orders that the drive ignores
        self.locked = False  # whether the drive refuses to change its limits
        self.counting = True  # whether the life counters of the drive advance
        self._clock = clock
        self._clock_offset_us = clock_offset_us
        self._sampler = sampler
        self._machine = sampler.machine
        increments, turns = encoder_resolution(self._machine.constants)
        self._counts_per_turn = increments / turns
        self.limits = COMMISSIONED  # limits of the drive, in the order of `DRV_Limits`
        self._take_limits(COMMISSIONED)
        self._reading: Reading = sampler.peek(clock.now_ns())
        self._order = Order.OFF
        self._demand = 0.0
        self._heard_life = -1
        self._commanded_ns = -_LONGEST_STEP_NS
        self._told_ns = 0
        self._waiting: list[Callable[[], None]] = []
        self._life = {MOTION: 0, POWER: 0, STATUS: 0}
        self._ramp = Timer(clock, self._ramp_done)
        self._watchdog = Timer(clock, self._check_watchdog)
        self._idle = Timer(clock, self._tell_when_idle)
        self._status = Timer(clock, self._tell_status)
        self._info = Timer(clock, self._tell_info)
        self._port = bus.attach()

    def boot(self) -> None:
        """Start receiving and sending, as after power-on."""
        self._port.listen(COMMAND, self._on_command)
        self._port.listen(STOP, self._on_stop)
        self._port.listen(LIMITS, self._on_limits)
        self._tell_when_idle()
        self._tell_status()
        self._tell_info()

    def restart(self) -> None:
        """Restart, as after a short failure of the supply."""
        self._enter(State.OFF)
        self.fault_code = 0
        self._order, self._heard_life = Order.OFF, -1
        self._life = dict.fromkeys(self._life, 0)
        self._take_limits(COMMISSIONED)

    def fail(self, code: int) -> None:
        """Go into fault with the fault code of an internal cause."""
        self.fault_code = code
        if self.state in POWERED:
            self._enter(State.BRAKING)
        else:
            self._enter(State.FAULT)
        self._send_status()
        self._tell()

    def _on_command(self, data: bytes) -> None:
        if len(data) != 8 or crc8_j1850(data[:7] + b"\0") != data[7]:
            return
        life = data[0] >> 4
        if life == self._heard_life or data[0] & 0x0F not in tuple(Order):
            return
        self._heard_life = life
        now = self._clock.now_ns()
        # The time is rounded to whole milliseconds, so that a command that was delayed by another
        # frame does not make the motion uneven.
        step_ns = min(max(round((now - self._commanded_ns) / _MS), 1) * _MS, _LONGEST_STEP_NS)
        self._commanded_ns = now
        self._reading = self._sampler.latch(now)
        self._watch_following()
        self._obey(Order(data[0] & 0x0F))
        if self.state is State.RUN:
            self._follow(struct.unpack_from("<i", data, 1)[0], step_ns)
        self._tell()
        self._tell_power()
        waiting, self._waiting = self._waiting, []
        for send in waiting:
            send()

    def _on_stop(self, data: bytes) -> None:
        if data != bytes([STOP_CODE]):
            return
        if self.state is State.RUN:
            self._enter(State.STOPPING)
        elif self.state is State.READY:
            self._enter(State.OFF)
        self._tell()

    def _on_limits(self, data: bytes) -> None:
        if len(data) == 8 and self.state not in POWERED and not self.locked:
            self._take_limits(data)
        self._port.send(LIMITS_HELD, self.limits)

    def _take_limits(self, data: bytes) -> None:
        self.limits = data
        low, high, rest = struct.unpack("<hhI", data)
        turns = self._counts_per_turn
        self._low, self._high = low * _LIMIT_TURNS * turns, high * _LIMIT_TURNS * turns
        self._speed = (rest & 0xFFF) * _LIMIT_SPEED_RAD_S / math.tau * turns * 1e-9
        self._window = (rest >> 22) * _LIMIT_ERROR_TURNS * turns
        self._machine.limit_current((rest >> 12 & 0x3FF) * _LIMIT_CURRENT_A)

    def _obey(self, order: Order) -> None:
        first, self._order = order is not self._order, order
        following = None if order in self.deaf_to else TRANSITIONS.get((self.state, order))
        if following is None or (order is Order.RESET and not first):
            return
        if order is Order.RESET:
            self.fault_code = 0
            self._send_status()
        self._enter(following)

    def _enter(self, state: State) -> None:
        self._ramp.stop()
        now = self._clock.now_ns()
        self._sampler.advance(now)
        was, self.state = self.state, state
        for told in self.entered:
            told(state)
        if was is State.OFF:
            self._watchdog.start(now + WATCHDOG_NS)
        if state is State.RUN:
            self._machine.power(True)
            self._demand = float(self._sampler.peek(now).motor_counts)
        elif state in POWERED:
            self._brake()
        else:
            self._machine.power(False)

    def _brake(self) -> None:
        now = self._clock.now_ns()
        joint_rad_s = (
            self._sampler.peek(now).motor_velocity_rad_s / self._machine.constants.motor.gear_ratio
        )
        self._machine.brake(DECELERATION_RAD_S2)
        self._ramp.start(
            now + round(abs(joint_rad_s) / DECELERATION_RAD_S2 * 1e9) + _RAMP_SETTLE_NS
        )

    def _ramp_done(self) -> None:
        self._enter(State.FAULT if self.state is State.BRAKING else State.OFF)
        self._tell()

    def _follow(self, raw: int, step_ns: int) -> None:
        target = min(max(raw * self._counts_per_turn / _COUNTS_PER_TURN, self._low), self._high)
        reach = self._speed * step_ns
        self._demand = min(max(target, self._demand - reach), self._demand + reach)
        self._machine.track(self._demand, step_ns)

    def _watch_following(self) -> None:
        if self.state is State.RUN and abs(self._reading.following_error_counts) > self._window:
            self.fail(FOLLOWING_ERROR)

    def _check_watchdog(self) -> None:
        if self.state in (State.OFF, State.FAULT):
            return
        due = self._commanded_ns + WATCHDOG_NS
        if due > self._clock.now_ns():
            self._watchdog.start(due)
        elif self.state is State.READY:
            self._enter(State.OFF)
        elif self.state is State.RUN:
            self.fail(COMMAND_LOST)

    def _tell(self) -> None:
        now = self._clock.now_ns()
        self._told_ns = now
        reading = self._reading
        position = round(reading.motor_counts * _COUNTS_PER_TURN / self._counts_per_turn)
        current = _int16(reading.current_A / _CURRENT_A)
        body = struct.pack("<ihBx", position, current, self.state | self._next_life(MOTION) << 4)
        self._port.send(MOTION, body[:7] + bytes([crc8_j1850(body)]))

    def _tell_power(self) -> None:
        reading = self._reading
        velocity = _int16(reading.motor_velocity_rad_s / _VELOCITY_RAD_S)
        voltage = _int16(reading.voltage_V / _VOLTAGE_V)
        time = (self._sampler.time_ns // 1000 + self._clock_offset_us) // 10 & 0xFFFFFF
        self._port.send(
            POWER, struct.pack(">hhI", velocity, voltage, time << 8 | self._next_life(POWER) << 4)
        )

    def _tell_when_idle(self) -> None:
        now = self._clock.now_ns()
        if now - self._told_ns >= _IDLE_NS:
            self._reading = self._sampler.peek(now)
            self._tell()
        self._idle.start(self._told_ns + _IDLE_NS)

    def _tell_status(self) -> None:
        self._in_turn(self._send_status)
        self._status.start(self._clock.now_ns() + _STATUS_NS)

    def _tell_info(self) -> None:
        self._in_turn(self._send_info)
        self._info.start(self._clock.now_ns() + _INFO_NS)

    def _in_turn(self, send: Callable[[], None]) -> None:
        """Send a frame at once, or after the next answer while commands arrive."""
        if self._clock.now_ns() - self._commanded_ns < _IDLE_NS:
            self._waiting.append(send)
        else:
            send()

    def _send_status(self) -> None:
        supply = round(self._reading.supply_V * 1e2)
        temperature = round((self._reading.temperature_C - _COLDEST_C) / _TEMPERATURE_C)
        body = struct.pack(
            ">HBBBx", supply, temperature, self.fault_code, self._next_life(STATUS) << 4
        )
        self._port.send(STATUS, body[:5] + bytes([crc8_j1850(body)]))

    def _send_info(self) -> None:
        self._port.send(INFO, struct.pack("<IH", SERIAL_NUMBER, FIRMWARE))
        self._port.send(LIMITS_HELD, self.limits)

    def _next_life(self, message: int) -> int:
        self._life[message] = life = self._life[message] + self.counting & 0x0F
        return life


def _int16(value: float) -> int:
    return min(max(round(value), -0x8000), 0x7FFF)
