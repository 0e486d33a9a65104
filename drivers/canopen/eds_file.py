"""Reads a CANopen object dictionary (EDS, DCF, XDD or XDC), also from a faulty file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable, datatypes

from drivers.errors import ConfigurationError


@dataclass
class Section:
    """One section of the file."""

    name: str  # name of the section as in the file
    line: int  # line of the section's head, counted from 1
    # Key in lower case to its value and line.
    values: dict[str, tuple[str, int]] = field(default_factory=dict)

    def text(self, key: str, default: str = "") -> str:
        """Return the value of a key; the default if the key is absent or its value is blank."""
        return self.values.get(key.lower(), (default, 0))[0] or default

    def place(self, key: str) -> int:
        """Return the line of a key; the line of the section if the key is absent."""
        return self.values.get(key.lower(), ("", self.line))[1]


def decode(content: bytes) -> str:
    """Return the text of a file. CiA 306 allows only ASCII, and the program uses only the ASCII
    text; names and comments may contain other bytes, in local encodings.
    """
    for encoding in ("utf-8-sig", "utf-16" if content[:2] in _WIDE else "latin-1"):
        try:
            return content.decode(encoding)
        except UnicodeDecodeError:
            continue
    return content.decode("latin-1")


_WIDE = (b"\xff\xfe", b"\xfe\xff")


@lru_cache(maxsize=4)
def sections(text: str) -> Mapping[str, Section]:
    """Return the sections by their names in upper case; lines that belong to no section are
    skipped.

    The results are cached, because a program that connects repeatedly reads the same few files each
    time.
    """
    found: dict[str, Section] = {}
    current: Section | None = None
    for number, raw in enumerate(text.split("\n"), start=1):
        line = raw.strip()
        if line.startswith("["):
            name = line[1:].partition("]")[0].strip()
            current = found.setdefault(name.upper(), Section(name, number))
        elif current is not None and not line.startswith((";", "#")) and "=" in line:
            key, _, value = line.partition("=")
            value = value.partition(" ;")[0].partition("\t;")[0].strip()
            current.values.setdefault(key.strip().lower(), (value, number))
    return found


def integer(text: str) -> int:
    """Return the number of a text: decimal, also with leading zeros, or hexadecimal with 0x.

    Raises:
        ValueError: The text is not a number.
    """
    # CiA 306 allows octal numbers, with a leading zero, but no value that is read here is octal;
    # some are decimal numbers with leading zeros.
    text = text.replace(" ", "")
    return int(text, 16 if text.lower().startswith("0x") else 10)


MOST_BYTES: Final = 16 << 20
"""Greatest size of a file; the largest files of makers have a tenth of this."""
_HEX: Final = frozenset("0123456789ABCDEFabcdef")
_KEYS: Final[Mapping[str, str]] = {
    "name": "parametername",
    "objectType": "objecttype",
    "dataType": "datatype",
    "accessType": "accesstype",
    "defaultValue": "defaultvalue",
    "lowLimit": "lowlimit",
    "highLimit": "highlimit",
}
"""Attribute of an object to the key of an EDS file."""
_TYPES: Final[Mapping[str, int]] = {
    **{"BOOL": 0x01, "SINT": 0x02, "INT": 0x03, "DINT": 0x04, "USINT": 0x05, "BYTE": 0x05},
    **{"UINT": 0x06, "WORD": 0x06, "UDINT": 0x07, "DWORD": 0x07, "REAL": 0x08, "STRING": 0x09},
    **{"LREAL": 0x11, "LINT": 0x15, "ULINT": 0x1B, "LWORD": 0x1B},
}
"""Element for the type of a parameter (IEC 61131-3) to the data type of CiA 301."""
_ACCESS: Final[Mapping[str, str]] = {
    **{"const": "const", "read": "ro", "write": "wo", "readWrite": "rw"},
    **{"readWriteInput": "rw", "readWriteOutput": "rw"},
}
_IDENTITY: Final[Mapping[str, str]] = {"vendorID": "vendornumber", "productID": "productnumber"}


def is_xml(content: bytes) -> bool:
    """Return whether a file is an XML document and not an EDS file."""
    return content.lstrip(b"\xef\xbb\xbf\xff\xfe\0 \t\r\n")[:1] == b"<"


@lru_cache(maxsize=4)
def xml_sections(content: bytes) -> Mapping[str, Section]:
    """Return the objects by the names that their sections would have in an EDS file.

    Raises:
        ValueError: The file is too large, no XML document, has a document type declaration (whose
            entities could have any size, or be read from other files), or describes an object
            without a valid index. The arguments are the line and the reason.
    """
    if len(content) > MOST_BYTES:
        raise ValueError(1, f"the file has {len(content)} bytes, limit {MOST_BYTES}")
    return _XmlReader().read(content)


class _XmlReader:
    """Collects the objects while the parser goes through the document."""

    def __init__(self) -> None:
        self._parser: Any = expat.ParserCreate(namespace_separator=" ")
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._text
        self._parser.StartDoctypeDeclHandler = self._refuse
        self._sections: dict[str, Section] = {}
        self._header = Section("DeviceInfo", 1)
        self._references: dict[str, str] = {}
        self._parameters: dict[str, dict[str, str]] = {}
        self._parameter: dict[str, str] | None = None
        self._index = ""
        self._named = ""
        self._lists = 0

    def read(self, content: bytes) -> Mapping[str, Section]:
        """Return the sections of a document."""
        try:
            self._parser.Parse(content, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise ValueError(
                error.lineno, f"the file is no valid XML document: {reason}"
            ) from error
        for name, reference in self._references.items():
            section = self._sections[name]
            for key, value in self._parameters.get(reference, {}).items():
                section.values.setdefault(key, (value, section.line))
        return {"DEVICEINFO": self._header, **self._sections}

    def _refuse(self, *_arguments: object) -> None:
        raise ValueError(
            self._parser.CurrentLineNumber,
            "the file has a document type declaration (<!DOCTYPE), which is not read: remove it",
        )

    def _start(self, element: str, attributes: dict[str, str]) -> None:
        kind = element.rpartition(" ")[2]
        if kind == "CANopenObjectList":
            self._lists += 1
        elif kind == "CANopenObject" and self._lists == 1:
            self._index = self._number(attributes, "index", 4)
            self._object(self._index, attributes)
        elif kind == "CANopenSubObject" and self._lists == 1:
            sub = self._number(attributes, "subIndex", 2)
            self._object(f"{self._index}sub{int(sub, 16):X}", attributes)
        elif kind in _IDENTITY:
            self._named = _IDENTITY[kind]
        elif kind == "parameter":
            access = _ACCESS.get(attributes.get("access", ""), "rw")
            self._parameter = {"accesstype": access}
            self._parameters[attributes.get("uniqueID", "")] = self._parameter
        elif self._parameter is not None and kind in _TYPES:
            self._parameter.setdefault("datatype", f"0x{_TYPES[kind]:04X}")
        elif self._parameter is not None and kind == "defaultValue":
            self._parameter.setdefault("defaultvalue", attributes.get("value", ""))

    def _end(self, element: str) -> None:
        self._named = ""
        if element.rpartition(" ")[2] == "parameter":
            self._parameter = None

    def _text(self, text: str) -> None:
        if self._named and text.strip():
            line = self._parser.CurrentLineNumber
            self._header.values.setdefault(self._named, (text.strip(), line))

    def _number(self, attributes: dict[str, str], name: str, digits: int) -> str:
        text = attributes.get(name, "").strip().upper().removeprefix("0X")
        if not 1 <= len(text) <= digits or not set(text) <= _HEX:
            raise ValueError(
                self._parser.CurrentLineNumber,
                f"{name} is {attributes.get(name)!r}; it must be a hexadecimal number of at most "
                f"{digits} digits",
            )
        return text.zfill(digits)

    def _object(self, name: str, attributes: dict[str, str]) -> None:
        line = self._parser.CurrentLineNumber
        section = Section(name, line)
        for attribute, key in _KEYS.items():
            if text := attributes.get(attribute, "").strip():
                if attribute == "dataType" and not text.lower().startswith("0x"):
                    text = f"0x{text}"
                section.values[key] = (text, line)
        mapping = attributes.get("PDOmapping", "no").strip()
        section.values["pdomapping"] = ("0" if mapping in ("no", "") else "1", line)
        if reference := attributes.get("uniqueIDRef", ""):
            self._references[name.upper()] = reference
        self._sections.setdefault(name.upper(), section)


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
    """Objects of a device as its EDS describes them."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        # Index and subindex of each object whose description cannot be used, to the reason with
        # file and line. Such an object is omitted.
        self.faults: dict[Address, str] = {}
        # Vendor number and product number in the header of the file; None for a number that the
        # header does not state.
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
    xml = is_xml(content)
    try:
        found = xml_sections(content) if xml else sections(decode(content))
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
    """Converts the sections of a file into objects."""

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
        """Return the data type; raise ValueError with file and line if it is invalid."""
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
