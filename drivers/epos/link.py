"""Link to EPOS4 drives on a serial line: each request follows the answer to the previous one."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from itertools import chain
from itertools import cycle as endless
from pathlib import Path
from typing import Final, Protocol

from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.exceptions import SdoAbortedError

from drivers.can.port import ANSWER_SHARE
from drivers.canopen.cia402 import CONTROLWORD
from drivers.canopen.eds_file import read_eds
from drivers.canopen.link import require_node
from drivers.canopen.pdo import packing
from drivers.canopen.sdo import described, unfit, variable
from drivers.clock import NS, Clock
from drivers.epos.frames import (
    ERROR,
    LAST,
    NMT,
    OBJECT,
    TOGGLE,
    TOTAL,
    Frame,
    FrameDecoder,
    Opcode,
    encode,
)
from drivers.errors import ConfigurationError, DeviceError, LinkError, ObjectAccessError, StateError
from drivers.interfaces import Link, RawFrame
from drivers.objects import ObjectAddress, PdoLayout
from drivers.port_errors import close_all, is_gone, opened, require_one_cycle, words
from drivers.serial_port import BytePort, raw_frames

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
    """The process that takes the power off for this program: the drive has no watchdog."""

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


CYCLE_WRITES: Final = 1
CYCLE_READS: Final = 4
"""Number of objects read in a cycle: state, position, current, and one other in turn."""

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
    """The last good value of one object that the cycle reads."""

    __slots__ = ("before", "layout", "request", "taken_ns", "value")

    def __init__(self, request: bytes, layout: struct.Struct, value: int) -> None:
        self.taken_ns = 0  # time at which the drive took it, ns
        # Value and time of the last cycle, as read, or None if that cycle was incomplete.
        self.before: tuple[int, int] | None = None
        self.request = request
        self.layout = layout
        self.value = value

    def take(self, answer: bytes) -> bool:
        """Store the value in an answer; return False for a refusal or a wrong length."""
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


class EposSerialNode:
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
    """

    def __init__(
        self,
        node_id: int,
        dictionary: ObjectDictionary,
        line: EposSerialLink,
        fastest_1_s: float = FASTEST_1_S,
    ) -> None:
        self.node_id = node_id  # node identifier, 1 to 127
        self._line = line
        self._dictionary = dictionary
        self._fastest_1_s = fastest_1_s
        self.cycle = line.cycle  # number of the last exchange
        self._cycle_s = 0.0
        # Whether process data are exchanged; False after the drive was reported as silent.
        self.monitored = False
        self.heard_ns = 0  # time of the last complete answer, ns
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
        """Write also while the answer to an earlier request may still arrive."""
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

    @property
    def latches(self) -> bool:
        return False

    @property
    def fresh(self) -> bool:
        return self._complete

    @property
    def sync_us(self) -> int:
        """Host's time of the last complete cycle, microseconds modulo 2^32."""
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

    def forget_faults(self) -> None:
        """Do nothing: the serial protocol has no emergency messages."""

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
        """Refuse: without a watchdog the command would outlast this program."""
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
        """Write and read this cycle's objects; return its instant, ns, or None."""
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
    """Return the order of reads, one a cycle: all of the quick objects, then one slow one."""
    quick = [
        a for layout in layouts if layout.every == 1 for a in layout.objects if a != _HOST_TIME
    ]
    slow = [a for layout in layouts if layout.every > 1 for a in layout.objects]
    if not slow:
        return quick
    return [address for one in slow for address in (*quick, one)]


_FRAMES_KEPT: Final = 1 << 16
_LINE: Final = 0
_QUIET_NS: Final = 50_000_000
_ATTEMPTS: Final = 3
_LONGEST_WAIT_NS: Final = 50_000_000
"""Greatest duration of one wait for bytes, ns; the guard is fed between waits."""

_SUBINDICES: Final = (1, 2, 3, 4)


