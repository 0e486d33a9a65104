"""Link to EPOS4 drives on a serial line; each request is sent after the answer to the previous
request has arrived.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from drivers.can.port import ANSWER_SHARE
from drivers.canopen.eds_file import read_eds
from drivers.canopen.link import require_node
from drivers.clock import NS, Clock
from drivers.epos.frames import ERROR, OBJECT, Frame, FrameDecoder, Opcode, encode
from drivers.epos.node import FASTEST_1_S, IDENTITY, EposSerialNode, Guard
from drivers.errors import LinkError
from drivers.interfaces import Link, RawFrame
from drivers.port_errors import close_all, is_gone, opened, require_one_cycle, words
from drivers.serial_port import BytePort, raw_frames

_FRAMES_KEPT: Final = 1 << 16
_LINE: Final = 0
_QUIET_NS: Final = 50_000_000
_ATTEMPTS: Final = 3
_LONGEST_WAIT_NS: Final = 50_000_000
"""Greatest duration of one wait for bytes, ns; between waits the guard is told that the program is
alive.
"""
_ACCEPTED: Final = ERROR.pack(0)
_SUBINDICES: Final = (1, 2, 3, 4)


def _nothing() -> None:
    """Do nothing: there is no other line."""


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

    Attributes:
        cycle: Number of exchanges so far.
        lost: Number of requests without a good answer so far.
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
        self.cycle = 0
        self.lost = 0
        self._at_instant: Callable[[], None] = _nothing
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
        """Have ``call`` called in every exchange at the instant at which the values of the drive
        hold, unless an answer is lost before.
        """
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

        Raises:
            LinkError: The line is gone.
        """
        frame = encode(opcode, data)
        if self._in_step:
            self._ask(frame, self.clock.now_ns() + self._answer_ns)
        else:
            self._send(frame)

    def _ask(self, frame: bytes, deadline_ns: int) -> bytes | None:
        """Send a frame and return the data of its answer, or None if no reliable answer arrives in
        time.
        """
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
        """Read several different parts of the drives' identities as marks, by which answers to
        earlier requests are detected.
        """
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
