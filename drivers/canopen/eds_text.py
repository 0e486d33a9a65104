"""Sections of the text of an EDS or DCF file (CiA 306): names, values and their lines.

Makers' files differ from CiA 306 in ways that change no object: local encodings, a byte order mark,
text before the first section, repeated sections and keys. They are read as the Windows functions
for such files do, which most tools use: names without regard to case, the first of two values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass
class Section:
    """One section.

    Attributes:
        name: Name as in the file.
        line: Line of its head, from 1.
        values: Key in lower case to value and line.
    """

    name: str
    line: int
    values: dict[str, tuple[str, int]] = field(default_factory=dict)

    def text(self, key: str, default: str = "") -> str:
        """Return a value; the default where there is none or it is blank."""
        return self.values.get(key.lower(), (default, 0))[0] or default

    def place(self, key: str) -> int:
        """Return the line of a value; that of the section where there is none."""
        return self.values.get(key.lower(), ("", self.line))[1]


def decode(content: bytes) -> str:
    """Return a file's text. CiA 306 allows only ASCII, and only ASCII matters here; other bytes
    occur in names and comments, in local encodings.
    """
    for encoding in ("utf-8-sig", "utf-16" if content[:2] in _WIDE else "latin-1"):
        try:
            return content.decode(encoding)
        except UnicodeDecodeError:
            continue
    return content.decode("latin-1")


_WIDE = (b"\xff\xfe", b"\xfe\xff")


def sections(text: str) -> Mapping[str, Section]:
    """Return the sections by their names in upper case; lines that belong to none are skipped."""
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
    """Return a number: decimal, also with zeros in front, or hexadecimal with 0x.

    Raises:
        ValueError: It is none.
    """
    # Octal numbers of CiA 306 (a zero in front) are not used for any value that is read here, but
    # decimal ones with zeros in front are.
    text = text.replace(" ", "")
    return int(text, 16 if text.lower().startswith("0x") else 10)
