"""Base class of simulated CANopen devices: NMT, heartbeat, EMCY, SDO server, SYNC, process data."""

from __future__ import annotations

import struct
from enum import IntEnum
from pathlib import Path
from typing import Final

from drivers.clock import SimulatedClock
from drivers.frame_flags import REMOTE_FLAG
from drivers.mock.canopen import dictionary as od
from drivers.mock.canopen.dictionary import DeviceDictionary, SdoAbortError, key
from drivers.mock.canopen.process_data import ProcessData
from drivers.mock.canopen.sdo_server import SdoServer
from drivers.mock.wires.bus import SimulatedBus
from drivers.mock.wires.timer import Timer

_MS: Final = 1_000_000
_TIME_STAMP: Final = key(0x1013)
_HISTORY: Final = 8

HEARTBEAT_LOST: Final = 0x8130
PDO_TOO_SHORT: Final = 0x8210

GENERIC: Final = 0x01
COMMUNICATION: Final = 0x10
PROFILE: Final = 0x20
"""Bits of the error register 1001h."""


class Nmt(IntEnum):
    """NMT states with their codes in the heartbeat."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class SimulatedNode:
    """Base of the simulated devices; a subclass implements the hooks at the end of the class.

    Attributes:
        remote_frames: Whether the device answers remote frames, that is, guard requests.
        sdo_delay_ns: Time that the device takes for an SDO answer, ns.

    Args:
        bus: Bus of the device.
        clock: Simulated time.
        node_id: 1 to 127.
        eds: EDS file of its object dictionary.
        clock_offset_us: Reading of the device's microsecond clock at simulated time 0.
    """

    def __init__(
        self,
        bus: SimulatedBus,
        clock: SimulatedClock,
        node_id: int,
        eds: Path,
        clock_offset_us: int,
    ) -> None:
        self.node_id = node_id
        self.remote_frames = True
        self.sdo_delay_ns = 0
        self.state = Nmt.INITIALISING
        self.objects = DeviceDictionary(eds, node_id)
        self._values = self.objects.values
        self._clock = clock
        self._clock_offset_us = clock_offset_us
        self._port = bus.attach()
        self._process_data = ProcessData(
            self.objects, self._port, clock, self._outputs, self._rpdo_too_short
        )
        self._sdo = SdoServer(self.objects, self.refresh)
        self._producer = Timer(clock, self._send_heartbeat)
        self._watch = Timer(clock, self._check_heartbeat)
        self._watched: int | None = None
        self._heard_ns = 0
        self._toggle = 0
        self._life = Timer(clock, lambda: self._master_lost())
        self.objects.written[0x1017] = lambda _sub, _value: self._start_producer()
        if key(0x1016, 1) in self.objects.entries:
            self.objects.written[0x1016] = lambda _sub, _value: self._start_consumer()
        self.objects.written[0x100C] = self.objects.written[0x100D] = lambda _sub, _value: (
            self._life.stop() if not self._life_ns() else None
        )
        self.objects.checks[0x1003] = self._check_history
        self.objects.written[0x1003] = lambda _sub, _value: self.objects.reset(0x1003, 0x1003)
        self._port.listen(0x000, self._on_nmt)
        self._port.listen(0x080, self._on_sync)
        self._port.listen(REMOTE_FLAG | 0x700 + node_id, self._on_guard_request)

    def boot(self) -> None:
        """Send the boot-up frame and enter PRE-OPERATIONAL, as after power-on."""
        self._port.listen(0x600 + self.node_id, self._on_sdo)
        self._port.send(0x700 + self.node_id, bytes([Nmt.INITIALISING]))
        self._set_state(Nmt.PRE_OPERATIONAL)
        self._start_producer()

    def emergency(self, code: int, register: int, info: bytes = b"") -> None:
        """Send an EMCY frame, set object 1001h and add the code to the history 1003h."""
        values = self._values
        bits = self.objects.integer(0x1001) | register | GENERIC
        values[key(0x1001)] = bits
        newest = key(0x1003, 1)
        for at in range(newest + _HISTORY - 1, newest, -1):
            values[at] = values[at - 1]
        values[newest] = code
        values[key(0x1003)] = min(_HISTORY, self.objects.integer(0x1003) + 1)
        self._send_emergency(code, bits, info)

    def clear_errors(self) -> None:
        """Report by an EMCY frame that all errors are cleared."""
        if self.objects.integer(0x1001):
            self._values[key(0x1001)] = 0
            self._send_emergency(0, 0, b"")

    def _send_emergency(self, code: int, register: int, info: bytes) -> None:
        if self.state is not Nmt.STOPPED:
            self._port.send(0x80 + self.node_id, struct.pack("<HB5s", code, register, info))

    def _on_sdo(self, data: bytes) -> None:
        if self.state is Nmt.STOPPED:
            return
        response = self._sdo.answer(data)
        if response is None:
            return
        if self.sdo_delay_ns:
            due = self._clock.now_ns() + self.sdo_delay_ns
            self._clock.call_at(due, lambda: self._port.send(0x580 + self.node_id, response))
        else:
            self._port.send(0x580 + self.node_id, response)

    def _on_sync(self, _data: bytes) -> None:
        if self.state is not Nmt.OPERATIONAL:
            return
        self.latch()
        self._process_data.apply()
        self.act()
        self._process_data.send_synchronous()

    def _outputs(self) -> None:
        self.act()
        self.announce()

    def announce(self) -> None:
        """Send the event-driven process data that changed between two SYNCs."""
        self._process_data.send_changes()

    def stamp(self, time_ns: int) -> None:
        """Put the time of the device's own clock at ``time_ns`` (1013h, microseconds modulo 2^32)
        into the dictionary.
        """
        self._values[_TIME_STAMP] = (time_ns // 1000 + self._clock_offset_us) & 0xFFFFFFFF

    def _rpdo_too_short(self, length: int) -> None:
        self.emergency(PDO_TOO_SHORT, COMMUNICATION, bytes([length]))

    def _on_nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return
        match data[0]:
            case 1:
                self._set_state(Nmt.OPERATIONAL)
            case 2:
                self._set_state(Nmt.STOPPED)
                self.connection_lost(0)
            case 128:
                self._set_state(Nmt.PRE_OPERATIONAL)
            case 129 | 130:
                self._restart(application=data[0] == 129)

    def _restart(self, application: bool) -> None:
        self._set_state(Nmt.INITIALISING)
        self._watch.stop()
        self._life.stop()
        self._watched, self._toggle = None, 0
        self._sdo.reset()
        self.halt()
        self.objects.reset(0, 0xFFFF if application else 0x1FFF)
        self.restore()
        self._start_consumer()
        self.boot()

    def _set_state(self, state: Nmt) -> None:
        self.state = state
        self._process_data.activate(state is Nmt.OPERATIONAL)

    def _start_producer(self) -> None:
        period_ms = self.objects.kept(0x1017)
        self._producer.stop()
        if period_ms:
            self._producer.start(self._clock.now_ns() + period_ms * _MS)

    def _send_heartbeat(self) -> None:
        self._port.send(0x700 + self.node_id, bytes([self.state]))
        self._start_producer()

    def _start_consumer(self) -> None:
        self._watch.stop()
        if self._watched is not None:
            self._port.ignore(0x700 + self._watched)
            self._watched = None
        if key(0x1016, 1) not in self.objects.entries:
            return
        setting = self.objects.integer(0x1016, 1)
        if setting & 0xFFFF and setting >> 16:
            self._watched = setting >> 16
            self._heard_ns = -1
            self._port.listen(0x700 + self._watched, self._on_heartbeat)

    def _on_heartbeat(self, _data: bytes) -> None:
        # By CiA 301 the heartbeat time-out starts with the first heartbeat, not with the
        # configuration.
        first = self._heard_ns < 0
        self._heard_ns = self._clock.now_ns()
        if first:
            self._watch.start(self._heard_ns + self._heartbeat_limit_ns())

    def _heartbeat_limit_ns(self) -> int:
        return (self.objects.integer(0x1016, 1) & 0xFFFF) * _MS

    def _check_heartbeat(self) -> None:
        due = self._heard_ns + self._heartbeat_limit_ns()
        if due > self._clock.now_ns():
            self._watch.start(due)
            return
        self._heard_ns = -1
        self._master_lost()

    def _life_ns(self) -> int:
        """Return the life time of the node guarding, ns; 0 if the life guarding is off."""
        kept = self.objects.kept
        return kept(0x100C) * kept(0x100D) * _MS

    def _on_guard_request(self, _data: bytes) -> None:
        # A device that sends heartbeats does no node guarding (CiA 301, 7.2.8.2.2).
        if self.state is Nmt.INITIALISING or self.objects.kept(0x1017) or not self.remote_frames:
            return
        self._port.send(0x700 + self.node_id, bytes([self.state | self._toggle]))
        self._toggle ^= 0x80
        if life_ns := self._life_ns():
            self._life.start(self._clock.now_ns() + life_ns)

    def _master_lost(self) -> None:
        self.emergency(HEARTBEAT_LOST, COMMUNICATION)
        self.connection_lost(HEARTBEAT_LOST)
        behaviour = self.objects.kept(0x1029, 1)
        if behaviour == 0 and self.state is Nmt.OPERATIONAL:
            self._set_state(Nmt.PRE_OPERATIONAL)
        elif behaviour == 2:
            self._set_state(Nmt.STOPPED)

    def _check_history(self, subindex: int, value: int) -> None:
        if subindex == 0 and value:
            raise SdoAbortError(od.OUT_OF_RANGE)

    def refresh(self) -> None:
        """Update measured values in the dictionary before an SDO upload."""
        self.stamp(self._clock.now_ns())

    def latch(self) -> None:
        """Sample all inputs at a SYNC."""

    def act(self) -> None:
        """Apply the received outputs."""

    def connection_lost(self, code: int) -> None:
        """React to the loss of the master; ``code`` is the error code, 0 after an NMT stop."""

    def halt(self) -> None:
        """Bring the device into its safe state immediately, before a restart."""

    def restore(self) -> None:
        """Reset the internal state to that after power-on; the dictionary already contains its
        defaults.
        """
