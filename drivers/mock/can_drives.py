"""Simulated drives with the CAN frames of known products: ODrive's CAN Simple
protocol (``odrive.dbc``, node 3) and MIT-style packed frames (``mit_motor.dbc``).

The drives pack frames with their own code, not with the codec under test. The ODrive sends its
values in answer to remote frames, and the heartbeat without a request; its messages Estop (no
data), Reboot and Clear_Errors (one byte, ignored) act by their arrival. The MIT-style motor
receives position, speed, two gains and torque in one frame of eight bytes and answers with one
frame; orders are special values of the same frame.
"""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar, Final, Literal

from drivers.can.port import REMOTE_FLAG
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
    """A drive that is off or follows a target; when power is switched off, the motor coasts."""

    lost_code: ClassVar[int]
    """Fault code after a time-out of the watchdog."""

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock, sampler: Sampler) -> None:
        self.powered = False  # whether the power stage is on
        self.fault_code = 0  # cause of the fault; 0 without a fault. In a fault the power is off.
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
        """Reach a target after the time since the last one, ms, and add a torque at the motor."""
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
        """Return the reading at the last command, or a new one if that is too old."""
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


MIT_DBC: Final = Path(__file__).with_name("mit_motor.dbc")
MIT_COMMAND, MIT_REPLY = 0x001, 0x011  # CAN identifiers

MOTOR: Final = 1
COMMUNICATION_LOST: Final = 0xD
MIT_ENTER, MIT_LEAVE, MIT_CLEAR = (b"\xff" * 7 + bytes([last]) for last in (0xFC, 0xFD, 0xFB))
_POSITION_RAD: Final = 62.5
_SPEED_RAD_S: Final = 240.0
_TORQUE_N_M: Final = 1.0
_LEAST_GAIN: Final = 1


class MitMotor(CanDrive):
    """A simulated motor, which sends nothing until it receives a frame."""

    lost_code: ClassVar[int] = COMMUNICATION_LOST

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock, sampler: Sampler) -> None:
        super().__init__(bus, clock, sampler)
        self.orders: list[bytes] = []

    def boot(self) -> None:
        """Start receiving, as after power-on."""
        self._port.listen(MIT_COMMAND, self._on_command)

    def _on_command(self, data: bytes) -> None:
        if len(data) != 8:
            return
        if data in (MIT_ENTER, MIT_LEAVE, MIT_CLEAR):
            self.orders.append(data)
            self._obey(data)
        else:
            word = int.from_bytes(data, "big")
            stiffness = word >> 24 & 0xFFF
            if stiffness >= _LEAST_GAIN:
                torque = _physical(word & 0xFFF, 12, _TORQUE_N_M)
                self._target(_physical(word >> 48, 16, _POSITION_RAD), torque)
        self._answer()

    def _obey(self, order: bytes) -> None:
        if order == MIT_CLEAR:
            self.fault_code = 0
        elif order == MIT_LEAVE:
            self._switch(False)
        elif not self.fault_code:
            self._switch(True)
        self._sample()

    def _answer(self) -> None:
        reading = self._reading()
        constant = self._machine.constants.motor.torque_constant_N_m_A
        position = _bits(self._motor_rad(reading), 16, _POSITION_RAD)
        speed = _bits(reading.motor_velocity_rad_s, 12, _SPEED_RAD_S)
        torque = _bits(reading.current_A * constant, 12, _TORQUE_N_M)
        state = self.fault_code or int(self.powered)
        heat = min(max(round(reading.temperature_C), 0), 0xFF)
        body = position << 24 | speed << 12 | torque
        self._port.send(
            MIT_REPLY, bytes([state << 4 | MOTOR]) + body.to_bytes(5, "big") + bytes([heat, heat])
        )


def _physical(bits: int, width: int, end: float) -> float:
    return 2.0 * end * bits / ((1 << width) - 1) - end


def _bits(value: float, width: int, end: float) -> int:
    top = (1 << width) - 1
    return min(max(round((value + end) * top / (2.0 * end)), 0), top)


ODRIVE_DBC: Final = Path(__file__).with_name("odrive.dbc")
_NODE: Final = 3 << 5
HEARTBEAT, ESTOP, SET_STATE, ESTIMATES = (_NODE | command for command in (0x01, 0x02, 0x07, 0x09))
SET_MODE, INPUT_POS, SET_LIMITS, IQ = (_NODE | command for command in (0x0B, 0x0C, 0x0F, 0x14))
TEMPERATURE, REBOOT, BUS, CLEAR = (_NODE | command for command in (0x15, 0x16, 0x17, 0x18))
"""CAN identifiers."""

