"""CANopen process data (PDOs) on the host: configured by SDO, packed and unpacked."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from canopen.objectdictionary import ObjectDictionary, datatypes
from canopen.sdo.exceptions import SdoAbortedError

from drivers.canopen.sdo import ONE_AXIS, Axis, variable
from drivers.errors import ConfigurationError, ObjectAccessError
from drivers.objects import ObjectAddress, PdoLayout, ProcessChannel, optional

_MAX_BYTES: Final = 8
PDO_BITS: Final = 8 * _MAX_BYTES
_CODES: Final[Mapping[int, str]] = {
    datatypes.INTEGER8: "b",
    datatypes.INTEGER16: "h",
    datatypes.INTEGER32: "i",
    datatypes.UNSIGNED8: "B",
    datatypes.UNSIGNED16: "H",
    datatypes.UNSIGNED32: "I",
}


class Input:
    """The last valid frame of one TPDO.

    Attributes:
        layout: Layout of the values in the frame.
        slack: Age of the frame, in cycles, up to which its values count as new.
        values: Values of the last valid frame.
        cycle: Cycle in which this frame was received.
    """

    __slots__ = ("cycle", "layout", "size", "slack", "values")

    def __init__(self, layout: struct.Struct, every: int, slack: int = 0) -> None:
        self.layout = layout
        self.size = layout.size
        # The device chooses in which cycle it first sends a PDO with a period of several cycles;
        # therefore the first frame may arrive up to one period later.
        self.slack = slack if every == 1 else 2 * every
        self.values: tuple[int, ...] = layout.unpack(bytes(layout.size))
        self.cycle = -1


def packing(
    dictionary: ObjectDictionary, layout: PdoLayout, axis: Axis = ONE_AXIS
) -> struct.Struct:
    """Return the binary format of a PDO, from the types of its objects in the device's EDS.

    Raises:
        ConfigurationError: An object is not in the EDS or not an integer, or the PDO exceeds 8
            bytes.
    """
    codes = "<"
    for index, subindex in (axis.at(dictionary, *address) for address in layout.objects):
        item = variable(dictionary, index, subindex)
        if item.data_type not in _CODES:
            raise ConfigurationError(
                f"object {index:04X}h:{subindex:02X}h ({item.name}) is no integer of at most 32 "
                "bits, so that it cannot be mapped into a PDO: remove the object from the bench "
                "file"
            )
        share = axis.share(dictionary, index, subindex)
        codes += _CODES[item.data_type] if share is None else ("H2x", "2xH")[share]
    packed = struct.Struct(codes)
    if packed.size > _MAX_BYTES:
        raise ConfigurationError(
            f"PDO {layout.number} would have {packed.size} bytes, but the limit is {_MAX_BYTES} "
            "bytes: divide the values among more PDOs"
        )
    return packed


@dataclass(frozen=True)
class Direction:
    """The PDOs of one direction of the device: receive (RPDO) or transmit (TPDO), CiA 301."""

    name: str  # name in messages
    # Index of the communication record of PDO 1; the mapping record has an index 200h higher.
    communication: int
    # CAN identifier of PDO 1 less the node identifier, in the predefined connection set.
    identifiers: int


RECEIVE: Final = Direction("RPDO", 0x1400, 0x200)
TRANSMIT: Final = Direction("TPDO", 0x1800, 0x180)
_PREDEFINED: Final = 4
_MOST: Final = 512
_MAPPING: Final = 0x200
_OFF: Final = 1 << 31
_NO_REMOTE: Final = 1 << 30
"""Bits of a COB-ID: "the PDO does not exist", and "no remote frame requests the PDO" (TPDO)."""
_IDENTIFIER: Final = 0x7FF
_NODE: Final = 0x7F
"""Bits of an identifier of the predefined connection set that contain the node identifier."""
_OUT_OF_RANGE: Final = 0x06090030
_READ_ONLY: Final = (0x06010002, 0x06010000)


def numbers(dictionary: ObjectDictionary, direction: Direction) -> list[int]:
    """Return the numbers of the PDOs of which the EDS describes both records."""
    first = direction.communication
    return [
        index - first + 1
        for index in dictionary
        if first <= index < first + _MOST and index + _MAPPING in dictionary
    ]


def plan(
    dictionary: ObjectDictionary,
    label: str,
    direction: Direction,
    layouts: Sequence[PdoLayout],
    axis: Axis = ONE_AXIS,
) -> dict[int, struct.Struct]:
    """Return the binary formats of the PDOs of one direction, by number. Nothing is sent.

    The errors are those of :func:`configure`.
    """
    missing = {layout.number for layout in layouts} - set(numbers(dictionary, direction))
    if missing:
        index = direction.communication + min(missing) - 1
        raise ConfigurationError(
            f"{label}: the device's EDS has no {direction.name} {min(missing)} ({index:04X}h, "
            f"{index + _MAPPING:04X}h), but the cyclic values need {len(layouts)} "
            f"{direction.name}s"
        )
    return {layout.number: packing(dictionary, layout, axis) for layout in layouts}


def accessed(direction: Direction, layouts: Sequence[PdoLayout]) -> Iterator[ObjectAddress]:
    """Yield the objects with which :func:`configure` begins the settings of each PDO."""
    for layout in layouts:
        index = direction.communication + layout.number - 1
        yield from ((index, 1), (index, 2), (index + _MAPPING, 0))


def configure(
    device: ProcessChannel,
    dictionary: ObjectDictionary,
    direction: Direction,
    layouts: Sequence[PdoLayout],
    axis: Axis = ONE_AXIS,
) -> list[tuple[int, struct.Struct]]:
    """Write the mapping of all PDOs of one direction into a device, and disable all other PDOs.

    A setting that already has the required value is not written, because it may be read-only. The
    flags of a COB-ID keep their values, because a device without remote frames refuses a COB-ID
    with bit 30 cleared.

    Args:
        device: The device, in PRE-OPERATIONAL.
        dictionary: Objects of the device.
        direction: Direction of the PDOs.
        axis: The axis whose objects are mapped.
        layouts: Objects to map; a PDO is synchronous, with every ``layout.every``-th SYNC.

    Returns:
        CAN identifier and binary format of each layout.

    Raises:
        ConfigurationError: The EDS has no such PDO or object, the PDO is too long, or the settings
            that are read back differ from those written.
        ObjectAccessError: The device refuses a setting; the message names the object.
        LinkError: No answer.
    """
    packings = plan(dictionary, device.label, direction, layouts, axis)
    wanted = {
        layout.number: replace(
            layout, objects=tuple(axis.at(dictionary, *address) for address in layout.objects)
        )
        for layout in layouts
    }
    identifiers: dict[int, int] = {}
    for number in numbers(dictionary, direction):
        index = direction.communication + number - 1
        if number in wanted:
            identifiers[number] = _map(device, dictionary, direction, wanted[number])
        elif (cob_id := optional(device.read, index, 1)) is not None:
            _switch_off(device, index, cob_id)
    return [(identifiers[layout.number], packings[layout.number]) for layout in layouts]


def _map(
    device: ProcessChannel, dictionary: ObjectDictionary, direction: Direction, layout: PdoLayout
) -> int:
    """Configure one PDO and return its CAN identifier."""
    index = direction.communication + layout.number - 1
    before = device.read(index, 1)
    fixed = not _switch_off(device, index, before)
    own = before & _IDENTIFIER
    if not fixed and layout.number <= _PREDEFINED:
        own = direction.identifiers + (layout.number - 1) * 0x100 + device.node_id
    elif own & _NODE != device.node_id:
        raise ConfigurationError(
            f"{device.label}: {direction.name} {layout.number} has the CAN identifier {own:03X}h, "
            f"which belongs to another node, and object {index:04X}h:01h is read-only: set the "
            "identifier with the maker's tool"
        )
    _store(device, index, 2, layout.every)
    _store_mapping(device, dictionary, index + _MAPPING, layout)
    if not fixed:
        _write_cob_id(device, index, before & _NO_REMOTE | own)
    return own


def _switch_off(device: ProcessChannel, index: int, cob_id: int) -> bool:
    """Disable a PDO; return False if the COB-ID is read-only and the PDO stays enabled."""
    if cob_id & _OFF:
        return True
    try:
        _write_cob_id(device, index, cob_id | _OFF)
    except ObjectAccessError as refused:
        if refused.code not in _READ_ONLY:
            raise
        return False
    return True


def _write_cob_id(device: ProcessChannel, index: int, cob_id: int) -> None:
    """Write a COB-ID; if the device refuses it, write it with the flag "no remote frames"."""
    try:
        device.write(index, 1, cob_id)
    except ObjectAccessError as refused:
        if refused.code != _OUT_OF_RANGE or index < TRANSMIT.communication or cob_id & _NO_REMOTE:
            raise
        device.write(index, 1, cob_id | _NO_REMOTE)


def _store_mapping(
    device: ProcessChannel, dictionary: ObjectDictionary, index: int, layout: PdoLayout
) -> None:
    entries = [
        address[0] << 16 | address[1] << 8 | len(variable(dictionary, *address))
        for address in layout.objects
    ]
    count = device.read(index, 0)
    if count == len(entries) and entries == [
        device.read(index, sub) for sub in range(1, count + 1)
    ]:
        return
    if count:
        device.write(index, 0, 0)
    for sub, (entry, address) in enumerate(zip(entries, layout.objects, strict=True), start=1):
        try:
            device.write(index, sub, entry)
        except ObjectAccessError as refused:
            raise ObjectAccessError(
                *(index, sub, refused.code),
                f"{device.label} refuses to map object {address[0]:04X}h:{address[1]:02X}h: "
                f"{SdoAbortedError.CODES.get(refused.code, 'unknown reason')}",
            ) from refused
    _store(device, index, 0, len(entries))


def _store(device: ProcessChannel, index: int, subindex: int, value: int) -> None:
    if device.read(index, subindex) != value:
        device.write(index, subindex, value)
