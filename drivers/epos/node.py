"""One EPOS4 on a serial line: its objects by ReadObject and WriteObject, and its share of the
cycle.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from itertools import cycle as endless
from typing import Final, Protocol

from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.exceptions import SdoAbortedError

from drivers.canopen.cia402 import CONTROLWORD
from drivers.canopen.pdo import packing
from drivers.canopen.sdo import variable
from drivers.clock import Clock
from drivers.epos.frames import (
    ERROR,
    LAST,
    NMT,
    OBJECT,
    SEGMENT_BYTES,
    TOGGLE,
    TOTAL,
    Opcode,
    encode,
    segment,
)
from drivers.errors import ConfigurationError, LinkError, ObjectAccessError
from drivers.objects import ObjectAddress, PdoLayout

IDENTITY: Final = 0x1018
CYCLE_WRITES: Final = 1
CYCLE_READS: Final = 4
"""Objects of a control cycle of a servo: its target; state, position, current and one of the others
in turn.
"""

_HOST_TIME: Final = (0x1013, 0)
_POSITION: Final = (0x6064, 0)
_CURRENT: Final = (0x6078, 0)
_GUARD_FACTOR: Final = 2.0
_GUARD_CYCLES: Final = 3
_VALUE_BYTES: Final = 4
_ANSWER_BYTES: Final = ERROR.size + _VALUE_BYTES
_ACCEPTED: Final = ERROR.pack(0)
_START: Final = 1
_REASONS: Final = {
    0x0F00FFB9: "wrong node identifier",
    0x0F00FFBC: "the drive is not in service mode",
    0x0F00FFBE: "password wrong",
    0x0F00FFBF: "the drive does not know this command",
    0x0F00FFC0: "the drive is in a wrong NMT state",
}


class Guard(Protocol):
    """Whoever takes the power off when this program dies or hangs; the drive has no such watch of
    its own.
    """

    def arm(self, limit_s: float) -> None:
        """Stand by from now on; act where nobody feeds for this long, s.

        Raises:
            LinkError: Nobody does.
        """
        ...

    def feed(self) -> None:
        """Show that the control loop is alive; called before every request.

        Cheap, and nothing unless armed.

        Raises:
            LinkError: It has taken over, or is gone: the line must not be used.
        """
        ...

    def release(self) -> None:
        """Stand down: the drive is verified off."""
        ...


class Line(Protocol):
    """What a node needs of its link."""

    cycle: int
    clock: Clock
    guard: Guard | None

    def request(
        self, opcode: Opcode, data: bytes, what: str, repeat: bool = True, insist: bool = False
    ) -> bytes:
        """Send one request and return the data of its answer; :class:`LinkError` where there is
        none.
        """
        ...

    def set_cycle(self, cycle_s: float, who: str) -> None:
        """Set the cycle time, the same for all devices."""
        ...


class _Output:
    """One object that the cycle writes, and the value it is to have."""

    __slots__ = ("address", "head", "layout", "value")

    def __init__(self, node_id: int, address: ObjectAddress, layout: struct.Struct) -> None:
        self.address = address
        self.head = OBJECT.pack(node_id, *address)
        self.layout = layout
        self.value = 0

    def request(self) -> bytes:
        """Return the frame that writes it."""
        return encode(
            Opcode.WRITE_OBJECT, self.head + self.layout.pack(self.value).ljust(_VALUE_BYTES, b"\0")
        )


class _Input:
    """The last good value of one object that the cycle reads."""

    __slots__ = ("asked_ns", "layout", "request", "value")

    def __init__(self, request: bytes, layout: struct.Struct, value: int) -> None:
        self.asked_ns = 0
        self.request = request
        self.layout = layout
        self.value = value

    def take(self, answer: bytes) -> bool:
        """Take an answer over; a refusal or a wrong length updates nothing and returns False."""
        if len(answer) != _ANSWER_BYTES or not answer.startswith(_ACCEPTED):
            return False
        self.value = self.layout.unpack_from(answer, ERROR.size)[0]
        return True


class EposSerialNode:
    """A drive behind an :class:`~drivers.epos.link.EposSerialLink`; a
    :class:`~drivers.objects.ProcessChannel`.

    There is no SYNC: objects are sampled one after another. Every cycle writes the outputs (the
    controlword only when it has changed) and reads the first input layout; the objects of the
    others take turns, one a cycle, the slower ones in every other turn. The time stamp 1013h is not
    read: the host's time at the cycle's first request takes its place.

    The position is read one object before the current, whose mean so ends too late. It is replaced
    by the mean that ends with the position, taking the current as constant within a cycle. The
    position itself is left as read, after the time stamp by as much in every cycle, but for doubled
    bytes.

    Attributes:
        node_id: 1 to 127.
        cycle: Number of the last exchange.
        monitored: True from the moment process data runs.
        heard_ns: When the last whole answer came.
    """

    def __init__(self, node_id: int, dictionary: ObjectDictionary, line: Line) -> None:
        self.node_id = node_id
        self.cycle = line.cycle
        self._cycle_s = 0.0
        self.monitored = False
        self.heard_ns = 0
        self._line = line
        self._dictionary = dictionary
        self._outputs: dict[int, tuple[_Output, ...]] = {}
        self._word: int | None = None
        self._values: dict[ObjectAddress, _Input] = {}
        self._layouts: dict[int, tuple[ObjectAddress, ...]] = {}
        self._every: tuple[ObjectAddress, ...] = ()
        self._turns: Iterator[ObjectAddress] = iter(())
        self._complete = False
        self._time_us = 0
        self._before: tuple[int, int] | None = None

    @property
    def label(self) -> str:
        """What to call the device in messages."""
        return f"node {self.node_id}"

    @property
    def fresh(self) -> bool:
        """Whether everything that was due at the last exchange was written and read."""
        return self._complete

    def read(self, index: int, subindex: int = 0) -> int:
        """Read an integer object.

        Raises:
            ConfigurationError: The EDS has no such object, or it is no integer of at most 32 bits.
            ObjectAccessError: The device refuses.
            LinkError: No answer.
        """
        layout = self._packing(index, subindex)
        answer = self._request(
            Opcode.READ_OBJECT, OBJECT.pack(self.node_id, index, subindex), index, subindex
        )
        if len(answer) != _VALUE_BYTES:
            raise self._malformed(index, subindex, len(answer))
        return int(layout.unpack_from(answer)[0])

    def read_bytes(self, index: int, subindex: int = 0) -> bytes:
        """Read an object of any length, in segments; raises as :meth:`read`."""
        fields = OBJECT.pack(self.node_id, index, subindex)
        answer = self._request(Opcode.INITIATE_SEGMENTED_READ, fields, index, subindex)
        if len(answer) <= TOTAL.size:
            raise self._malformed(index, subindex, len(answer))
        (total,) = TOTAL.unpack_from(answer)
        length = answer[TOTAL.size]
        data = answer[TOTAL.size + 1 :][:length]
        toggle = 0
        while len(data) < total:
            # A segment asked for twice would be skipped once.
            answer = self._request(
                Opcode.SEGMENT_READ, bytes([toggle, 0]), index, subindex, repeat=False
            )
            if len(answer) < 3 or not answer[0] or answer[1] & TOGGLE != toggle:
                raise self._malformed(index, subindex, len(answer))
            data += answer[2:][: answer[0]]
            if answer[1] & LAST:
                break
            toggle ^= TOGGLE
        if len(data) != total:
            raise self._malformed(index, subindex, len(data))
        return data

    def read_text(self, index: int, subindex: int = 0) -> str:
        """Read a visible-string object; raises as :meth:`read`."""
        return self.read_bytes(index, subindex).decode("ascii", errors="replace").rstrip("\0")

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object.

        Raises:
            ConfigurationError: The EDS has no such object, or the value does not fit its type.
            ObjectAccessError: The device refuses.
            LinkError: No answer.
        """
        self._request(Opcode.WRITE_OBJECT, self._written(index, subindex, value), index, subindex)

    def require_fit(self, index: int, subindex: int, value: int) -> None:
        """Check that the EDS has an object and its type can hold a value; raises as :meth:`write`.

        Sends nothing.
        """
        self._written(index, subindex, value)

    def insist(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object, sending it even while the line is out of step; raises as
        :meth:`write`.
        """
        self._request(
            Opcode.WRITE_OBJECT, self._written(index, subindex, value), index, subindex, insist=True
        )

    def _written(self, index: int, subindex: int, value: int) -> bytes:
        try:
            data = self._packing(index, subindex).pack(value)
        except struct.error as error:
            name = variable(self._dictionary, index, subindex).name
            raise ConfigurationError(
                f"{self.label}: {value} does not fit object {index:04X}h:{subindex:02X}h ({name})"
            ) from error
        return OBJECT.pack(self.node_id, index, subindex) + data.ljust(_VALUE_BYTES, b"\0")

    def write_bytes(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object of any length, in segments; raises as :meth:`write`."""
        fields = OBJECT.pack(self.node_id, index, subindex) + TOTAL.pack(len(data))
        self._request(Opcode.INITIATE_SEGMENTED_WRITE, fields, index, subindex)
        toggle = 0
        for at in range(0, len(data), SEGMENT_BYTES):
            chunk = data[at : at + SEGMENT_BYTES]
            fields = segment(chunk, toggle, at + SEGMENT_BYTES >= len(data))
            answer = self._request(Opcode.SEGMENT_WRITE, fields, index, subindex, repeat=False)
            if len(answer) != 2 or answer[0] != len(chunk) or answer[1] & TOGGLE != toggle:
                raise self._malformed(index, subindex, len(answer))
            toggle ^= TOGGLE

    def require_mappable(self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout]) -> None:
        """Check that the EDS has every object of a cycle; raises as :meth:`map_process_data`.

        Sends nothing.
        """
        for address in chain.from_iterable(layout.objects for layout in (*outputs, *inputs)):
            if address != _HOST_TIME:
                self._packing(*address)

    def map_process_data(
        self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout], cycle_s: float
    ) -> None:
        """Start the node, and list what every cycle writes and reads.

        Inputs start out with values read here.

        Raises:
            ConfigurationError: Another device has another cycle, or an object is not in the EDS or
            no integer.
            ObjectAccessError: The device refuses one.
            LinkError: No answer.
        """
        self.monitored = self._complete = False
        self._line.set_cycle(cycle_s, self.label)
        self._cycle_s = cycle_s
        self._request(Opcode.SEND_NMT, NMT.pack(self.node_id, _START), 0, 0)
        self._outputs = {
            layout.number: tuple(
                _Output(self.node_id, address, self._packing(*address))
                for address in layout.objects
            )
            for layout in outputs
        }
        self._word = None
        self._layouts = {layout.number: layout.objects for layout in inputs}
        self._values = {
            address: self._input(address)
            for layout in inputs
            for address in layout.objects
            if address != _HOST_TIME
        }
        self._every = inputs[0].objects if inputs else ()
        self._turns = endless(_turns(inputs[1:]))
        self._before = None
        self.heard_ns = 0
        self.monitored = True

    def stage(self, number: int, *values: int) -> None:
        """Set the values that output ``number`` carries from the next exchange on."""
        for output, value in zip(self._outputs[number], values, strict=True):
            output.value = value

    def latest(self, number: int) -> tuple[int, ...]:
        """Return the last good values of input ``number``."""
        return tuple(
            self._time_us if address == _HOST_TIME else self._values[address].value
            for address in self._layouts[number]
        )

    def watch(self, limit_s: float) -> None:
        """Have the link's guard stand by; the protocol has no watch of its own, which
        :attr:`Link.has_watchdog` says.

        Args:
            limit_s: Asked for. A process on a computer is not as punctual as a drive: the guard
                acts after twice that, and after no less than three cycles.

        Raises:
            LinkError: There should be a guard, and is none.
        """
        if self._line.guard is not None:
            self._line.guard.arm(max(_GUARD_FACTOR * limit_s, _GUARD_CYCLES * self._cycle_s))

    def unwatch(self) -> None:
        """Have the guard stand down."""
        if self._line.guard is not None:
            self._line.guard.release()

    def exchange(self, cycle: int, ask: Callable[[bytes], bytes | None]) -> None:
        """Write and read what this cycle is to; stops where an answer is lost.

        Args:
            cycle: Its number.
            ask: Sends a frame and returns the data of its answer, None where that is lost.
        """
        self.cycle = cycle
        self._complete = False
        self._time_us = self._line.clock.now_ns() // 1000 & 0xFFFFFFFF
        good = True
        turn = next(self._turns, None)
        for output in chain.from_iterable(self._outputs.values()):
            if output.address == CONTROLWORD:
                if output.value == self._word:
                    continue
                turn = None
            answer = ask(output.request())
            if answer is None:
                return
            accepted = answer == _ACCEPTED
            good = good and accepted
            if accepted and output.address == CONTROLWORD:
                self._word = output.value
        for address in self._every if turn is None else (*self._every, turn):
            slot = self._values[address]
            slot.asked_ns = self._line.clock.now_ns()
            answer = ask(slot.request)
            if answer is None:
                return
            good = slot.take(answer) and good
        if good and _POSITION in self._every and _CURRENT in self._every:
            self._bring_together(self._values[_POSITION], self._values[_CURRENT])
        self._complete = good

    def _bring_together(self, position: _Input, current: _Input) -> None:
        mean, ended_ns = current.value, current.asked_ns
        if self._before is not None:
            before, began_ns = self._before
            # Not so in simulated time on a line that takes none, or after a step of the clock.
            if ended_ns > began_ns:
                late = (ended_ns - position.asked_ns) / (ended_ns - began_ns)
                current.value = round(mean + late * (before - mean))
        self._before = mean, ended_ns

    def _input(self, address: ObjectAddress) -> _Input:
        request = encode(Opcode.READ_OBJECT, OBJECT.pack(self.node_id, *address))
        return _Input(request, self._packing(*address), self.read(*address))

    def _packing(self, index: int, subindex: int) -> struct.Struct:
        return packing(self._dictionary, PdoLayout(0, ((index, subindex),)))

    def _request(
        self,
        opcode: Opcode,
        fields: bytes,
        index: int,
        subindex: int,
        repeat: bool = True,
        insist: bool = False,
    ) -> bytes:
        what = f"{self.label}, object {index:04X}h:{subindex:02X}h" if index else self.label
        answer = self._line.request(opcode, fields, what, repeat, insist)
        (error,) = ERROR.unpack_from(answer)
        if error:
            reason = _REASONS.get(error) or SdoAbortedError.CODES.get(error, "unknown reason")
            raise ObjectAccessError(index, subindex, error, f"{self.label} refuses: {reason}")
        return answer[ERROR.size :]

    def _malformed(self, index: int, subindex: int, length: int) -> LinkError:
        return LinkError(
            f"{self.label}, object {index:04X}h:{subindex:02X}h: an answer of {length} bytes does "
            f"not belong to the "
            "request; check that nothing else uses the line"
        )


def _turns(layouts: Sequence[PdoLayout]) -> list[ObjectAddress]:
    """Return the order in which objects take turns: those of every cycle, then one of the slower
    ones, and again.
    """
    quick = [
        a for layout in layouts if layout.every == 1 for a in layout.objects if a != _HOST_TIME
    ]
    slow = [a for layout in layouts if layout.every > 1 for a in layout.objects]
    if not slow:
        return quick
    return [address for one in slow for address in (*quick, one)]
