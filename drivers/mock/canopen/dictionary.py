"""Object dictionary of a simulated CANopen device, with types, access and ranges of an EDS."""

from __future__ import annotations

import struct
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import canopen
from canopen.objectdictionary import ObjectDictionary, ODVariable

NO_OBJECT: Final = 0x06020000
NO_SUBINDEX: Final = 0x06090011
READ_ONLY: Final = 0x06010002
WRITE_ONLY: Final = 0x06010001
NOT_MAPPABLE: Final = 0x06040041
MAPPING_TOO_LONG: Final = 0x06040042
WRONG_LENGTH: Final = 0x06070010
OUT_OF_RANGE: Final = 0x06090030
DEVICE_STATE: Final = 0x08000022

_CODES: Final = {2: "b", 3: "h", 4: "i", 5: "B", 6: "H", 7: "I"}
"""Struct code of each CiA 301 data type, for the integer types that the devices use."""
_ENDS: Final = {
    code: (-(1 << 8 * size - 1), (1 << 8 * size - 1) - 1)
    if code.islower()
    else (0, (1 << 8 * size) - 1)
    for code, size in ((code, struct.calcsize(code)) for code in _CODES.values())
}
"""Least and greatest value of each struct code."""


class SdoAbortError(Exception):
    """An access that the device refuses."""

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort {code:08X}h")
        self.code = code


@dataclass(frozen=True)
class Entry:
    """One object; ``code`` is its struct code, or None for a visible string."""

    code: str | None
    readable: bool
    writable: bool
    mappable: bool
    low: int | None
    high: int | None
    default: int | str

    @property
    def size(self) -> int:
        """Number of bytes of the value; 0 for a string, whose length varies."""
        return struct.calcsize(self.code) if self.code else 0


def key(index: int, subindex: int = 0) -> int:
    """Return the dictionary key of an object."""
    return index << 8 | subindex


def held(code: str, value: int) -> int:
    """Return a value clamped to the range of a struct code."""
    low, high = _ENDS[code]
    return min(max(value, low), high)


def clamp_i16(value: int) -> int:
    """Return a value clamped to the range of an INTEGER16 object."""
    if -32768 <= value <= 32767:
        return value
    return 32767 if value > 0 else -32768


class DeviceDictionary:
    """Values of one device, with the checks of a real device.

    ``check`` hooks run before a value is stored and may raise :class:`SdoAbortError`; ``written``
    hooks run after.
    """

    def __init__(self, eds: Path, node_id: int) -> None:
        self.entries = dict(_load(eds, node_id))
        # Values of the integer objects by key (`index << 8 | subindex`).
        self.values: dict[int, int] = {}
        self.texts: dict[int, str] = {}  # texts of the string objects by key
        # Hooks `(subindex, value)` by index.
        self.checks: dict[int, Callable[[int, int], None]] = {}
        # Hooks `(subindex, value)` by index.
        self.written: dict[int, Callable[[int, int], None]] = {}
        # Indices of objects to which writes are acknowledged but ignored.
        self.deaf: frozenset[int] = frozenset()
        # Key that an object has on the bus to its key in this dictionary, for the objects that are
        # moved on the bus.
        self.places: Mapping[int, int] = {}
        self.reset(0, 0xFFFF)

    def remove_except(self, kept: Container[tuple[int, int]]) -> None:
        """Hide all objects except these from the bus; the device still uses them."""
        self.entries = {
            number: entry
            for number, entry in self.entries.items()
            if (number >> 8, number & 0xFF) in kept
        }

    def reset(self, first: int, last: int) -> None:
        """Reset the objects ``first`` to ``last`` to their defaults, without hooks."""
        for number, entry in self.entries.items():
            if first <= number >> 8 <= last:
                if isinstance(entry.default, str):
                    self.texts[number] = entry.default
                else:
                    self.values[number] = entry.default

    def integer(self, index: int, subindex: int = 0) -> int:
        """Return an integer value."""
        return self.values[key(index, subindex)]

    def kept(self, index: int, subindex: int = 0) -> int:
        """Return the value of an object; 0 if the device does not have it."""
        number = key(index, subindex)
        return self.values[number] if number in self.entries else 0

    def place(self, number: int) -> int:
        """Return the key in this dictionary of an object by its key on the bus.

        Raises:
            SdoAbortError: There is no such object or subindex.
        """
        own = self.places.get(number, number)
        if own not in self.entries or (own == number and number in self.places.values()):
            outside = self.places or self.entries
            known = any(other >> 8 == number >> 8 for other in outside)
            raise SdoAbortError(NO_SUBINDEX if known else NO_OBJECT)
        return own

    def entry(self, index: int, subindex: int) -> Entry:
        """Find an object; the errors are those of :meth:`place`."""
        return self.entries[self.place(key(index, subindex))]

    def read(self, index: int, subindex: int) -> bytes:
        """Return the encoded value, clamped to the range of the object."""
        number = self.place(key(index, subindex))
        entry = self.entries[number]
        if not entry.readable:
            raise SdoAbortError(WRITE_ONLY)
        if entry.code is None:
            return self.texts[number].encode("ascii")
        return struct.pack(f"<{entry.code}", held(entry.code, self.values[number]))

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Store an encoded value received by SDO."""
        number = self.place(key(index, subindex))
        entry = self.entries[number]
        index, subindex = number >> 8, number & 0xFF
        if not entry.writable:
            raise SdoAbortError(READ_ONLY)
        if entry.code is None or len(data) != entry.size:
            raise SdoAbortError(WRONG_LENGTH)
        value: int = struct.unpack(f"<{entry.code}", data)[0]
        if (entry.low is not None and value < entry.low) or (
            entry.high is not None and value > entry.high
        ):
            raise SdoAbortError(OUT_OF_RANGE)
        if check := self.checks.get(index):
            check(subindex, value)
        if index in self.deaf:
            return
        self.values[number] = value
        if written := self.written.get(index):
            written(subindex, value)


@lru_cache(maxsize=8)
def _load(eds: Path, node_id: int) -> Mapping[int, Entry]:
    # To read an EDS takes some 20 ms, and a series of simulated benches reads two EDS files again
    # and again.
    variables = _variables(canopen.import_od(str(eds), node_id))
    return {key(variable.index, variable.subindex): _entry(variable) for variable in variables}


def _variables(dictionary: ObjectDictionary) -> list[ODVariable]:
    found: list[ODVariable] = []
    for item in dictionary.values():
        found.extend([item] if isinstance(item, ODVariable) else item.values())
    return found


def _entry(variable: ODVariable) -> Entry:
    code = _CODES.get(variable.data_type or 0)
    return Entry(
        code=code,
        readable=variable.readable,
        writable=variable.writable,
        mappable=variable.pdo_mappable,
        low=variable.min,
        high=variable.max,
        default=variable.default if variable.default is not None else (0 if code else ""),
    )
