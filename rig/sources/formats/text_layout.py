"""What a delimited text file looks like: encoding, delimiter, header, units, times of day.

Pure functions of lines and cells, and the opening of a text file.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import TextIO, cast

from drivers.plain_file import require_plain

BLANKS = " "
"""The delimiter of columns aligned by blanks: any number of blanks or tabs."""
EMPTY = frozenset({"", "nan", "+nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-"})
DAY_NS = 86_400 * 10**9
"""A time with a date is at least this; a time of day alone is less."""
END_MARKS = frozenset({"eof", "end of file"})
_DELIMITERS = (";", "\t", "|", ",")
_WINDOWS_NAN = re.compile(r"[+-]?\d?\.?#(ind|q?nan|snan|inf)\d*|[+-]?nan\(.*\)", re.IGNORECASE)
"""Not-a-numbers and infinities as the C library of Windows writes them."""
_DAY = re.compile(
    r"(?:(\d{4})[-/](\d{1,2})[-/](\d{1,2})[T ]\s*)?(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,9}))?\s*"
    r"(?:Z|UTC|([+-])(\d{2}):?(\d{2}))?",
    re.IGNORECASE,
)
_COMMENT = re.compile(r"\s#(?!n/a|ind|inf|q?nan|snan)", re.IGNORECASE)
_UNIT_LENGTH = 24
_QUOTED = re.compile(r'"(?:[^"]|"")*"|[^\s"]+')


def open_text(path: Path, encoding: str) -> TextIO:
    """Open a plain text file, through gzip where its name ends in ``.gz``.

    Raises:
        OSError: It cannot be opened.
    """
    require_plain(path)
    if path.suffix.lower() == ".gz":
        return cast(TextIO, gzip.open(path, "rt", encoding=encoding, errors="replace"))
    return path.open(encoding=encoding, errors="replace")


def encoding_of(path: Path) -> str:
    """Return the encoding that the first bytes show: UTF-16, or else Latin-1.

    Latin-1 decodes any byte, so that a degree sign in a vendor's header cannot stop the reading of
    numbers.

    Raises:
        OSError, EOFError, zlib.error: It cannot be read.
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
    """Return a line that was read as Latin-1 as UTF-8 where it is that."""
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
    """Split one line into cells, undoing what spreadsheet programs add to it."""
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
    """Whether a cell says that there is no value."""
    return cell.lower() in EMPTY or _WINDOWS_NAN.fullmatch(cell) is not None


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, or a word for a missing one."""
    text = cell.strip(' "\t')
    if is_empty(text):
        return text != ""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def without_comment(text: str) -> str:
    """Return a line without a comment: a # that begins the line or follows a blank.

    A # inside a cell, as in ``-1.#IND``, begins none.
    """
    if "#" in text:
        if text.lstrip().startswith("#"):
            return ""
        text = _COMMENT.split(text, maxsplit=1)[0]
    return text.strip(" \r\n")


def counts_columns(cells: Sequence[str], below: Sequence[str]) -> bool:
    """Whether the first line is 0, 1, 2, ...: the header of a table whose columns have no names.

    Args:
        cells: Of the first line.
        below: Of the next line with content; numbers with decimals there tell two columns apart
            from two whole numbers.
    """
    if [cell.strip(' "') for cell in cells] != [str(k) for k in range(len(cells))]:
        return False
    return len(cells) > 2 or (len(cells) == 2 and any("." in cell for cell in below))


def are_units(cells: Sequence[str], width: int) -> bool:
    """Whether a line below the names holds no number but short words, as units are.

    A dash stands for no unit where another cell has one.
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
    """Return a date and time, or a time of day, in ns since the year 1; None where it is neither.

    The date comes year first (ISO 8601); an offset from UTC is taken off.
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
