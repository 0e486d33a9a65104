"""Detects the layout of a delimited text file: encoding, delimiter, header, units, dates and times.

Except for those that open a file, the functions depend only on lines and cells.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import TextIO, cast

from rig.common.places import require_plain

BLANKS = " "
"""Symbol for the delimiter of aligned columns: any number of blanks or tabs."""
EMPTY = frozenset({"", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-"})
DAY_NS = 86_400 * 10**9
"""Least value of a time with a date, ns; a time of day without a date is smaller."""
END_MARKS = frozenset({"eof", "end of file"})
_DELIMITERS = (";", "\t", "|", ",")
_WINDOWS_NAN = re.compile(r"[+-]?\d?\.?#(ind|q?nan|snan|inf)\d*|[+-]?nan\(.*\)", re.IGNORECASE)
"""NaN and infinity in the form in which the C library of Windows writes them."""
_DAY = re.compile(
    r"(?:(\d{4})[-/](\d{1,2})[-/](\d{1,2})[T ]\s*)?(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,9}))?\s*"
    r"(?:Z|UTC|([+-])(\d{2}):?(\d{2}))?",
    re.IGNORECASE,
)
_COMMENT = re.compile(r"\s#(?!n/a|ind|inf|q?nan|snan)", re.IGNORECASE)
_UNIT_LENGTH = 24
_QUOTED = re.compile(r'"(?:[^"]|"")*"|[^\s"]+')


def open_text(path: Path, encoding: str) -> TextIO:
    """Open a text file; it is decompressed by gzip if its name ends in ``.gz``.

    Raises:
        OSError: The file cannot be opened.
    """
    require_plain(path)
    if path.suffix.lower() == ".gz":
        return cast(TextIO, gzip.open(path, "rt", encoding=encoding, errors="replace"))
    return path.open(encoding=encoding, errors="replace")


def encoding_of(path: Path) -> str:
    """Return the encoding of a file: UTF-16 if its first bytes show this, else Latin-1.

    Latin-1 decodes every byte, so that a degree sign in the header of a file cannot prevent the
    reading of numbers.

    Raises:
        OSError, EOFError, zlib.error: The file cannot be read.
    """
    require_plain(path)
    with gzip.open(path) if path.suffix.lower() == ".gz" else path.open("rb") as stream:
        head = stream.read(64)
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    even, odd = head[0::2], head[1::2]
    if len(head) >= 8 and not any(odd) and all(even):
        return "utf-16-le"
    if len(head) >= 8 and not any(even) and all(odd):
        return "utf-16-be"
    return "latin-1"


def utf8(text: str) -> str:
    """Return a line that was decoded as Latin-1; if the bytes of the line are UTF-8, return the
    line decoded as UTF-8.
    """
    try:
        return text.encode("latin-1").decode("utf-8").lstrip("\ufeff")
    except UnicodeError:
        return text.lstrip("\ufeff")


def guess_delimiter(lines: Sequence[str], decimal: str) -> str:
    """Return the delimiter of the first lines with content, header first."""
    text = lines[0]
    counts = {delimiter: text.count(delimiter) for delimiter in _DELIMITERS if delimiter != decimal}
    best = max(counts, key=lambda delimiter: counts[delimiter])
    if counts[best]:
        return best
    if decimal == "," and all(_quoted_between_commas(line) for line in lines[-2:]):
        return ","
    widths = {len(split(line, BLANKS)) for line in lines[1:] or lines}
    plain = not any(mark in line for line in lines[1:] for mark in _DELIMITERS if mark != decimal)
    if plain and len(widths) == 1 and min(widths) > 1 and _numbers(lines[-1], decimal):
        return BLANKS
    return "," if decimal == "." else ";"


def _quoted_between_commas(line: str) -> bool:
    cells = split(line, ",")
    return '"' in line and len(cells) > 1 and all(is_number(pointed(cell, ",")) for cell in cells)


def _numbers(line: str, decimal: str) -> bool:
    return all(is_number(pointed(cell, decimal)) for cell in split(line, BLANKS))


def split(text: str, delimiter: str) -> list[str]:
    """Split one line into cells, without the characters that spreadsheet programs add."""
    text = text.strip(" \r\n")
    if delimiter == BLANKS:
        found = text.split() if '"' not in text else _QUOTED.findall(text)
        return [cell.strip('"') for cell in found]
    if delimiter != ",":
        text = text.rstrip(",")
    if (
        len(text) > 1
        and text[0] == text[-1] == '"'
        and text.count('"') % 2 == 0
        and f'"{delimiter}"' not in text
    ):
        text = text[1:-1].replace('""', '"')
    if '"' not in text:
        return text.split(delimiter)
    cells, quoted = [""], False
    for character in text:
        if character == '"':
            quoted = not quoted
        elif character == delimiter and not quoted:
            cells.append("")
        else:
            cells[-1] += character
    return cells


def pointed(cell: str, decimal: str) -> str:
    """Return a cell with a decimal point."""
    return cell if decimal == "." else cell.replace(",", ".", 1)


def is_empty(cell: str) -> bool:
    """Return whether a cell is empty or contains a word for a missing value."""
    return cell.lower() in EMPTY or _WINDOWS_NAN.fullmatch(cell) is not None


def is_number(cell: str) -> bool:
    """Return whether a cell contains a number, or a word for a missing number."""
    text = cell.strip(' "\t')
    if is_empty(text):
        return text != ""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def without_comment(text: str) -> str:
    """Return a line without its comment; a comment starts with a # at the start of the line or
    after a blank.

    A # inside a cell, as in ``-1.#IND``, starts no comment.
    """
    if "#" in text:
        if text.lstrip().startswith("#"):
            return ""
        text = _COMMENT.split(text, maxsplit=1)[0]
    return text.strip(" \r\n")


def counts_columns(cells: Sequence[str], below: Sequence[str]) -> bool:
    """Return whether the first line is 0, 1, 2, ...: the header of a table whose columns have no
    names.

    Args:
        cells: Cells of the first line.
        below: Cells of the next line with content. If there are two columns, the first line counts
            as a header only if these cells of the next line have decimals.
    """
    if [cell.strip(' "') for cell in cells] != [str(k) for k in range(len(cells))]:
        return False
    return len(cells) > 2 or (len(cells) == 2 and any("." in cell for cell in below))


def are_units(cells: Sequence[str], width: int) -> bool:
    """Return whether a line below the names is a line of units: only short words and no number.

    A dash means no unit if another cell has a unit.
    """
    given = [cell.strip(' "\t') for cell in cells]
    words = [word for word in given if word != "-"]
    return (
        len(given) <= width
        and any(words)
        and not any(is_number(word) or is_number(pointed(word, ",")) for word in words)
        and not any(nanoseconds(word) is not None for word in words)
        and all(len(word) <= _UNIT_LENGTH for word in words)
        and given[0].lower() not in END_MARKS
    )


def nanoseconds(cell: str) -> int | None:
    """Return a date and time, or a time of day, in ns since the year 1, or None for any other cell.

    A date must start with the year (ISO 8601); an offset from UTC is subtracted.
    """
    match = _DAY.fullmatch(cell.strip(' "\t'))
    if match is None:
        return None
    year, month, day, hour, minute, second, fraction, sign, hours, minutes = match.groups()
    try:
        days = date(int(year), int(month), int(day)).toordinal() if year else 0
    except ValueError:
        return None
    seconds = days * 86400 + int(hour) * 3600 + int(minute) * 60 + int(second)
    if sign:
        offset = int(hours) * 3600 + int(minutes) * 60
        seconds -= offset if sign == "+" else -offset
    return seconds * 10**9 + int((fraction or "0").ljust(9, "0"))
