"""Process data (PDOs) of a simulated device, as its objects 1400h to 1BFFh configure them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from typing import Any, Final

from drivers.clock import SimulatedClock
from drivers.mock.canopen import dictionary as od
from drivers.mock.canopen.dictionary import DeviceDictionary, SdoAbortError
from drivers.mock.wires.bus import Port
from drivers.mock.wires.timer import Timer

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
    """One configured TPDO; ``every`` is its period in SYNCs, 0 for an event-driven TPDO."""

    identifier: int
    layout: struct.Struct
    pick: Callable[[dict[int, int]], tuple[Any, ...]]
    every: int
    timer: Timer
    period_ns: int
    count: int = 0
    sent: bytes = field(default=b"")

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
        clock: Clock for event timers.
        outputs: Function that is called when an event-driven RPDO has changed values.
        too_short: Function that is called with the length of an RPDO that is shorter than its
            mapping.
    """

    def __init__(
        self,
        dictionary: DeviceDictionary,
        port: Port,
        clock: SimulatedClock,
        outputs: Callable[[], None],
        too_short: Callable[[int], None],
    ) -> None:
        self._dictionary = dictionary
        self._port = port
        self._clock = clock
        self._outputs = outputs
        self._too_short = too_short
        self._receive: list[Receive] = []
        self._synchronous: list[Transmit] = []
        self._event_driven: list[Transmit] = []
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

    def send_changes(self) -> None:
        """Send the event-driven TPDOs whose content has changed."""
        for pdo in self._event_driven:
            if pdo.content(self._dictionary.values) != pdo.sent:
                self._send_event(pdo)

    def _send_event(self, pdo: Transmit) -> None:
        pdo.sent = pdo.content(self._dictionary.values)
        self._port.send(pdo.identifier, pdo.sent)
        if pdo.period_ns:
            pdo.timer.start(self._clock.now_ns() + pdo.period_ns)

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
        for transmit in self._event_driven:
            transmit.timer.stop()
        self._receive, self._synchronous, self._event_driven = [], [], []
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
                transmit = self._transmitter(index, *mapped)
                (self._synchronous if transmit.every else self._event_driven).append(transmit)

    def _transmitter(
        self, index: int, identifier: int, kind: int, keys: tuple[int, ...], layout: struct.Struct
    ) -> Transmit:
        pick = itemgetter(*keys) if len(keys) > 1 else partial(_pick_one, keys[0])
        synchronous = kind <= _MAX_SYNCHRONOUS
        period_ns = 0 if synchronous else self._dictionary.integer(index, 5) * 1_000_000
        timer = Timer(self._clock, lambda: self._send_event(pdo))
        pdo = Transmit(identifier, layout, pick, kind if synchronous else 0, timer, period_ns)
        if period_ns:
            timer.start(self._clock.now_ns() + period_ns)
        return pdo

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
            lowest = 0 if index < 0x1800 else 1
            if not lowest <= value <= _MAX_SYNCHRONOUS and value not in _EVENT_DRIVEN:
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
