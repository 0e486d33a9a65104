"""Divides the text of an EDS or DCF file (CiA 306) into sections with names, values and lines.

Files of makers differ from CiA 306 in ways that do not affect the objects: local encodings, a byte
order mark, text before the first section, repeated sections and keys. This module reads files as
most tools do, that is, as the Windows functions for INI files: names are not case-sensitive, and of
two values with one name the first is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache


@dataclass
class Section:
    """One section of the file.

    Attributes:
        name: Name of the section as in the file.
        line: Line of the section's head, counted from 1.
        values: Key in lower case to its value and line.
    """

    name: str
    line: int
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
