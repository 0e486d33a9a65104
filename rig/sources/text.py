"""Reads text files, plain or gzipped: delimited text (CSV and similar), and JSON with records (a
list of objects, or one object a line) or columns (an object of lists).

The rows of a delimited file may have empty cells, quotes, row names, dates and times, and trailing
commas.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import date
from itertools import chain, islice, repeat
from operator import itemgetter
from pathlib import Path
from typing import Any, TextIO, cast

import numpy as np

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.table import EXACT, Array, Column, Table, open_binary

BLANKS = " "  # symbol for the delimiter of aligned columns: any number of blanks or tabs
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
    """Open a text file, decompressed by gzip if its name ends in ``.gz``; OSError if it fails."""
    return io.TextIOWrapper(open_binary(path), encoding, errors="replace")


def encoding_of(path: Path) -> str:
    """Return the encoding: UTF-16 if the first bytes show this, else Latin-1, which never fails."""
    with open_binary(path) as stream:
        head = stream.read(64)
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    even, odd = head[0::2], head[1::2]
    if len(head) >= 8 and not any(odd) and all(even):
        return "utf-16-le"
    if len(head) >= 8 and not any(even) and all(odd):
        return "utf-16-be"
    return "latin-1"


def _utf8(text: str) -> str:
    """Return a line that was decoded as Latin-1, decoded as UTF-8 if its bytes are UTF-8."""
    try:
        return text.encode("latin-1").decode("utf-8").lstrip("\ufeff")
    except UnicodeError:
        return text.lstrip("\ufeff")


def _guess_delimiter(lines: Sequence[str], decimal: str) -> str:
    """Return the delimiter of the first lines with content, header first."""
    text = lines[0]
    counts = {delimiter: text.count(delimiter) for delimiter in _DELIMITERS if delimiter != decimal}
    best = max(counts, key=lambda delimiter: counts[delimiter])
    if counts[best]:
        return best
    quoted = [split(line, ",") if '"' in line else [] for line in lines[-2:]]
    if decimal == "," and all(len(cells) > 1 and _numbers(cells, decimal) for cells in quoted):
        return ","
    widths = {len(split(line, BLANKS)) for line in lines[1:] or lines}
    plain = not any(mark in line for line in lines[1:] for mark in _DELIMITERS if mark != decimal)
    if (
        plain
        and len(widths) == 1
        and min(widths) > 1
        and _numbers(split(lines[-1], BLANKS), decimal)
    ):
        return BLANKS
    return "," if decimal == "." else ";"


def _numbers(cells: Sequence[str], decimal: str) -> bool:
    return all(_is_number(pointed(cell, decimal)) for cell in cells)


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


def _is_empty(cell: str) -> bool:
    """Return whether a cell is empty or contains a word for a missing value."""
    return cell.lower() in EMPTY or _WINDOWS_NAN.fullmatch(cell) is not None


def _is_number(cell: str) -> bool:
    text = cell.strip(' "\t')
    if _is_empty(text):
        return text != ""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _without_comment(text: str) -> str:
    """Return a line without its comment; a comment starts with a # at the start of the line or
    after a blank.

    A # inside a cell, as in ``-1.#IND``, starts no comment.
    """
    if "#" in text:
        if text.lstrip().startswith("#"):
            return ""
        text = _COMMENT.split(text, maxsplit=1)[0]
    return text.strip(" \r\n")


def _counts_columns(cells: Sequence[str], below: Sequence[str]) -> bool:
    """Return whether the first line is 0, 1, 2, ...: the header of columns without names."""
    if [cell.strip(' "') for cell in cells] != [str(k) for k in range(len(cells))]:
        return False
    return len(cells) > 2 or (len(cells) == 2 and any("." in cell for cell in below))


def _are_units(cells: Sequence[str], width: int) -> bool:
    """Return whether a line below the names has units: short words, no number, dashes for none."""
    given = [cell.strip(' "\t') for cell in cells]
    words = [word for word in given if word != "-"]
    return (
        len(given) <= width
        and any(words)
        and not any(_is_number(word) or _is_number(pointed(word, ",")) for word in words)
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


_MOST_DIGITS = 300  # number of digits up to which a double represents every integer exactly
_HEAD_LINES = 6
"""Number of lines with content at the start of the file from which the layout is detected."""


class DelimitedTable(Table):
    """A text file with one row of numbers per line, with or without a header line."""

    def __init__(self, path: Path, options: ReadSection) -> None:
        self.path = path
        self._encoding = encoding_of(path)
        with open_text(path, self._encoding) as stream:
            skipped = [text for text in islice(stream, options.skip_rows) if text.strip()]
            head = _head(stream, options.skip_rows)
        if not head:
            where = f" after the {options.skip_rows} skipped lines" if options.skip_rows else ""
            raise InputError(f"{path}: the file is empty{where}")
        line, text = head[0]
        if "\0" in text:
            raise InputError(
                f"{path}: line {line} contains zero bytes, so that the file is not text; use the "
                "file extension of its format"
            )
        self._decimal = options.decimal
        self._delimiter = options.delimiter or _guess_delimiter(
            [text for _, text in head], options.decimal
        )
        self._detect(head)
        above = split(skipped[-1], self._delimiter) if skipped else []
        if len(above) == len(self.names) > 1 and _numbers(above, self._decimal):
            self.note("the last skipped line contains numbers: check read.skip_rows")

    def _detect(self, head: Sequence[tuple[int, str]]) -> None:
        """Detect header, units, row names and columns of dates in the first lines."""
        line, text = head[0]
        cells = split(text, self._delimiter)
        rows = [(at, split(row, self._delimiter)) for at, row in head[1:] if _without_comment(row)]
        counted = bool(rows) and _counts_columns(cells, rows[0][1])
        has_header = counted or not all(_is_number(self._pointed(cell)) for cell in cells)
        if has_header and any(nanoseconds(cell) is not None for cell in cells):
            # A row of dates and numbers is data, because the name of a column is not a date.
            has_header = not all(
                _is_number(self._pointed(cell)) or nanoseconds(cell) is not None for cell in cells
            )
        if not has_header:
            rows.insert(0, (line, cells))
        self.names = tuple(cell.strip().lstrip("#").strip() if has_header else "" for cell in cells)
        self._skip = line if has_header else line - 1
        self._first_row = 0
        if self._encoding != "latin-1":
            self.note(f"text in {self._encoding.upper()}")
        if self._delimiter == BLANKS:
            self.note("columns separated by blanks")
        if counted:
            self.note(
                f"line {line} numbers the columns from 0 to {len(cells) - 1}: read as the header"
            )
        while has_header and len(rows) > 1 and _are_units(rows[0][1], len(cells)):
            at, words = rows.pop(0)
            self.units = tuple(word.strip(' "\t') for word in words)
            self._skip = at
            self.note(f"line {at} below the names read as units: {', '.join(self.units)[:80]}")
        self._has_header = has_header
        self._find_row_names(head, rows)
        self._find_dates(rows)

    def _find_row_names(
        self, head: Sequence[tuple[int, str]], rows: Sequence[tuple[int, list[str]]]
    ) -> None:
        """Detect row names: a word or quoted cell before the cells that the header names."""
        width = len(self.names)
        if not self._has_header or not rows or any(len(row) != width + 1 for _, row in rows):
            return
        lines = dict(head)
        if all(_names_its_row(lines[at], row[0]) for at, row in rows):
            self._first_row = 1
            self.note("the first cell of each row is a row name, for which the header has no name")

    def _find_dates(self, rows: Sequence[tuple[int, list[str]]]) -> None:
        self._zero: dict[int, int] = {}
        for column, cell in enumerate(rows[0][1][self._first_row :] if rows else ()):
            when = nanoseconds(cell)
            digits = cell.strip(' "\t-+')
            if digits.isdecimal() and int(digits[:_MOST_DIGITS]) > EXACT:
                self.note(
                    f"column {self._name(column)} holds integers beyond 2^53: rounded to multiples "
                    f"of {np.spacing(float(digits)):.0f}"
                )
            if when is not None and column < len(self.names):
                dated = when >= DAY_NS
                self._zero[column] = when if dated else 0
                what, since = (
                    ("dates", cell.strip()[:40]) if dated else ("times of day", "midnight")
                )
                self.note(
                    f"column {self._name(column)} holds {what}: read as seconds since {since}"
                )

    def _read(self, columns: Sequence[int]) -> list[Array]:
        with open_text(self.path, self._encoding) as stream:
            cells = chain.from_iterable(self._numbers(stream, columns))
            table = np.fromiter(cells, np.float64).reshape(-1, len(columns))
        if table.size == 0:
            raise InputError(f"{self.path}: no rows of numbers below line {self._skip}")
        return [table[:, k] for k in range(len(columns))]

    def place(self, row: int) -> str:
        """Return the line number of a row; blank lines and comment lines are counted."""
        with open_text(self.path, self._encoding) as stream:
            for index, (line, _) in enumerate(self._rows(stream)):
                if index == row:
                    return f"{self.path}:{line}"
        return super().place(row)

    def _numbers(self, stream: TextIO, columns: Sequence[int]) -> Iterator[list[float]]:
        """Yield the required cells of each row; rows without values are missing samples."""
        empty = short = 0
        places = [column + self._first_row for column in columns]
        # With one place, itemgetter would return no tuple.
        pick = itemgetter(*places) if len(places) > 1 else lambda cells: [cells[places[0]]]
        for line, text in self._rows(stream):
            numbers = self._plain_numbers(text, pick)
            if numbers is None:
                cells = [cell.strip(' "\t') for cell in split(text, self._delimiter)]
                if cells[0].lower() in END_MARKS and not any(cells[1:]):
                    self._end(stream, line, cells[0])
                    break
                if not any(cells):
                    empty += 1
                    continue
                short += self._check_width(cells, line)
                numbers = []
                for place, column in zip(places, columns, strict=True):
                    if place >= len(cells):
                        raise InputError(
                            f"{self.path}:{line}: {len(cells)} columns, but column "
                            f"{self._name(column)} is needed (got {text[:60]!r}); repair or remove "
                            "the line"
                        )
                    numbers.append(self._number(cells[place], line, column))
            if empty:
                yield from repeat([math.nan] * len(columns), empty)
                empty = 0
            yield numbers
        if empty:
            self.note(f"{empty} rows without values at the end dropped")
        if short:
            self.note(f"{short} rows have fewer cells than the first line: read from the left")

    def _plain_numbers(
        self, text: str, pick: Callable[[list[str]], Iterable[str]]
    ) -> list[float] | None:
        """Return the required cells of a row that needs no further care, which is fast."""
        if self._decimal != "." or self._zero or '"' in text or "_" in text:
            return None
        cells = text.split(None if self._delimiter == BLANKS else self._delimiter)
        if len(cells) != len(self.names) + self._first_row:
            return None
        try:
            return list(map(float, pick(cells)))
        except ValueError:
            return None

    def _end(self, stream: TextIO, line: int, mark: str) -> None:
        if any(text.strip() for text in stream):
            raise InputError(
                f"{self.path}:{line}: {mark}, but more lines follow; if the file ends here, remove "
                f"the lines that follow, otherwise remove this line"
            )
        self.note(f"line {line} ({mark}) read as the end of the file")

    def _check_width(self, cells: Sequence[str], line: int) -> bool:
        """Reject a row that is longer than the header; return whether it is shorter."""
        width = len(self.names) + self._first_row
        if not any(cells[width:]):
            return len(cells) < width
        what = "names in the header" if self._has_header else "cells in the first row"
        remedy = (
            "name every column in the header (in R, write.table(..., col.names = NA) also names "
            "the column of row names), or skip the header with read.skip_rows and give columns "
            "by index"
            if len(cells) == width + 1
            else "repair the line, or check read.delimiter and read.skip_rows"
        )
        raise InputError(
            f"{self.path}:{line}: {len(cells)} cells, but {width} {what}, so that the names of "
            f"the columns are uncertain; {remedy}"
        )

    def _number(self, text: str, line: int, column: int) -> float:
        if column in self._zero:
            when = nanoseconds(text)
            if when is not None:
                return (when - self._zero[column]) * 1e-9
        text = self._pointed(text)
        if _is_empty(text):
            if "#" in text or "(" in text:
                self.note(f"cells such as {text[:20]} read as missing samples")
            return float("nan")
        if _is_number(text) and column not in self._zero:
            return float(text)
        if _is_number(text.replace(",", ".", 1)):
            hint = '; if the comma is a decimal comma, set read.decimal: ","'
        else:
            hint = (
                "; skip header lines with read.skip_rows, or use a column of numbers"
                if line <= self._skip + 2
                else "; repair or remove the line"
            )
        raise InputError(
            f"{self.path}:{line}: column {self._name(column)} is not a number (got "
            f"{text[:60]!r}){hint}"
        )

    def _pointed(self, cell: str) -> str:
        return pointed(cell, self._decimal)

    def _name(self, column: int) -> str:
        name = self.names[column] if column < len(self.names) else ""
        return f"{name!r}" if name else f"{column}"

    def _rows(self, stream: TextIO) -> Iterator[tuple[int, str]]:
        for line, text in enumerate(stream, start=1):
            if line == 1:
                # A byte-order mark, decoded as UTF-8 or Latin-1.
                text = text.removeprefix("\ufeff").removeprefix("\xef\xbb\xbf")
            if line > self._skip and (content := _without_comment(text)):
                yield line, content


def _names_its_row(line: str, cell: str) -> bool:
    """Return whether the first cell is a row name: a word, or quoted if the next cell is not."""
    rest = line.lstrip()
    return (rest.startswith('"') and rest.count('"') == 2) or not _is_number(cell)


def _head(stream: TextIO, skip: int) -> list[tuple[int, str]]:
    """Return number (from 1) and text of the first lines with content after ``skip`` lines."""
    found: list[tuple[int, str]] = []
    for line, text in enumerate(stream, start=skip + 1):
        if found and (text.strip().lower() in END_MARKS or not _without_comment(text)):
            continue
        if text.strip().lstrip("\ufeff"):
            found.append((line, _utf8(text)))
            if len(found) == _HEAD_LINES:
                break
    return found


LONGEST_LIST = 64
"""Greatest length of a list whose elements become columns; longer lists are left out."""
_STAMPS = ({"sec", "nanosec"}, {"secs", "nsecs"}, {"sec", "nsec"}, {"seconds", "nanos"})
_LARGEST = 2**64  # integers with at least this magnitude are not read as numbers
_DATE_LENGTHS = range(8, 41)


class Stamp(int):
    """Time stamp, ns; its column is read as seconds since the first stamp of the topic."""


class Duration(dict[str, Any]):
    """Seconds and nanoseconds of a duration; its column is in s."""


def parse(text: str) -> Any:
    """Parse JSON; ValueError also for a key that an object has twice, or RecursionError."""
    return json.loads(text, object_pairs_hook=_object)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"an object has the key {twice[:40]!r} twice")
    return found


def series(rows: Sequence[Mapping[str, float]], field: str) -> tuple[Array, str]:
    """Return one field of all rows, shape (n,), with NaN for rows that lack the field; and a note.

    Stamps are read as seconds since the first stamp, because nanoseconds since 1970 exceed the 53
    bits of a double. Other integers beyond 2^53 are likewise read as differences from the first
    integer.
    """
    known = [row.get(field) for row in rows]
    first = next((stamp for stamp in known if isinstance(stamp, Stamp)), None)
    if first is not None:
        seconds = [(s - first) / 1e9 if isinstance(s, Stamp) else np.nan for s in known]
        return np.array(seconds, np.float64), ""
    whole = [cast(int, v) for v in known if isinstance(v, int)]
    if not any(abs(v) > EXACT for v in whole):
        return np.array([np.nan if value is None else value for value in known], np.float64), ""
    if any(isinstance(v, float) for v in known):
        rounded = np.array([np.nan if value is None else float(value) for value in known])
        return rounded, "integers beyond 2^53 between fractions: rounded to doubles"
    differences = [np.nan if v is None else float(cast(int, v) - whole[0]) for v in known]
    note = f"integers beyond 2^53: read as the difference to the first, {whole[0]}"
    return np.array(differences, np.float64), note


def number(value: object) -> float | None:
    """Return a JSON value as a number, integer or :class:`Stamp` (date), or None."""
    if isinstance(value, bool | float):
        return float(value)
    if isinstance(value, int):
        return value if abs(value) < _LARGEST else None
    if isinstance(value, str) and len(value) in _DATE_LENGTHS and ":" in value:
        when = nanoseconds(value)
        return None if when is None else Stamp(when)
    return None


def _time_in(value: Mapping[str, object]) -> float | None:
    """Return the time stamp or duration in an object of seconds and nanoseconds, or None."""
    parts = {key: part for key, part in value.items() if isinstance(part, int)}
    if set(parts) not in _STAMPS or len(parts) != len(value):
        return None
    whole, rest = (parts[key] for key in sorted(parts, key=lambda key: key[0] == "n"))
    time_ns = whole * 10**9 + rest
    return time_ns / 1e9 if isinstance(value, Duration) else Stamp(time_ns)


def numbers(value: object, prefix: str) -> Iterator[tuple[str, float]]:
    """Yield dotted name and value of every number inside a message.

    An element of a list is ``name[0]``. A time stamp of seconds and nanoseconds gives one
    additional column, named by both keys; a date in text is one column.
    """
    if isinstance(value, dict):
        for key, child in value.items():
            yield from numbers(child, f"{prefix}.{key}" if prefix else str(key))
        if prefix and (time := _time_in(value)) is not None:
            yield prefix, time
    elif isinstance(value, list):
        if len(value) <= LONGEST_LIST:
            for index, child in enumerate(value):
                yield from numbers(child, f"{prefix}[{index}]")
    elif (found := number(value)) is not None:
        yield prefix, found


_DEEPEST = 16
_FEWEST = 2  # least number of values with which a list counts as a column


_Rows = tuple[str, Sequence[Mapping[str, float]]]
"""Place of a list or object in the file, empty for the whole file, and its rows."""


class RowsTable(Table):
    """Rows of numbers by name, in one or several time bases, with NaN for what a row lacks."""

    def _take_rows(self, bases: Iterable[_Rows], prefixed: bool) -> None:
        base_names, self._bases = zip(*bases, strict=True)
        columns = [
            Column(f"{place}.{name}" if prefixed and place else name, name, base=base)
            for base, (place, rows) in enumerate(zip(base_names, self._bases, strict=True))
            for name in dict.fromkeys(name for row in rows for name in row)
        ]
        self._lay_out(columns, base_names)

    def _read(self, columns: Sequence[int]) -> list[Array]:
        found = []
        for k in columns:
            values, note = series(self._bases[self.bases[k]], self._sources[k])
            if note:
                self.note(f"`{self.names[k]}`: {note}")
            found.append(values)
        return found


class JsonTable(RowsTable):
    """Table with one column for each number, named by its path in the file.

    These forms are read: a list of objects; a list of lists, whose first list is the header if it
    is text; an object whose lists are equally long; and the forms that pandas writes, ``split``
    (``columns`` and ``data``), ``table``, ``index`` and ``columns``. Each form may be inside an
    object; if a file has several tables, the names of the columns begin with the place of the
    table. A date in text is read as seconds since the first date.
    """

    def __init__(self, path: Path, _: object = None) -> None:
        self.path = path
        self._left_out: list[str] = []
        encoding = encoding_of(path)
        with open_text(path, "utf-8-sig" if encoding == "latin-1" else encoding) as stream:
            text = stream.read()
        try:
            found = list(self._tables(parse(text), "", 0))
        except (ValueError, RecursionError) as error:
            lines = sum(1 for line in islice(text.splitlines(), 3) if line.strip())
            several = lines > 1 and text.lstrip().startswith("{")
            remedy = "; one object a line is named .jsonl" if several else ""
            raise InputError(f"{path}: not JSON ({error}){remedy}") from error
        tables = [(place, rows) for place, rows in found if any(rows)]
        words = "; ".join(self._left_out[:4])
        if not tables:
            raise InputError(
                f"{path}: holds no table of numbers{f' ({words})' if words else ''}; write a list "
                f"of objects, or an object whose lists are equally long"
            )
        if words:
            self.note(f"left out: {words}")
        self._take_rows(tables, len(tables) > 1)
        self.base_names = tuple(
            f"{place or 'the file'} ({len(rows)} rows)" for place, rows in tables
        )

    def _tables(self, value: Any, place: str, depth: int) -> Iterator[_Rows]:
        if depth > _DEEPEST:
            return
        if isinstance(value, list):
            yield from self._of_list(value, place)
        elif isinstance(value, dict):
            data, names = value.get("data"), value.get("columns")
            if isinstance(data, list) and _are_names(names):
                yield from self._matrix([names, *data], place)
            elif _are_labels(value) and all(isinstance(v, dict) for v in value.values()):
                yield place, [dict(numbers(row, "")) for row in value.values()]
            else:
                yield from self._of_object(value, place, depth)

    def _of_list(self, value: list[Any], place: str) -> Iterator[_Rows]:
        if len(value) < _FEWEST:
            return
        if all(isinstance(row, dict) for row in value):
            yield place, [dict(numbers(row, "")) for row in value]
        elif all(isinstance(row, list) for row in value):
            yield from self._matrix(value, place)
        elif all(not isinstance(cell, dict | list) for cell in value):
            yield place, _transposed({"values": value})
        else:
            self._left_out.append(f"{place or 'the file'} mixes objects, lists and values")

    def _of_object(self, value: dict[str, Any], place: str, depth: int) -> Iterator[_Rows]:
        """Yield the columns of an object by their length, then the tables inside its values."""
        lengths: dict[int, dict[str, list[Any]]] = {}
        rest: dict[str, Any] = {}
        for key, child in value.items():
            plain = isinstance(child, list) and len(child) >= _FEWEST
            if plain and not any(isinstance(cell, dict | list) for cell in child):
                lengths.setdefault(len(child), {})[key] = child
            else:
                rest[key] = child
        labelled = {k: v for k, v in rest.items() if isinstance(v, dict) and _are_labels(v)}
        groups: dict[tuple[str, ...], dict[str, list[Any]]] = {}
        for key, child in labelled.items():
            if not any(isinstance(cell, dict | list) for cell in child.values()):
                groups.setdefault(tuple(child), {})[key] = list(child.values())
                del rest[key]
        for columns in (*lengths.values(), *groups.values()):
            yield place, _transposed(columns)
        for key, child in rest.items():
            yield from self._tables(child, f"{place}.{key}" if place else key, depth + 1)

    def _matrix(self, rows: list[Any], place: str) -> Iterator[_Rows]:
        """Yield the rows of a list of lists; if the first row is text, it names the columns."""
        width = len(rows[0])
        where = place or "the file"
        for index, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != width:
                count = f"{len(row)} values" if isinstance(row, list) else "no list"
                self._left_out.append(
                    f"row {index} of {where} has {count}, but the first has {width}"
                )
                return
        named = _are_names(rows[0]) and not all(number(name) is not None for name in rows[0])
        names = rows[0] if named else [f"[{k}]" for k in range(width)]
        if len(set(names)) < width:
            self._left_out.append(f"{where} names a column twice")
            return
        data = rows[1:] if named else rows
        columns = {name: [row[k] for row in data] for k, name in enumerate(names)}
        yield place, _transposed(columns)


def _transposed(columns: Mapping[str, Sequence[Any]]) -> list[dict[str, float]]:
    """Return one mapping for each row of columns of equal length, without what is no number."""
    count = len(next(iter(columns.values()))) if columns else 0
    rows: list[dict[str, float]] = [{} for _ in range(count)]
    for name, cells in columns.items():
        for row, cell in zip(rows, cells, strict=True):
            found = number(cell)
            if found is not None:
                row[name] = found
    return rows


def _are_names(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, str) for v in value)


def _are_labels(value: Mapping[str, Any]) -> bool:
    """Return whether the keys are row numbers or time stamps in the form that pandas writes."""
    return len(value) >= _FEWEST and all(key.isdigit() for key in value)


class JsonLinesTable(RowsTable):
    """Table of the numbers in one object a line: ``field``, ``field.inner`` or ``field[0]``."""

    def __init__(self, path: Path, _: object = None) -> None:
        self.path = path
        self._rows: list[dict[str, float]] = []
        self._lines: list[int] = []
        encoding = encoding_of(path)
        with open_text(path, "utf-8-sig" if encoding == "latin-1" else encoding) as stream:
            for line, text in enumerate(stream, start=1):
                if text.strip():
                    self._take(line, text)
        self._take_rows([("", self._rows)], False)
        if not self.names:
            raise InputError(f"{path}: no JSON object contains a number")

    def _take(self, line: int, text: str) -> None:
        try:
            value = parse(text)
        except (ValueError, RecursionError) as error:
            if self._rows and not text.endswith("\n"):
                self.notes = (*self.notes, f"line {line} is incomplete: dropped")
                return
            raise InputError(
                f"{self.path}:{line}: not JSON ({error}); write one object a line"
            ) from error
        if not isinstance(value, dict):
            raise InputError(f"{self.path}:{line}: not a JSON object; write one object a line")
        self._rows.append(dict(numbers(value, "")))
        self._lines.append(line)

    def place(self, row: int) -> str:
        """Return the line number of a row."""
        return f"{self.path}:{self._lines[row]}" if row < len(self._lines) else str(self.path)
