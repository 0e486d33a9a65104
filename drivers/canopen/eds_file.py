"""Reads the object dictionary of a CANopen device from its EDS, DCF, XDD or XDC file, as far as
possible also from a faulty file.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from canopen.objectdictionary import (
    ObjectDictionary,
    ODArray,
    ODRecord,
    ODVariable,
    datatypes,
)

from drivers.canopen import xdd_text
from drivers.canopen.eds_text import Section, decode, integer, sections
from drivers.errors import ConfigurationError

_OBJECT: Final = re.compile(r"([0-9A-F]{4})(?:SUB([0-9A-F]{1,2}))?")
_VARIABLE, _ARRAY, _RECORD = 7, 8, 9
_DOMAIN: Final = 2
_LAST_STANDARD_TYPE: Final = 0x1B
_MOST_MEMBERS: Final = 254
_NODE: Final = re.compile(r"\+?\s*\$NODEID\s*\+?", re.IGNORECASE)
_BLOBS: Final = (datatypes.OCTET_STRING, datatypes.DOMAIN)
_TEXTS: Final = (datatypes.VISIBLE_STRING, datatypes.UNICODE_STRING)
Address = tuple[int, int]


class Described(ObjectDictionary):
    """Objects of a device as its EDS describes them.

    Attributes:
        faults: Index and subindex of each object whose description cannot be used, to the reason
            with file and line. Such an object is omitted.
        identity: Vendor number and product number in the header of the file; None for a number that
            the header does not state.
    """

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.faults: dict[Address, str] = {}
        self.identity: tuple[int | None, int | None] = (None, None)


def read_eds(eds: Path, node_id: int) -> Described:
    """Read the object dictionary of a device.

    Only the sections of objects are needed; an error in the header or in a comment is no error of
    this function.

    Args:
        eds: The file: EDS or DCF (CiA 306), or XDD or XDC (CiA 311).
        node_id: Node identifier, for values that depend on it.

    Raises:
        ConfigurationError: The file cannot be read, or describes no object.
    """
    try:
        if eds.exists() and not eds.is_file():
            raise OSError("the path leads to a pipe or a device; state the path of a file")
        content = eds.read_bytes()
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ConfigurationError(
            f"EDS file {eds} of node {node_id} cannot be read: {reason}; use the EDS file of this "
            "device"
        ) from error
    xml = xdd_text.is_xml(content)
    try:
        found = xdd_text.sections(content) if xml else sections(decode(content))
    except ValueError as error:
        line, reason = error.args
        raise ConfigurationError(f"{eds}:{line}: {reason}; use the file of this device") from error
    dictionary = _Reader(eds, node_id, found).dictionary()
    if not len(dictionary):
        expected = "element CANopenObject" if xml else "section like [1000]"
        why = next(iter(dictionary.faults.values()), f"{eds}:1: there is no {expected}")
        raise ConfigurationError(
            f"EDS file {eds} of node {node_id} describes no object: {why}; use the EDS file of "
            "this device"
        )
    return dictionary


def addresses(dictionary: ObjectDictionary) -> frozenset[Address]:
    """Return index and subindex of every object that can be read or written."""
    return frozenset(
        (variable.index, variable.subindex)
        for item in dictionary.values()
        for variable in ([item] if isinstance(item, ODVariable) else item.values())
    )


class _Reader:
    """Converts the sections of a file into objects.

    Args:
        eds: The file, for messages.
        node_id: Node identifier.
        found: Sections of the file, from :func:`~drivers.canopen.eds_text.sections`.
    """

    def __init__(self, eds: Path, node_id: int, found: Mapping[str, Section]) -> None:
        self._eds = eds
        self._node_id = node_id
        self._sections = found
        self._heads: dict[int, Section] = {}
        self._members: dict[int, dict[int, Section]] = {}
        for name, section in found.items():
            match = _OBJECT.fullmatch(name)
            if match is None:
                continue
            index = int(match[1], 16)
            if match[2] is None:
                self._heads[index] = section
            else:
                self._members.setdefault(index, {})[int(match[2], 16)] = section

    def dictionary(self) -> Described:
        """Return the objects that can be used, and the faults of the other objects."""
        described = Described()
        described.identity = self._header("VendorNumber"), self._header("ProductNumber")
        for index in sorted({*self._heads, *self._members}):
            item = self._item(index, described.faults)
            if item is not None:
                described.add_object(item)
        return described

    def _header(self, key: str) -> int | None:
        try:
            return integer(self._sections.get("DEVICEINFO", Section("", 0)).text(key))
        except ValueError:
            return None

    def _item(self, index: int, faults: dict[Address, str]) -> Any:
        head = self._heads.get(index, Section(f"{index:04X}", 1))
        kind = _VARIABLE
        with suppress(ValueError):
            kind = integer(head.text("ObjectType", str(_VARIABLE)))
        members = self._members.get(index, {})
        if kind not in (_ARRAY, _RECORD) and not (members and "datatype" not in head.values):
            for sub, section in members.items():
                if sub:
                    faults[index, sub] = (
                        f"{self._eds}:{section.line}: section [{section.name}] is not used, since "
                        f"[{head.name}] describes a single value"
                    )
            return self._variable(head, index, 0, faults)
        name = head.text("ParameterName", head.name)
        item = ODArray(name, index) if kind == _ARRAY else ODRecord(name, index)
        for variable in (
            *self._compact(head, index, faults),
            *(self._variable(section, index, sub, faults) for sub, section in members.items()),
        ):
            if variable is not None:
                item.add_member(variable)
        # The library canopen derives the members of an array from its first member.
        return item if len(item) and (kind != _ARRAY or 1 in item) else None

    def _compact(
        self, head: Section, index: int, faults: dict[Address, str]
    ) -> Iterator[ODVariable | None]:
        """Yield the members of an object that are described by one section (CiA 306, 4.5.2.4)."""
        count = 0
        with suppress(ValueError):
            count = integer(head.text("CompactSubObj", "0"))
        if count > 0:
            number = ODVariable("Number of entries", index, 0)
            number.data_type, number.access_type = datatypes.UNSIGNED8, "ro"
            yield number
        for sub in range(1, min(count, _MOST_MEMBERS) + 1):
            yield self._variable(head, index, sub, faults)

    def _variable(
        self, section: Section, index: int, subindex: int, faults: dict[Address, str]
    ) -> ODVariable | None:
        variable = ODVariable(section.text("ParameterName", section.name), index, subindex)
        try:
            variable.data_type = self._data_type(section)
            variable.pdo_mappable = bool(self._number(section, "PDOMapping", 0))
        except ValueError as error:
            faults[index, subindex] = str(error)
            return None
        variable.access_type = section.text("AccessType", "rw").lower()
        variable.min = self._limit(section, "LowLimit", variable)
        variable.max = self._limit(section, "HighLimit", variable)
        default = section.text("DefaultValue")
        variable.relative = _NODE.search(default) is not None
        with suppress(ValueError):
            variable.default = self._value(variable.data_type, default)
        return variable

    def _data_type(self, section: Section) -> int:
        """Return the data type of an object; raise ValueError with file and line if it is missing
        or invalid.
        """
        if "datatype" not in section.values:
            raise ValueError(
                f"{self._eds}:{section.line}: section [{section.name}] has no DataType"
            )
        kind = self._number(section, "DataType")
        if kind > _LAST_STANDARD_TYPE:
            # Some tools define a data type with limits in a section of its own, and state its
            # number.
            own = self._sections.get(f"{kind:X}SUB1", Section("", 0))
            kind = self._number(own, "DefaultValue", _DOMAIN)
        return kind

    def _number(self, section: Section, key: str, default: int | None = None) -> int:
        text = section.text(key)
        if not text and default is not None:
            return default
        try:
            return integer(text)
        except ValueError:
            raise ValueError(
                f"{self._eds}:{section.place(key)}: {key} of section [{section.name}] is "
                f"{text!r}; it must be a number such as 0x0007"
            ) from None

    def _limit(self, section: Section, key: str, variable: ODVariable) -> int | None:
        try:
            limit = integer(_NODE.sub("", section.text(key)))
        except ValueError:
            return None
        signed = variable.data_type in datatypes.SIGNED_TYPES
        # Some files state the limits of signed objects as unsigned numbers with the same bits.
        bits = len(variable)
        return limit - (1 << bits) if signed and limit >= 1 << (bits - 1) else limit

    def _value(self, kind: int, text: str) -> Any:
        if kind in _TEXTS:
            return text
        if not text:
            return None
        if kind in _BLOBS:
            return bytes.fromhex(text)
        if kind in datatypes.FLOAT_TYPES:
            return float(text)
        own = self._node_id if _NODE.search(text) else 0
        return integer(_NODE.sub("", text) or "0") + own
