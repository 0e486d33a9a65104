"""Base class of simulated CANopen devices: NMT, heartbeat, EMCY, SDO server, SYNC, process data."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

from drivers.clock import SimulatedClock
from drivers.interfaces import REMOTE_FLAG
from drivers.mock.canopen import dictionary as od
from drivers.mock.canopen.dictionary import DeviceDictionary, SdoAbortError, key
from drivers.mock.wires.bus import Port, SimulatedBus, Timer

_INVALID: Final = 1 << 31
_MAX_SYNCHRONOUS: Final = 240
_EVENT_DRIVEN: Final = (254, 255)
_MAX_BITS: Final = 64


@dataclass
class Receive:
    """One configured RPDO."""

    identifier: int
    keys: tuple[int, ...]
    layout: struct.Struct
    synchronous: bool
    staged: bytes | None = None


@dataclass
class Transmit:
    """One configured TPDO; ``every`` is its period in SYNCs."""

    identifier: int
    layout: struct.Struct
    pick: Callable[[dict[int, int]], tuple[Any, ...]]
    every: int
    count: int = 0

    def content(self, values: dict[int, int]) -> bytes:
        """Return the PDO's data; each value is limited to the range of its object."""
        picked = self.pick(values)
        try:
            return self.layout.pack(*picked)
        except struct.error:
            codes = self.layout.format.lstrip("<")
            return self.layout.pack(
                *(od.held(code, value) for code, value in zip(codes, picked, strict=True))
            )


