"""One EPOS4 drive on a serial line: access to its objects, and its part of the control cycle."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import chain
from itertools import cycle as endless
from typing import Final, Protocol

from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.exceptions import SdoAbortedError

from drivers.canopen.cia402 import CONTROLWORD
from drivers.canopen.pdo import packing
from drivers.canopen.sdo import described, unfit, variable
from drivers.clock import NS, Clock
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
from drivers.errors import ConfigurationError, DeviceError, LinkError, ObjectAccessError, StateError
from drivers.objects import ObjectAddress, PdoLayout

IDENTITY: Final = 0x1018
VALUE_BYTES: Final = 4
_REASONS: Final = {
    0x0F00FFB9: "wrong node identifier",
    0x0F00FFBC: "the drive is not in service mode",
    0x0F00FFBE: "password wrong",
    0x0F00FFBF: "the drive does not know this command",
    0x0F00FFC0: "the drive is in a wrong NMT state",
}


class Guard(Protocol):
    """Interface of the process that switches the power off if this program ends or hangs, because
    the drive has no watchdog.
    """

    def arm(self, limit_s: float) -> None:
        """Arm the guard; the guard acts if :meth:`feed` is not called for this time, s.

        Raises:
            LinkError: There is no guard.
        """
        ...

    def feed(self) -> None:
        """Tell the guard that the control loop is alive; called before every request.

        The method takes little time, and does nothing while the guard is not armed.

        Raises:
            LinkError: The guard has taken over the line, which must not be used while the error is
                raised; or the guard has ended, which is reported once.
        """
        ...

    def release(self) -> None:
        """Disarm the guard, after the caller has verified that the power is off."""
        ...


class Line(Protocol):
    """Interface of the link for a node."""

    cycle: int
    clock: Clock
    guard: Guard | None

    def request(
        self, opcode: Opcode, data: bytes, what: str, repeat: bool = True, insist: bool = False
    ) -> bytes:
        """Send one request and return the data of its answer; :class:`LinkError` if no answer
        arrives.
        """
        ...

    def tell(self, opcode: Opcode, data: bytes) -> None:
        """Send one request and wait for its answer at most as long as an exchange does."""
        ...

    def set_cycle(self, cycle_s: float, who: str) -> None:
        """Set the cycle time, the same for all devices."""
        ...


class ObjectAccess:
    """Reads and writes the objects of one node.

    Args:
        node_id: Node identifier, 1 to 127.
        dictionary: Objects of the node, from the EDS.
        line: Link of the line to which the node is connected.
    """

    def __init__(self, node_id: int, dictionary: ObjectDictionary, line: Line) -> None:
        self.node_id = node_id
        self._line = line
        self._dictionary = dictionary

    @property
    def label(self) -> str:
        return f"node {self.node_id}"

    def read(self, index: int, subindex: int = 0) -> int:
        layout = self._packing(index, subindex)
        answer = self._request(
            Opcode.READ_OBJECT, OBJECT.pack(self.node_id, index, subindex), index, subindex
        )
        if len(answer) != VALUE_BYTES:
            raise self._malformed(index, subindex, len(answer))
        return int(layout.unpack_from(answer)[0])

    def read_bytes(self, index: int, subindex: int = 0) -> bytes:
        """Read an object of any length, in segments; the errors are those of :meth:`read`."""
        fields = OBJECT.pack(self.node_id, index, subindex)
        answer = self._request(Opcode.INITIATE_SEGMENTED_READ, fields, index, subindex)
        if len(answer) <= TOTAL.size:
            raise self._malformed(index, subindex, len(answer))
        (total,) = TOTAL.unpack_from(answer)
        length = answer[TOTAL.size]
        data = answer[TOTAL.size + 1 :][:length]
        toggle = 0
        while len(data) < total:
            # The request is not repeated after a lost answer, because a repeated request would skip
            # a segment.
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
        return self.read_bytes(index, subindex).decode("ascii", errors="replace").rstrip("\0")

    def write(self, index: int, subindex: int, value: int) -> None:
        self._request(Opcode.WRITE_OBJECT, self._written(index, subindex, value), index, subindex)

    def describes(self, index: int, subindex: int, mappable: bool = False) -> bool:
        return described(self._dictionary, index, subindex, mappable=False)

    def fit_together(self, addresses: Sequence[tuple[int, int]]) -> bool:
        return True

    def stated(self, index: int, subindex: int) -> int | None:
        item = self._dictionary.get_variable(index, subindex)
        default = None if item is None else item.default
        return default if isinstance(default, int) else None

    def require_fit(self, index: int, subindex: int, value: int) -> None:
        self._written(index, subindex, value)

    def insist(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object; the request is sent even if the answer to an earlier request may
        still arrive. The errors are those of :meth:`write`.
        """
        self._request(
            Opcode.WRITE_OBJECT, self._written(index, subindex, value), index, subindex, insist=True
        )

    def announce(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object by one request, because an exchange sends nothing while an answer
        to an earlier request is missing; a lost answer and a refusal raise no error.
        """
        self._line.tell(Opcode.WRITE_OBJECT, self._written(index, subindex, value))

    def _written(self, index: int, subindex: int, value: int) -> bytes:
        try:
            data = self._packing(index, subindex).pack(value)
        except struct.error as error:
            item = variable(self._dictionary, index, subindex)
            raise unfit(self.label, item, value) from error
        return OBJECT.pack(self.node_id, index, subindex) + data.ljust(VALUE_BYTES, b"\0")

    def write_bytes(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object of any length, in segments; the errors are those of :meth:`write`."""
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
            raise ObjectAccessError(
                index, subindex, error, f"{self.label} refuses the access: {reason}"
            )
        return answer[ERROR.size :]

    def _malformed(self, index: int, subindex: int, length: int) -> LinkError:
        return LinkError(
            f"{self.label}, object {index:04X}h:{subindex:02X}h: an answer of {length} bytes does "
            "not belong to the request; check that no other program uses the line"
        )


CYCLE_WRITES: Final = 1
CYCLE_READS: Final = 4
"""Number of objects that are read in a control cycle: state, position, current, and one of all
other objects in turn.
"""

FASTEST_1_S: Final = 1e9
"""Change of the position, counts/s, that no motor exceeds: 20 bits per turn at 950 turns/s."""
_HOST_TIME: Final = (0x1013, 0)
_POSITION: Final = (0x6064, 0)
_GUARD_FACTOR: Final = 2.0
_GUARD_CYCLES: Final = 3
_ANSWER_BYTES: Final = ERROR.size + VALUE_BYTES
_ACCEPTED: Final = ERROR.pack(0)
_START: Final = 1


class _Output:
    """One object that the cycle writes, with its commanded value."""

    __slots__ = ("address", "head", "layout", "value")

    def __init__(self, node_id: int, address: ObjectAddress, layout: struct.Struct) -> None:
        self.address = address
        self.head = OBJECT.pack(node_id, *address)
        self.layout = layout
        self.value = 0

    def request(self) -> bytes:
        """Return the frame that writes the object."""
        return encode(
            Opcode.WRITE_OBJECT, self.head + self.layout.pack(self.value).ljust(VALUE_BYTES, b"\0")
        )


class _Input:
    """The last good value of one object that the cycle reads.

    Attributes:
        value: The value.
        taken_ns: Time at which the drive took it, ns.
        before: Value and time of the last cycle, as read, or None if that cycle was incomplete.
    """

    __slots__ = ("before", "layout", "request", "taken_ns", "value")

    def __init__(self, request: bytes, layout: struct.Struct, value: int) -> None:
        self.taken_ns = 0
        self.before: tuple[int, int] | None = None
        self.request = request
        self.layout = layout
        self.value = value

    def take(self, answer: bytes) -> bool:
        """Store the value in an answer; if the answer is a refusal or has a wrong length, change
        nothing and return False.
        """
        if len(answer) != _ANSWER_BYTES or not answer.startswith(_ACCEPTED):
            return False
        self.value = self.layout.unpack_from(answer, ERROR.size)[0]
        return True

    def bring_to(self, instant_ns: int, fastest_1_s: float = math.inf) -> None:
        """Replace the value as read by the value of an instant, by the change since the last cycle.
        The change of a mean over the time between two reads is that of a current which is constant
        in this time.

        Args:
            instant_ns: The instant.
            fastest_1_s: Fastest change of the value, 1/s; a faster change, as by a new zero or by
                the end of the range, does not continue, and the value stays as read.
        """
        value, taken_ns = self.value, self.taken_ns
        if self.before is not None:
            change, passed_ns = value - self.before[0], taken_ns - self.before[1]
            # The time may not have advanced: in simulated time on a line without delay, or after a
            # clock step.
            if passed_ns > 0 and abs(change) * NS <= fastest_1_s * passed_ns:
                self.value = round(value + change * (instant_ns - taken_ns) / passed_ns)
        self.before = value, taken_ns


class EposSerialNode(ObjectAccess):
    """A drive behind an :class:`~drivers.epos.link.EposSerialLink`; a
    :class:`~drivers.objects.ProcessChannel`.

    There is no SYNC: objects are sampled one after another. Every cycle writes the outputs (the
    controlword only if it has changed) and reads the objects of the first input layout. The objects
    of all other layouts are read in turn, one object per cycle; of the objects with a longer
    period, one is read in each turn. The time stamp 1013h is not read.

    The instant of a cycle is the time at which the position was answered; it is the time stamp, and
    a joint encoder on another line is asked then
    (:meth:`~drivers.epos.link.EposSerialLink.call_at_instant`). The position was taken somewhat
    earlier, and the mean of the current ends somewhat later; both are brought to the instant.

    Args:
        node_id: Node identifier, 1 to 127.
        dictionary: Objects of the drive.
        line: The link.
        fastest_1_s: Fastest plausible change of the position, counts/s.

    Attributes:
        node_id: Node identifier, 1 to 127.
        cycle: Number of the last exchange.
        monitored: Whether process data are exchanged; False after the drive was reported as silent.
        heard_ns: Time of the last complete answer, ns.
    """

    def __init__(
        self,
        node_id: int,
        dictionary: ObjectDictionary,
        line: Line,
        fastest_1_s: float = FASTEST_1_S,
    ) -> None:
        super().__init__(node_id, dictionary, line)
        self._fastest_1_s = fastest_1_s
        self.cycle = line.cycle
        self._cycle_s = 0.0
        self.monitored = False
        self.heard_ns = 0
        self._outputs: dict[int, tuple[_Output, ...]] = {}
        self._word: int | None = None
        self._values: dict[ObjectAddress, _Input] = {}
        self._layouts: dict[int, tuple[ObjectAddress, ...]] = {}
        self._every: tuple[ObjectAddress, ...] = ()
        self._mean: ObjectAddress | None = None
        self._turns: Iterator[ObjectAddress] = iter(())
        self._complete = False
        self._time_us = 0

    @property
    def latches(self) -> bool:
        return False

    @property
    def fresh(self) -> bool:
        return self._complete

    @property
    def sync_us(self) -> int:
        """Host's time of the instant of the last complete cycle, or of the first values,
        microseconds modulo 2^32.
        """
        return self._time_us

    def require_mappable(self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout]) -> None:
        for address in chain.from_iterable(layout.objects for layout in (*outputs, *inputs)):
            if address != _HOST_TIME:
                self._packing(*address)

    def accessed(
        self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout], watched: bool
    ) -> Iterator[ObjectAddress]:
        for address in chain.from_iterable(layout.objects for layout in (*outputs, *inputs)):
            if address != _HOST_TIME:
                yield address

    def unguarded(self, watched: bool) -> Iterator[DeviceError]:
        """Yield nothing: the protocol has no remote frames."""
        yield from ()

    def map_process_data(
        self,
        outputs: Sequence[PdoLayout],
        inputs: Sequence[PdoLayout],
        cycle_s: float,
        watched: bool = False,
    ) -> None:
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
        self._layouts = {}  # there is no sample until all values have been read
        self._values = {
            address: self._input(address)
            for layout in inputs
            for address in layout.objects
            if address != _HOST_TIME
        }
        self._layouts = {layout.number: layout.objects for layout in inputs}
        self._every = inputs[0].objects if inputs else ()
        self._mean = inputs[0].mean if inputs else None
        self._turns = endless(_turns(inputs[1:]))
        self._time_us = self._line.clock.now_ns() // 1000 & 0xFFFFFFFF
        self.heard_ns = 0
        self.monitored = True

    def stage(self, number: int, *values: int) -> None:
        for output, value in zip(self._outputs[number], values, strict=True):
            output.value = value

    def stage_once(self, number: int, values: tuple[int, ...], then: tuple[int, ...]) -> None:
        """Refuse the command, because without a watchdog a command of speed or torque would
        continue after the end of this program.
        """
        raise ConfigurationError(
            f"{self.label}: over a serial line a drive can be commanded by positions only; set "
            "servo.mode: csp"
        )

    def latest(self, number: int) -> tuple[int, ...]:
        if number not in self._layouts:
            raise StateError(f"{self.label}: no process data are set up; prepare the device first")
        return tuple(
            self._time_us if address == _HOST_TIME else self._values[address].value
            for address in self._layouts[number]
        )

    def watch(self, limit_s: float) -> None:
        """Arm the guard of the link, because the protocol has no watchdog
        (:attr:`Link.has_watchdog`).

        Args:
            limit_s: Requested time-out, s. The guard is a process, whose timing is less exact than
                that of a drive; therefore it acts after twice this time, and after at least three
                cycles.

        Raises:
            LinkError: The link has no guard.
        """
        if self._line.guard is not None:
            self._line.guard.arm(max(_GUARD_FACTOR * limit_s, _GUARD_CYCLES * self._cycle_s))

    def unwatch(self) -> None:
        if self._line.guard is not None:
            self._line.guard.release()

    def kept_alive(self, limit_s: float) -> AbstractContextManager[None]:
        return nullcontext()

    def limit_wait(self, limit_s: float | None) -> None:
        """Do nothing: the drive has no watchdog, and the guard is fed during every wait."""

    def exchange(
        self, cycle: int, ask: Callable[[bytes], bytes | None], at_instant: Callable[[], None]
    ) -> None:
        """Write and read the objects of this cycle, up to the first lost answer. Position and mean
        are brought to the instant of the cycle, if this cycle and the last were complete.

        Args:
            cycle: Number of the cycle.
            ask: Function that sends a frame and returns the data of its answer, or None if the
                answer is lost.
            at_instant: Function that is called at the instant of the cycle.
        """
        self.cycle = cycle
        self._complete = False
        instant_ns = self._ask_all(ask, at_instant)
        for address in self._every:
            if address not in (_POSITION, self._mean):
                continue
            slot = self._values[address]
            if instant_ns is None:
                slot.before = None
            else:
                slot.bring_to(instant_ns, self._fastest_1_s if address == _POSITION else math.inf)
        if instant_ns is not None:
            self._time_us = instant_ns // 1000 & 0xFFFFFFFF
            self._complete = True

    def _ask_all(
        self, ask: Callable[[bytes], bytes | None], at_instant: Callable[[], None]
    ) -> int | None:
        """Write and read the objects of this cycle; return its instant, ns, or None if it is
        incomplete.
        """
        clock = self._line.clock
        instant_ns = clock.now_ns()
        good = True
        turn = next(self._turns, None)
        for output in chain.from_iterable(self._outputs.values()):
            if output.address == CONTROLWORD:
                if output.value == self._word:
                    continue
                turn = None
            answer = ask(output.request())
            if answer is None:
                return None
            accepted = answer == _ACCEPTED
            good = good and accepted
            if accepted and output.address == CONTROLWORD:
                self._word = output.value
        for address in self._every if turn is None else (*self._every, turn):
            slot = self._values[address]
            asked_ns = clock.now_ns()
            answer = ask(slot.request)
            if answer is None:
                return None
            answered_ns = clock.now_ns()
            # Request and answer take about the same time.
            slot.taken_ns = (asked_ns + answered_ns) // 2
            good = slot.take(answer) and good
            if address == _POSITION:
                instant_ns = answered_ns
                at_instant()
        return instant_ns if good else None

    def _input(self, address: ObjectAddress) -> _Input:
        request = encode(Opcode.READ_OBJECT, OBJECT.pack(self.node_id, *address))
        return _Input(request, self._packing(*address), self.read(*address))


def _turns(layouts: Sequence[PdoLayout]) -> list[ObjectAddress]:
    """Return the order in which the objects of these layouts are read, one per cycle: all objects
    of layouts with a period of one cycle, then one object of the other layouts, and so on.
    """
    quick = [
        a for layout in layouts if layout.every == 1 for a in layout.objects if a != _HOST_TIME
    ]
    slow = [a for layout in layouts if layout.every > 1 for a in layout.objects]
    if not slow:
        return quick
    return [address for one in slow for address in (*quick, one)]
