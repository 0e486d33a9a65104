"""Simulated motor with MIT-style packed CAN frames (``mit_motor.dbc``).

One command frame of eight bytes contains position, speed, two gains and torque; the motor answers
with one frame. Orders are special values of the same command frame.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Final

from drivers.clock import SimulatedClock
from drivers.mock.candr import CanDrive
from drivers.mock.sampler import Sampler
from drivers.mock.wires.bus import SimulatedBus

MIT_DBC: Final = Path(__file__).with_name("mit_motor.dbc")
MIT_COMMAND, MIT_REPLY = 0x001, 0x011
"""CAN identifiers."""

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
