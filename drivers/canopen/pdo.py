"""Host side of PDOs: configure them through canopen, pack and unpack them by struct."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final

from canopen.objectdictionary import ObjectDictionary, datatypes

from drivers.canopen.sdo import PumpedNode, translated, variable
from drivers.errors import ConfigurationError
from drivers.objects import PdoLayout

_MAX_BYTES: Final = 8
_CODES: Final[Mapping[int, str]] = {
    datatypes.INTEGER8: "b",
    datatypes.INTEGER16: "h",
    datatypes.INTEGER32: "i",
    datatypes.UNSIGNED8: "B",
    datatypes.UNSIGNED16: "H",
    datatypes.UNSIGNED32: "I",
}


class Input:
    """The last good frame of one TPDO.

    Attributes:
        layout: Layout of its values.
        slack: Age in cycles up to which it counts as fresh.
        values: Values of the last good frame.
        cycle: Cycle in which that frame came.
    """

    __slots__ = ("cycle", "layout", "size", "slack", "values")

    def __init__(self, layout: struct.Struct, every: int, slack: int = 0) -> None:
        self.layout = layout
        self.size = layout.size
        # The device chooses the phase of a slow PDO, so one more period is allowed.
        self.slack = slack if every == 1 else 2 * every
        self.values: tuple[int, ...] = layout.unpack(bytes(layout.size))
        self.cycle = -1


def packing(dictionary: ObjectDictionary, layout: PdoLayout) -> struct.Struct:
    """Return the packing of a PDO's values from the types in the device's EDS.

    Raises:
        ConfigurationError: An object is not in the EDS or not an integer, or the PDO exceeds 8
            bytes.
    """
    codes = "<"
    for index, subindex in layout.objects:
        item = variable(dictionary, index, subindex)
        if item.data_type not in _CODES:
            raise ConfigurationError(
                f"object {index:04X}h:{subindex:02X}h ({item.name}) is no integer of at most 32 "
                f"bits: leave it out"
            )
        codes += _CODES[item.data_type]
    packed = struct.Struct(codes)
    if packed.size > _MAX_BYTES:
        raise ConfigurationError(
            f"PDO {layout.number} would have {packed.size} bytes, limit {_MAX_BYTES}: split it"
        )
    return packed


def plan(remote: PumpedNode, maps: Any, layouts: Sequence[PdoLayout]) -> dict[int, struct.Struct]:
    """Return the packing of the PDOs of one direction, by number; sends nothing.

    Raises as :func:`configure`.
    """
    missing = {layout.number for layout in layouts} - set(maps)
    if missing:
        node_id = int(remote.id or 0)
        raise ConfigurationError(
            f"node {node_id} has no PDO {min(missing)} in its EDS; use the device's own EDS file"
        )
    return {layout.number: packing(remote.object_dictionary, layout) for layout in layouts}


def configure(
    remote: PumpedNode, maps: Any, layouts: Sequence[PdoLayout]
) -> list[tuple[int, struct.Struct]]:
    """Write the mapping of all PDOs of one direction into a device; PDOs not listed are disabled.

    Args:
        remote: The device.
        maps: Its ``rpdo`` or ``tpdo``.
        layouts: Objects to map; synchronous, every ``layout.every``-th SYNC.

    Returns:
        Identifier and packing of each layout.

    Raises:
        ConfigurationError: The EDS has no such PDO or object, or the PDO is too long.
        ObjectAccessError: The device refuses.
        LinkError: No answer.
    """
    node_id = int(remote.id or 0)
    packings = plan(remote, maps, layouts)
    wanted = {layout.number: layout for layout in layouts}
    identifiers: dict[int, int] = {}
    for number, pdo in maps.items():
        pdo.clear()
        pdo.cob_id = pdo.predefined_cob_id
        pdo.enabled = number in wanted
        if number in wanted:
            pdo.trans_type = wanted[number].every
            for address in wanted[number].objects:
                pdo.add_variable(*address)
            identifiers[number] = pdo.cob_id
        with translated(node_id, pdo.com_record.od.index, 0):
            pdo.save()
    return [(identifiers[layout.number], packings[layout.number]) for layout in layouts]
