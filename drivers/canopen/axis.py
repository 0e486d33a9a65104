"""Place of one axis among the CiA 402 objects of a device with several axes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

from canopen.objectdictionary import ObjectDictionary, datatypes

from drivers.canopen.cia402 import STATUSWORD
from drivers.canopen.sdo import described
from drivers.objects import ObjectAddress

AXIS_OBJECTS: Final = 0x800
"""Number of indices of one axis (CiA 402-2): axis 1 has the objects from 6000h, axis 2 those from
6800h.
"""
_FIRST: Final = range(0x6000, 0x6000 + AXIS_OBJECTS)
_LISTS: Final = frozenset({0x60E3})
"""Objects without members of their own whose subindex 0 is used: the number of homing methods."""


@dataclass(frozen=True)
class Axis:
    """Addresses of the objects of one axis; the profile uses those of the first axis in CiA 402.

    Attributes:
        object_offset: Number that is added to the indices 6000h to 67FFh.
        sub_index: Subindex of the axis in each of these objects that has members instead of a
            single value; 0 for a device without such objects. A statusword 6041h:00h of 32 bits
            then contains the statuswords of the axes, the first one in the low 16 bits.
        unlike: Objects with another meaning than in CiA 402, which are not used.
    """

    object_offset: int = 0
    sub_index: int = 0
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
        """Return the number, from 0, of the 16 bits that belong to this axis in an object of this
        axis, or None if the whole object belongs to it.
        """
        if not self.sub_index or (index, subindex) != STATUSWORD:
            return None
        item = dictionary.get_variable(index, subindex)
        wide = item is not None and item.data_type == datatypes.UNSIGNED32
        return self.sub_index - 1 if wide and self.sub_index <= 2 else None


ONE_AXIS: Final = Axis()
