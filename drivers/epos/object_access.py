"""Access to single objects of an EPOS4 on a serial line by ReadObject and WriteObject."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, Protocol

from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.exceptions import SdoAbortedError

from drivers.canopen.pdo import packing
from drivers.canopen.sdo import described, unfit, variable
from drivers.clock import Clock
from drivers.epos.frames import ERROR, LAST, OBJECT, SEGMENT_BYTES, TOGGLE, TOTAL, Opcode, segment
from drivers.errors import LinkError, ObjectAccessError
from drivers.objects import PdoLayout

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
        """Name of the device in messages."""
        return f"node {self.node_id}"

    def read(self, index: int, subindex: int = 0) -> int:
        """Read an integer object.

        Raises:
            ConfigurationError: The EDS has no such object, or the object is no integer of at most
                32 bits.
            ObjectAccessError: The device refuses.
            LinkError: No answer.
        """
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
        """Read a visible-string object; the errors are those of :meth:`read`."""
        return self.read_bytes(index, subindex).decode("ascii", errors="replace").rstrip("\0")

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object.

        Raises:
            ConfigurationError: The EDS has no such object, or the value does not fit its type.
            ObjectAccessError: The device refuses.
            LinkError: No answer.
        """
        self._request(Opcode.WRITE_OBJECT, self._written(index, subindex, value), index, subindex)

    def describes(self, index: int, subindex: int, mappable: bool = False) -> bool:
        """Return whether the EDS contains an object. Every object can be process data.

        Nothing is sent.
        """
        return described(self._dictionary, index, subindex, mappable=False)

    def fit_together(self, addresses: Sequence[tuple[int, int]]) -> bool:
        """Return True, because each object is requested on its own."""
        return True

    def stated(self, index: int, subindex: int) -> int | None:
        """Return the default value of an object in the EDS, or None without a default value,
        without sending anything.
        """
        item = self._dictionary.get_variable(index, subindex)
        default = None if item is None else item.default
        return default if isinstance(default, int) else None

    def require_fit(self, index: int, subindex: int, value: int) -> None:
        """Check that the EDS has an object and that a value fits the type of the object; the errors
        are those of :meth:`write`.

        Nothing is sent.
        """
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

        Raises:
            LinkError: The line is gone.
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