class EposSerialLink(Link):
    """A serial line with this program as its only master.

    An answer does not contain its request: after a lost answer, a late answer could be mistaken for
    the answer to the next request. Therefore, after a lost answer, the link is resynchronised: it
    requests a part of the drive's identity (a mark), and drops all answers before this part.

    The protocol has no watchdog in the drive: if the control loop stops, the drive continues to
    hold its last target.

    A port whose adapter was unplugged is opened again, by its name, at the next request: an adapter
    that is plugged in again carries the stop of the drive.

    Args:
        clock: Real or simulated clock, as the port.
        connect: Opens the port.
        name: Name of the line in messages.
        answer_s: Time-out of an answer outside the control cycle, s.
        guard: Guard that is armed while a drive may be energised, or None without a guard.
        silence_s: Greatest time without a complete answer of a drive in the control cycle, s.
    """

    has_watchdog = False

    def __init__(
        self,
        clock: Clock,
        connect: Callable[[], BytePort],
        name: str = "serial line",
        answer_s: float = 0.2,
        guard: Guard | None = None,
        silence_s: float = 0.2,
    ) -> None:
        self.clock = clock
        self.guard = guard
        self.cycle = 0  # number of exchanges so far
        self.lost = 0  # number of requests without a good answer so far
        self._at_instant: Callable[[], None] = lambda: None
        self._name = name
        self._connect = connect
        self._answer_wait_ns = round(answer_s * NS)
        self._silence_ns = round(silence_s * NS)
        self._port: BytePort | None = None
        self._lost = False
        self._decoder = FrameDecoder()
        self._in_step = False
        self._marks: deque[tuple[bytes, bytes]] = deque()
        self._nodes: dict[int, EposSerialNode] = {}
        self._frames: deque[RawFrame] = deque(maxlen=_FRAMES_KEPT)
        self._cycle_s: float | None = None
        self._answer_ns = 0

    def add_node(self, node_id: int, eds: Path, fastest_1_s: float = FASTEST_1_S) -> EposSerialNode:
        """Declare the drive on the line, or a drive that is reached through the CAN gateway of the
        drive on the line.

        Args:
            node_id: Node identifier, 1 to 127.
            eds: EDS file of the drive.
            fastest_1_s: Fastest plausible change of its position, counts/s.

        Raises:
            ConfigurationError: The node identifier is out of range or in use, or the EDS cannot be
                read.
        """
        require_node(node_id, self._nodes)
        dictionary = read_eds(eds, node_id)
        node = self._nodes[node_id] = EposSerialNode(node_id, dictionary, self, fastest_1_s)
        return node

    def open(self) -> None:
        if self._port is not None:
            return
        self._port = self._connected()
        self._in_step = False
        self._marks.clear()

    def close(self) -> None:
        port, self._port, self._lost = self._port, None, False
        if port is not None:
            close_all(port.close)

    def set_cycle(self, cycle_s: float, who: str) -> None:
        """Set the cycle time, which must be the same for all devices, and read the marks for
        resynchronisation.

        Raises:
            ConfigurationError: Another device has a different cycle time.
            LinkError: No answer.
        """
        require_one_cycle(self._cycle_s, cycle_s, who)
        self._cycle_s = cycle_s
        self._answer_ns = round(ANSWER_SHARE * cycle_s * NS)
        self._learn_marks()

    def exchange(self) -> None:
        """Write the outputs and read the inputs of every drive, for at most 80 % of the cycle.

        A lost answer ends the exchange: the remaining requests are not sent, and their values do
        not change.
        """
        self.cycle += 1
        now = self.clock.now_ns()
        ask = partial(self._ask, deadline_ns=now + self._answer_ns)
        for node in self._nodes.values():
            node.exchange(self.cycle, ask, self._at_instant)
            if node.monitored:
                self._check_silence(node)

    def _check_silence(self, node: EposSerialNode) -> None:
        now = self.clock.now_ns()
        if node.fresh or not node.heard_ns:
            node.heard_ns = now
        elif now - node.heard_ns > self._silence_ns:
            node.monitored = False
            raise LinkError(
                f"{node.label} sent no complete answer for {(now - node.heard_ns) / NS:.3f} s "
                f"(limit {self._silence_ns / NS:g} s); check its supply and the serial cable"
            )

    def call_at_instant(self, call: Callable[[], None]) -> None:
        """Call ``call`` in every exchange at the instant of the drive's values."""
        self._at_instant = call

    def take_frames(self) -> list[RawFrame]:
        frames = list(self._frames)
        self._frames.clear()
        return frames

    def request(
        self, opcode: Opcode, data: bytes, what: str, repeat: bool = True, insist: bool = False
    ) -> bytes:
        """Send one request and return the data of its answer, outside the cycle.

        Args:
            opcode: The service.
            data: Its fields.
            what: Name of the request in messages.
            repeat: Whether the request is repeated if its answer is lost; only for requests that
                may be executed twice.
            insist: Whether the request is sent even if the line is not synchronised, because the
                drive may still receive it; for commands that stop the drive.

        Raises:
            LinkError: No good answer.
        """
        frame = encode(opcode, data)
        attempts = _ATTEMPTS if repeat else 1
        for _ in range(attempts):
            if insist and not self._in_step:
                self._send(frame)
                self._receive(self.clock.now_ns() + _QUIET_NS)
            answer = self._ask(frame, self.clock.now_ns() + 2 * self._answer_wait_ns)
            if answer is not None:
                return answer
        raise LinkError(
            f"{self._name}, {what}: no correct answer within "
            f"{attempts * self._answer_wait_ns / NS:g} s; check power, cable, bit rate and node "
            "identifier"
        )

    def tell(self, opcode: Opcode, data: bytes) -> None:
        """Send one request at once, and wait for its answer at most as long as an exchange does; if
        the answer does not arrive, the next exchange resynchronises the line.
        """
        frame = encode(opcode, data)
        if self._in_step:
            self._ask(frame, self.clock.now_ns() + self._answer_ns)
        else:
            self._send(frame)

    def _ask(self, frame: bytes, deadline_ns: int) -> bytes | None:
        """Send a frame; return the data of its answer, or None if none comes in time."""
        if not self._in_step and not self._find_step(deadline_ns):
            return None
        self._send(frame)
        # After an error in the wait for the answer, the answer may still arrive.
        self._in_step = False
        found = self._receive(min(deadline_ns, self.clock.now_ns() + self._answer_wait_ns))
        if (
            len(found) == 1
            and found[0].opcode == Opcode.ANSWER
            and len(found[0].data) >= ERROR.size
        ):
            self._in_step = True
            return found[0].data
        self.lost += 1
        return None

    def _find_step(self, deadline_ns: int) -> bool:
        """Resynchronise the line: ensure that no answer to an earlier request can still arrive."""
        if self._marks:
            # The marks are requested in turn, so that a late answer with an earlier mark is not
            # mistaken for the requested mark.
            self._marks.rotate(1)
            request, wanted = self._marks[0]
            self._send(request)
            while found := self._receive(deadline_ns):
                if found[-1].data == wanted:
                    self._in_step = True
                    return True
                # The time is checked too, because on a line with continuous noise there are always
                # more bytes.
                if self.clock.now_ns() >= deadline_ns:
                    break
            return False
        while self._receive(self.clock.now_ns() + _QUIET_NS):
            if self.clock.now_ns() >= deadline_ns:
                return False
        self._in_step = True
        return True

    def _learn_marks(self) -> None:
        """Read parts of the identities as marks, which show earlier answers."""
        marks: dict[bytes, bytes] = {}
        for node in self._nodes.values():
            for subindex in _SUBINDICES:
                fields = OBJECT.pack(node.node_id, IDENTITY, subindex)
                answer = self.request(Opcode.READ_OBJECT, fields, node.label)
                # Zero and error codes are no marks, because they may be answers to requests of
                # other objects.
                if answer.startswith(_ACCEPTED) and any(answer):
                    marks[answer] = encode(Opcode.READ_OBJECT, fields)
        self._marks = deque((request, answer) for answer, request in marks.items())

    def _send(self, frame: bytes) -> None:
        # The guard is told also if the port is lost: this program goes on trying.
        if self.guard is not None:
            self.guard.feed()
        port = self._opened()
        self._decoder.clear()
        try:
            port.discard()
            port.write(frame)
        except DeviceError:
            raise
        except Exception as error:
            raise self._gone(error) from error
        self._frames.extend(raw_frames(self.clock.now_ns(), _LINE, frame, True))

    def _receive(self, deadline_ns: int) -> list[Frame]:
        """Return the next received frames; none if no frame arrives before the deadline."""
        port = self._opened()
        clock = self.clock
        while True:
            left = deadline_ns - clock.now_ns()
            if self.guard is not None:
                self.guard.feed()
            try:
                data = port.read(min(max(left, 0), _LONGEST_WAIT_NS) / NS)
            except DeviceError:
                raise
            except Exception as error:
                raise self._gone(error) from error
            if data:
                self._frames.extend(raw_frames(clock.now_ns(), _LINE, data, False))
                if found := self._decoder.feed(data):
                    return found
            if left <= 0:
                return []

    def _connected(self) -> BytePort:
        advice = "check the name of the port, the adapter, and your permission to use it"
        return opened(self._connect, self._name, advice)

    def _opened(self) -> BytePort:
        """Return the port; a port whose adapter was unplugged is opened again by its name."""
        if self._port is None:
            if not self._lost:
                raise LinkError(f"{self._name} is not open: call open() first")
            self._port = self._connected()
            self._in_step = False
        return self._port

    def _gone(self, error: Exception) -> LinkError:
        if is_gone(error):
            self.close()
            self._lost = True
        return LinkError(f"{self._name} is gone: {words(error)}; check the adapter and its cable")
