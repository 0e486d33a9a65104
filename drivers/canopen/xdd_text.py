"""Reads the objects of an XDD or XDC file (CiA 311) as the sections of an EDS file.

Such a file is an XML document with ISO 15745 profiles, of which one has a ``CANopenObjectList``. An
object may refer to a parameter of the application process for its type, access and default value.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final
from xml.parsers import expat

from drivers.canopen.eds_text import Section

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