IDLE: Final = 1
CLOSED_LOOP: Final = 8
POSITION_CONTROL: Final = 3
PASSTHROUGH: Final = 1
WATCHDOG_EXPIRED: Final = 0x01000000
ESTOP_REQUESTED: Final = 0x20000000
NOT_CALIBRATED: Final = 0x00000001

_ODRIVE_TORQUE_N_M: Final = 1e-3
_HEARTBEAT_NS: Final = 10_000_000


class ODriveAxis(CanDrive):
    """One axis. An error switches the power off and keeps the axis in IDLE until Clear_Errors."""

    lost_code: ClassVar[int] = WATCHDOG_EXPIRED

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock, sampler: Sampler) -> None:
        super().__init__(bus, clock, sampler)
        self.received: dict[int, int] = {}  # number of received frames of each identifier
        self._modes = (2, PASSTHROUGH)
        self._beat = Timer(clock, self._tell)

    def boot(self) -> None:
        """Start receiving and sending, as after power-on."""
        handlers: dict[int, tuple[int, Callable[[bytes], None]]] = {
            ESTOP: (0, lambda _: self.fail(ESTOP_REQUESTED)),
            SET_STATE: (4, self._on_state),
            SET_MODE: (8, self._on_mode),
            INPUT_POS: (8, self._on_input),
            SET_LIMITS: (8, self._on_limits),
            REBOOT: (1, lambda _: self._restart()),
            CLEAR: (1, lambda _: self._clear()),
            ESTIMATES | REMOTE_FLAG: (0, self._on_estimates),
            IQ | REMOTE_FLAG: (0, self._on_iq),
            TEMPERATURE | REMOTE_FLAG: (0, self._on_temperature),
            BUS | REMOTE_FLAG: (0, self._on_bus),
        }
        for identifier, (size, handle) in handlers.items():
            self._port.listen(identifier, self._counted(identifier, size, handle))
        self._tell()

    def _counted(
        self, identifier: int, size: int, handle: Callable[[bytes], None]
    ) -> Callable[[bytes], None]:
        def on_frame(data: bytes) -> None:
            if len(data) == size:
                self.received[identifier] = self.received.get(identifier, 0) + 1
                handle(data)

        return on_frame

    def _on_state(self, data: bytes) -> None:
        (state,) = struct.unpack("<I", data)
        if state == IDLE:
            self._switch(False)
        elif state == CLOSED_LOOP and not self.fault_code:
            self._switch(True)

    def _on_mode(self, data: bytes) -> None:
        self._modes = struct.unpack("<II", data)

    def _on_input(self, data: bytes) -> None:
        turns, _, torque = struct.unpack("<fhh", data)
        if math.isfinite(turns) and self._modes == (POSITION_CONTROL, PASSTHROUGH):
            self._target(turns * math.tau, torque * _ODRIVE_TORQUE_N_M)

    def _on_limits(self, data: bytes) -> None:
        speed, current = struct.unpack("<ff", data)
        self._speed_rad_s = speed * math.tau
        self._machine.limit_current(current)

    def _restart(self) -> None:
        self._switch(False)
        self.fault_code = 0
        self._modes = (2, PASSTHROUGH)

    def _clear(self) -> None:
        self.fault_code = 0

    def _tell(self) -> None:
        state = CLOSED_LOOP if self.powered else IDLE
        self._port.send(HEARTBEAT, struct.pack("<IBBBx", self.fault_code, state, 0, 0))
        self._beat.start(self._clock.now_ns() + _HEARTBEAT_NS)

    def _on_estimates(self, _: bytes) -> None:
        reading = self._reading()
        turns, speed = self._motor_rad(reading) / math.tau, reading.motor_velocity_rad_s / math.tau
        self._port.send(ESTIMATES, struct.pack("<ff", turns, speed))

    def _on_iq(self, _: bytes) -> None:
        current = self._reading().current_A
        self._port.send(IQ, struct.pack("<ff", current, current))

    def _on_temperature(self, _: bytes) -> None:
        found = self._reading().temperature_C
        self._port.send(TEMPERATURE, struct.pack("<ff", found, found))

    def _on_bus(self, _: bytes) -> None:
        self._port.send(BUS, struct.pack("<ff", self._reading().supply_V, 0.0))


CanDriveKind = Literal["odrive", "mit"]
CAN_DRIVE_FILES: Final[Mapping[CanDriveKind, Path]] = {"odrive": ODRIVE_DBC, "mit": MIT_DBC}
"""The DBC file of each kind of drive."""
CAN_DRIVES: Final[
    Mapping[CanDriveKind, Callable[[SimulatedBus, SimulatedClock, Sampler], CanDrive]]
] = {"odrive": ODriveAxis, "mit": MitMotor}