class ProcessData:
    """All PDOs of one device.

    Args:
        dictionary: Objects of the device; its PDO objects are checked and applied by this class.
        port: CAN controller of the device.
        outputs: Function that is called when an event-driven RPDO has changed values.
        too_short: Function that is called with the length of an RPDO that is shorter than its
            mapping.
    """

    def __init__(
        self,
        dictionary: DeviceDictionary,
        port: Port,
        outputs: Callable[[], None],
        too_short: Callable[[int], None],
    ) -> None:
        self._dictionary = dictionary
        self._port = port
        self._outputs = outputs
        self._too_short = too_short
        self._receive: list[Receive] = []
        self._synchronous: list[Transmit] = []
        self._active = False
        indices = {number >> 8 for number in dictionary.entries}
        self._receive_indices = sorted(index for index in indices if 0x1400 <= index < 0x1600)
        self._transmit_indices = sorted(index for index in indices if 0x1800 <= index < 0x1A00)
        for index in self._receive_indices + self._transmit_indices:
            dictionary.checks[index] = partial(self._check_communication, index)
            dictionary.checks[index + 0x200] = partial(self._check_mapping, index + 0x200)
            dictionary.written[index] = dictionary.written[index + 0x200] = self._changed

    def activate(self, active: bool) -> None:
        """Start process data (NMT OPERATIONAL) or stop it (any other state)."""
        if active != self._active:
            self._active = active
            self._rebuild()

    def apply(self) -> None:
        """Store the values of synchronous RPDOs received since the last SYNC in the dictionary."""
        for pdo in self._receive:
            if pdo.staged is not None:
                self._store(pdo, pdo.staged)
                pdo.staged = None

    def send_synchronous(self) -> None:
        """Send the TPDOs that are due at this SYNC."""
        values = self._dictionary.values
        send = self._port.send
        for pdo in self._synchronous:
            pdo.count += 1
            if pdo.count >= pdo.every:
                pdo.count = 0
                send(pdo.identifier, pdo.content(values))

    def _store(self, pdo: Receive, data: bytes) -> None:
        self._dictionary.values.update(zip(pdo.keys, pdo.layout.unpack_from(data), strict=True))

    def _received(self, pdo: Receive, data: bytes) -> None:
        if len(data) < pdo.layout.size:
            self._too_short(len(data))
        elif pdo.synchronous:
            pdo.staged = data
        else:
            self._store(pdo, data)
            self._outputs()

    def _changed(self, _subindex: int, _value: int) -> None:
        if self._active:
            self._rebuild()

    def _rebuild(self) -> None:
        for receive in self._receive:
            self._port.ignore(receive.identifier)
        self._receive, self._synchronous = [], []
        if not self._active:
            return
        for index in self._receive_indices:
            if (mapped := self._mapping(index)) is not None:
                identifier, kind, keys, layout = mapped
                pdo = Receive(identifier, keys, layout, kind <= _MAX_SYNCHRONOUS)
                self._receive.append(pdo)
                self._port.listen(identifier, partial(self._received, pdo))
        for index in self._transmit_indices:
            if (mapped := self._mapping(index)) is not None:
                identifier, kind, keys, layout = mapped
                pick = itemgetter(*keys) if len(keys) > 1 else partial(_pick_one, keys[0])
                self._synchronous.append(Transmit(identifier, layout, pick, kind))

    def _mapping(self, index: int) -> tuple[int, int, tuple[int, ...], struct.Struct] | None:
        read = self._dictionary.integer
        cob_id, count = read(index, 1), read(index + 0x200, 0)
        if cob_id & _INVALID or not count:
            return None
        place = self._dictionary.place
        keys = tuple(place(read(index + 0x200, sub) >> 8) for sub in range(1, count + 1))
        codes = "".join(self._dictionary.entries[number].code or "" for number in keys)
        return cob_id & 0x7FF, read(index, 2), keys, struct.Struct("<" + codes)

    def _check_communication(self, index: int, subindex: int, value: int) -> None:
        if subindex == 1:
            current = self._dictionary.integer(index, 1)
            if not (current | value) & _INVALID and current != value:
                raise SdoAbortError(od.DEVICE_STATE)
        elif subindex == 2:
            receive = index < 0x1800
            events = receive and value in _EVENT_DRIVEN
            if not (0 if receive else 1) <= value <= _MAX_SYNCHRONOUS and not events:
                raise SdoAbortError(od.OUT_OF_RANGE)

    def _check_mapping(self, index: int, subindex: int, value: int) -> None:
        read = self._dictionary.integer
        if not read(index - 0x200, 1) & _INVALID:
            raise SdoAbortError(od.DEVICE_STATE)
        if subindex == 0:
            bits = sum(read(index, sub) & 0xFF for sub in range(1, value + 1))
            if bits > _MAX_BITS:
                raise SdoAbortError(od.MAPPING_TOO_LONG)
            if any(not read(index, sub) for sub in range(1, value + 1)):
                raise SdoAbortError(od.NOT_MAPPABLE)
            return
        if read(index, 0):
            raise SdoAbortError(od.DEVICE_STATE)
        entry = self._dictionary.entry(value >> 16, value >> 8 & 0xFF)
        allowed = entry.mappable and (entry.writable if index < 0x1800 else entry.readable)
        if not allowed or entry.size * 8 != value & 0xFF:
            raise SdoAbortError(od.NOT_MAPPABLE)


def _pick_one(number: int, values: dict[int, int]) -> tuple[int]:
    # An itemgetter of a single key would return the value itself, not a tuple of one value.
    return (values[number],)


_TOGGLE: Final = 0x10
_LAST: Final = 0x01
BAD_TOGGLE: Final = 0x05030000
BAD_COMMAND: Final = 0x05040001
_HEAD: Final = struct.Struct("<BHB")


@dataclass
class _Transfer:
    index: int
    subindex: int
    data: bytes
    toggle: int = 0


