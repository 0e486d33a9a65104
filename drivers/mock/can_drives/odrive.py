"""Simulated drive with the frames of ODrive's CAN Simple protocol (``odrive.dbc``), node 3.

The drive sends its values in answer to remote frames, and the heartbeat without a request. The
messages Estop (no data), Reboot and Clear_Errors (one byte, ignored) act by their arrival.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, Final

from drivers.can.port import REMOTE_FLAG
from drivers.clock import SimulatedClock
from drivers.mock.candr import CanDrive
from drivers.mock.sampler import Sampler
from drivers.mock.wires.bus import SimulatedBus, Timer

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

_TORQUE_N_M: Final = 1e-3
_HEARTBEAT_NS: Final = 10_000_000


class ODriveAxis(CanDrive):
    """One axis. An error switches the power off and keeps the axis in IDLE until Clear_Errors.

    Attributes:
        received: Number of received frames of each identifier.
    """

    lost_code: ClassVar[int] = WATCHDOG_EXPIRED

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock, sampler: Sampler) -> None:
        super().__init__(bus, clock, sampler)
        self.received: dict[int, int] = {}
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
            self._target(turns * math.tau, torque * _TORQUE_N_M)

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
