"""CANopen SDO client without threads, which receives frames itself while it waits for an answer."""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final, Protocol

from canopen.objectdictionary import ObjectDictionary, datatypes
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.canopen.cia402 import STATUSWORD
from drivers.errors import (
    ConfigurationError,
    LinkError,
    NotDescribedError,
    ObjectAccessError,
    RangeError,
)
from drivers.objects import ObjectAddress

_REQUEST, _ANSWER = 0x600, 0x580
_ABORTED = 0x80
_ABORTED_SOMETHING = bytes((_ABORTED, 0, 0, 0))
"""Object address in an abort message of a server that does not state the object."""
_LATE_ANSWERS = 64  # number of answers to other requests that are skipped
_STEP_S = 0.01  # longest wait for a response before a sign of the control loop may be due, s
_INITIATE = (1, 2)
"""Command specifiers with which a client starts a download or an upload (CiA 301, 7.2.4.3)."""


class Wire(Protocol):
    """Interface of the link that an SDO client uses."""

    sdo_timeout_s: float
    alive_until_ns: int

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame."""
        ...

    def pump(self, ready: Callable[[], bool], timeout_s: float) -> bool:
        """Dispatch frames until ``ready()`` is true; return False after ``timeout_s``."""
        ...

    def keep_alive(self) -> None:
        """Send the signs of the control loop that are due, until ``alive_until_ns``."""
        ...


class PumpedSdoClient(SdoClient):
    """SDO client that receives frames of the link while it waits, in simulated and in real time."""

    limit_s: float | None = None  # time-out of an answer, s; None for the time-out of the link

    def __init__(self, node_id: int, od: ObjectDictionary, wire: Wire) -> None:
        super().__init__(_REQUEST + node_id, _ANSWER + node_id, od)  # type: ignore[no-untyped-call]
        self._wire = wire
        self._asked: bytes | None = None

    def send_request(self, request: bytes) -> None:
        """Send a request and store the address of its object."""
        self._asked = bytes(request[1:4]) if request[0] >> 5 in _INITIATE else None
        self._wire.send(self.rx_cobid, bytes(request))

    def read_response(self) -> bytes:
        """Return the next response; a late response to an earlier request is skipped.

        If a late response were not skipped, every later request would receive the response to the
        previous request.

        Raises:
            SdoAbortedError: The server aborted the transfer.
            SdoCommunicationError: No response in time, or only responses to other requests.
        """
        for _ in range(_LATE_ANSWERS):
            wait_s = self._wire.sdo_timeout_s if self.limit_s is None else self.limit_s
            if not self._wait(wait_s):
                raise SdoCommunicationError(f"no SDO response within {wait_s:g} s")
            response: bytes = self.responses.get_nowait()
            if (
                self._asked is None
                or response[1:4] == self._asked
                or response[:4] == _ABORTED_SOMETHING
            ):
                if response[0] == _ABORTED:
                    raise SdoAbortedError(struct.unpack_from("<I", response, 4)[0])
                return response
        raise SdoCommunicationError(
            f"the first {_LATE_ANSWERS} SDO responses belong to other requests"
        )

    def _wait(self, wait_s: float) -> bool:
        """Wait for a response; meanwhile send the signs of the control loop that are due."""
        wire = self._wire
        wire.keep_alive()
        while wire.alive_until_ns and wait_s > _STEP_S:
            if wire.pump(lambda: not self.responses.empty(), _STEP_S):
                return True
            wait_s -= _STEP_S
            wire.keep_alive()
        return wire.pump(lambda: not self.responses.empty(), wait_s)


@contextmanager
def translated(node_id: int, index: int, subindex: int) -> Iterator[None]:
    """Convert the SDO errors of the library canopen into errors of this package.

    Raises:
        ObjectAccessError: The device refuses.
        LinkError: No answer.
    """
    try:
        yield
    except SdoAbortedError as error:
        reason = SdoAbortedError.CODES.get(error.code, "unknown reason")
        raise ObjectAccessError(
            index, subindex, error.code, f"node {node_id} refuses the access: {reason}"
        ) from error
    except SdoCommunicationError as error:
        raise LinkError(
            f"node {node_id}, object {index:04X}h:{subindex:02X}h: {error}; "
            "check power, cabling, termination, bit rate and node identifier"
        ) from error


def unfit(label: str, item: Any, value: int) -> ConfigurationError:
    """Return the error for a value that cannot be packed into an object."""
    what = (
        f"{label}: the value {value} does not fit into object "
        f"{item.index:04X}h:{item.subindex:02X}h ({item.name})"
    )
    signed = item.data_type in datatypes.SIGNED_TYPES
    if not (signed or item.data_type in datatypes.UNSIGNED_TYPES):
        return ConfigurationError(f"{what}, which is no integer")
    span = 1 << len(item)
    low, high = (-span // 2, span // 2 - 1) if signed else (0, span - 1)
    return RangeError(low, high, f"{what}, which holds {low} to {high}")


def variable(dictionary: ObjectDictionary, index: int, subindex: int) -> Any:
    """Find an object in the EDS.

    Raises:
        NotDescribedError: The EDS has no such object.
        ConfigurationError: The EDS describes the object wrongly.
    """
    found = dictionary.get_variable(index, subindex)
    # For an object without members, the library canopen returns the object itself for every
    # subindex.
    if found is None or found.subindex != subindex:
        fault = getattr(dictionary, "faults", {}).get((index, subindex))
        name = f"object {index:04X}h:{subindex:02X}h"
        if fault:
            raise ConfigurationError(f"{name} cannot be used: {fault}; correct the EDS file")
        raise NotDescribedError(f"{name} is not in the device's EDS")
    return found


def described(dictionary: ObjectDictionary, index: int, subindex: int, mappable: bool) -> bool:
    """Return whether the EDS contains an object and, with ``mappable``, allows the object in
    process data.

    An object whose description in the EDS is faulty counts as contained in the EDS, but not as
    allowed in process data.
    """
    if (index, subindex) in getattr(dictionary, "faults", {}):
        return not mappable
    found = dictionary.get_variable(index, subindex)
    return (
        found is not None
        and found.subindex == subindex
        and (not mappable or bool(found.pdo_mappable))
    )


AXIS_OBJECTS: Final = 0x800
"""Number of indices of one axis (CiA 402-2): axis 1 from 6000h, axis 2 from 6800h."""
_FIRST: Final = range(0x6000, 0x6000 + AXIS_OBJECTS)
_LISTS: Final = frozenset({0x60E3})
"""Objects without members of their own whose subindex 0 is used: the number of homing methods."""


@dataclass(frozen=True)
class Axis:
    """Addresses of the objects of one axis; the profile uses those of the first axis in CiA 402."""

    object_offset: int = 0  # number that is added to the indices 6000h to 67FFh
    # Subindex of the axis in each of these objects that has members instead of a single value; 0
    # for a device without such objects. A statusword 6041h:00h of 32 bits then contains the
    # statuswords of the axes, the first one in the low 16 bits.
    sub_index: int = 0
    # Objects with another meaning than in CiA 402, which are not used.
    unlike: Collection[ObjectAddress] = ()

    def at(self, dictionary: ObjectDictionary, index: int, subindex: int) -> ObjectAddress:
        """Return index and subindex of an object of the first axis in the objects of this axis."""
        if index not in _FIRST:
            return index, subindex
        index += self.object_offset
        if self.sub_index and not subindex and index not in _LISTS:
            subindex = self.sub_index * described(dictionary, index, self.sub_index, False)
        return index, subindex

    def share(self, dictionary: ObjectDictionary, index: int, subindex: int) -> int | None:
        """Return which 16 bits of an object belong to this axis, from 0; None for all its bits."""
        if not self.sub_index or (index, subindex) != STATUSWORD:
            return None
        item = dictionary.get_variable(index, subindex)
        wide = item is not None and item.data_type == datatypes.UNSIGNED32
        return self.sub_index - 1 if wide and self.sub_index <= 2 else None


ONE_AXIS: Final = Axis()