class SdoServer:
    """Answers SDO requests from an object dictionary; values above four bytes are read-only."""

    def __init__(self, dictionary: DeviceDictionary, refresh: Callable[[], None]) -> None:
        self._dictionary = dictionary
        self._refresh = refresh
        self._transfer: _Transfer | None = None

    def reset(self) -> None:
        """Cancel a transfer in progress."""
        self._transfer = None

    def answer(self, request: bytes) -> bytes | None:
        """Return the response to one request frame of 8 bytes, or None if no response is due."""
        if len(request) != 8:
            return None
        command, index, subindex = _HEAD.unpack_from(request)
        service = command >> 5
        if service == 4:
            self._transfer = None
            return None
        try:
            match service:
                case 1:
                    return self._download(command, index, subindex, request[4:])
                case 2:
                    return self._upload(index, subindex)
                case 3:
                    return self._upload_segment(command)
                case _:
                    raise SdoAbortError(BAD_COMMAND)
        except SdoAbortError as abort:
            if self._transfer is not None and service == 3:
                index, subindex = self._transfer.index, self._transfer.subindex
            self._transfer = None
            return _HEAD.pack(0x80, index, subindex) + struct.pack("<I", abort.code)

    def _upload(self, index: int, subindex: int) -> bytes:
        self._refresh()
        data = self._dictionary.read(index, subindex)
        if 0 < len(data) <= 4:
            return _HEAD.pack(0x43 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")
        self._transfer = _Transfer(index, subindex, data)
        return _HEAD.pack(0x41, index, subindex) + struct.pack("<I", len(data))

    def _upload_segment(self, command: int) -> bytes:
        transfer = self._transfer
        if transfer is None:
            raise SdoAbortError(BAD_COMMAND)
        if command & _TOGGLE != transfer.toggle:
            raise SdoAbortError(BAD_TOGGLE)
        chunk, transfer.data = transfer.data[:7], transfer.data[7:]
        last = not transfer.data
        response = bytes(
            [transfer.toggle | (7 - len(chunk)) << 1 | (_LAST if last else 0)]
        ) + chunk.ljust(7, b"\0")
        transfer.toggle ^= _TOGGLE
        if last:
            self._transfer = None
        return response

    def _download(self, command: int, index: int, subindex: int, data: bytes) -> bytes:
        self._transfer = None
        if not command & 0x02:
            raise SdoAbortError(BAD_COMMAND)
        # A request that states no size contains as many bytes as the object has.
        known = self._dictionary.entry(index, subindex).size
        size = 4 - (command >> 2 & 0x03) if command & 0x01 else known
        self._dictionary.write(index, subindex, data[:size])
        return _HEAD.pack(0x60, index, subindex) + bytes(4)


_MS: Final = 1_000_000
_TIME_STAMP: Final = key(0x1013)
_HISTORY: Final = 8

HEARTBEAT_LOST: Final = 0x8130
PDO_TOO_SHORT: Final = 0x8210

GENERIC: Final = 0x01
COMMUNICATION: Final = 0x10
PROFILE: Final = 0x20  # bits of the error register 1001h


class Nmt(IntEnum):
    """NMT states with their codes in the heartbeat."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class SimulatedNode:
    """Base of the simulated devices; a subclass implements the hooks at the end of the class."""

    def __init__(
        self,
        bus: SimulatedBus,
        clock: SimulatedClock,
        node_id: int,
        eds: Path,
        clock_offset_us: int,
    ) -> None:
        self.node_id = node_id
        # Whether the device answers remote frames, that is, guard requests.
        self.remote_frames = True
        self.sdo_delay_ns = 0  # time that the device takes for an SDO answer, ns
        self.state = Nmt.INITIALISING
        self.objects = DeviceDictionary(eds, node_id)
        self._values = self.objects.values
        self._clock = clock
        self._clock_offset_us = clock_offset_us
        self._port = bus.attach()
        self._process_data = ProcessData(self.objects, self._port, self.act, self._rpdo_too_short)
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

    def stamp(self, time_ns: int) -> None:
        """Set 1013h to the device's own time at ``time_ns``, microseconds modulo 2^32."""
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
        """Reset the internal state after the dictionary has its defaults."""
