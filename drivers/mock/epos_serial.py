"""Simulated serial port of an EPOS4 drive: gives access to the objects of the simulated drive."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Final

from drivers.clock import SimulatedClock
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
from drivers.mock.canopen.dictionary import WRONG_LENGTH, SdoAbortError, key
from drivers.mock.drive import SimulatedDrive
from drivers.mock.power_state import POWERED, State
from drivers.mock.wires.bus import SimulatedBus, Timer

UNKNOWN_COMMAND: Final = 0x0F00FFBF
WRONG_NODE: Final = 0x0F00FFB9
_BAD_TOGGLE: Final = 0x05030000
_TARGET: Final = 0x607A
_MEANS: Final = (0x6077, 0x6078)
"""Torque and current, which are means since the last read."""
_VOLTAGE: Final = 0x2100
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
            if key(_VOLTAGE) in self._objects.entries:
                self._voltage = self._objects.read(_VOLTAGE, 0)
        elif index == _VOLTAGE and subindex == 0:
            return self._voltage
        else:
            self._drive.refresh()
        return self._objects.read(index, subindex)

    def _write(self, index: int, subindex: int, data: bytes) -> None:
        self._objects.write(index, subindex, data)
        if index == _TARGET:
            self._drive.act()

    def _entered(self, state: State) -> None:
        if state in POWERED:
            self._supervision.start(self._clock.now_ns() + _SUPERVISION_NS)
        else:
            self._supervision.stop()

    def _supervise(self) -> None:
        self._supervision.start(self._clock.now_ns() + _SUPERVISION_NS)
        self._drive.supervise()
