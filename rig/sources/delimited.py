"""Reader of delimited text (CSV and similar), plain or gzipped.

The fast path is numpy's compiled reader on the needed columns. If that refuses a line, the file is
read again with tolerance for empty cells, rows quoted as a whole and trailing commas.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TextIO, cast

import numpy as np

from drivers.plain_file import require_plain
from identification.recording import Array
from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.table import Table, damaged

_DELIMITERS = (";", "\t", "|", ",")
_EMPTY = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
_READ_ERRORS = (OSError, EOFError, zlib.error)


class DelimitedTable(Table):
    """A text file with one row of numbers per line, with or without a header line.

    Args:
        path: The file; read through gzip where it ends in ``.gz``.
        options: Delimiter and lines to skip.

    Raises:
        InputError: It holds no line after the skipped ones, or is damaged.
    """

    def __init__(self, path: Path, options: ReadSection) -> None:
        self.path = path
        try:
            with _open_text(path) as stream:
                skipped = [text for text in islice(stream, options.skip_rows) if text.strip()]
                line, text = _first_line(stream, options.skip_rows)
        except _READ_ERRORS as error:
            raise damaged(path, error, "check that it was copied whole") from error
        if text is None:
            where = f" after the {options.skip_rows} skipped lines" if options.skip_rows else ""
            raise InputError(f"{path}: the file is empty{where}")
        text = text.lstrip("\ufeff")
        if "\0" in text:
            raise InputError(
                f"{path}: line {line} holds zero bytes, so it is not text; name the file by its "
                f"format"
            )
        self._decimal = options.decimal
        self._delimiter = options.delimiter or _guess_delimiter(text, options.decimal)
        cells = _split(text, self._delimiter)
        has_header = not all(_is_number(self._pointed(cell)) for cell in cells)
        self._skip = line if has_header else line - 1
        last = _split(skipped[-1], self._delimiter) if skipped else []
        if len(last) == len(cells) > 1 and all(_is_number(self._pointed(cell)) for cell in last):
            self.notes = ("the last skipped line already holds numbers: check read.skip_rows",)
        self.names = tuple(cell.strip().lstrip("#").strip() if has_header else "" for cell in cells)

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        try:
            table = (
                self._read_fast(columns) if self._decimal == "." else self._read_tolerant(columns)
            )
        except ValueError:
            table = self._read_tolerant(columns)
        except _READ_ERRORS as error:
            raise damaged(self.path, error, "check that it was copied whole") from error
        if table.size == 0:
            raise InputError(f"{self.path}: no rows of numbers below line {self._skip}")
        return [table[:, k] for k in range(len(columns))]

    def place(self, row: int) -> str:
        """Name the line of a row, blank and comment lines counted."""
        with _open_text(self.path) as stream:
            for index, (line, _) in enumerate(self._rows(stream)):
                if index == row:
                    return f"{self.path}:{line}"
        return super().place(row)

    def _read_fast(self, columns: Sequence[int]) -> Array:
        with _open_text(self.path) as stream:
            if next(self._rows(stream), None) is None:
                return np.empty((0, len(columns)))
        return np.loadtxt(
            str(self.path.resolve()),
            delimiter=self._delimiter,
            skiprows=self._skip,
            usecols=list(columns),
            ndmin=2,
            encoding="latin-1",
        )

    def _read_tolerant(self, columns: Sequence[int]) -> Array:
        width = len(columns)
        with _open_text(self.path) as stream:
            values = np.fromiter(self._cells(stream, columns), np.float64)
        return values.reshape(-1, width)

    def _cells(self, stream: TextIO, columns: Sequence[int]) -> Iterator[float]:
        """Yield the required cells row by row.

        Raises:
            InputError: A cell is not a number, or a row is too short.
        """
        for line, text in self._rows(stream):
            cells = _split(text, self._delimiter)
            for column in columns:
                if column >= len(cells):
                    raise InputError(
                        f"{self.path}:{line}: {len(cells)} columns, but column "
                        f"{self._name(column)} is needed"
                        f" (got {text[:60]!r}); repair or remove the line"
                    )
                yield self._number(cells[column], line, column)

    def _number(self, cell: str, line: int, column: int) -> float:
        text = self._pointed(cell.strip(' "\t'))
        if text.lower() in _EMPTY:
            return float("nan")
        if _is_number(text):
            return float(text)
        if _is_number(text.replace(",", ".", 1)):
            hint = '; if that is a decimal comma, set read.decimal: ","'
        else:
            hint = (
                "; skip header lines with read.skip_rows"
                if line <= self._skip + 2
                else "; repair or remove the line"
            )
        raise InputError(
            f"{self.path}:{line}: column {self._name(column)} is not a number (got "
            f"{text[:60]!r}){hint}"
        )

    def _pointed(self, cell: str) -> str:
        """Return a cell with a decimal point."""
        return cell if self._decimal == "." else cell.replace(",", ".", 1)

    def _name(self, column: int) -> str:
        name = self.names[column] if column < len(self.names) else ""
        return f"{name!r}" if name else f"{column}"

    def _rows(self, stream: TextIO) -> Iterator[tuple[int, str]]:
        """Yield line number and text of each row of numbers."""
        for line, text in enumerate(stream, start=1):
            if line > self._skip:
                content = text.split("#", 1)[0].strip(" \r\n")
                if content:
                    yield line, content


def _open_text(path: Path) -> TextIO:
    require_plain(path)
    # Latin-1 decodes any byte, so that a degree sign in a vendor's header cannot stop the reading
    # of numbers.
    if path.suffix.lower() == ".gz":
        return cast(TextIO, gzip.open(path, "rt", encoding="latin-1"))
    return path.open(encoding="latin-1")


def _first_line(stream: TextIO, skip: int) -> tuple[int, str | None]:
    """Return number (from 1) and text of the first line with content; ``skip`` lines were read
    before.
    """
    for line, text in enumerate(stream, start=skip + 1):
        if text.strip():
            return line, _utf8(text)
    return 0, None


def _utf8(text: str) -> str:
    try:
        return text.encode("latin-1").decode("utf-8")
    except UnicodeDecodeError:
        return text


def _guess_delimiter(text: str, decimal: str) -> str:
    counts = {delimiter: text.count(delimiter) for delimiter in _DELIMITERS if delimiter != decimal}
    best = max(counts, key=lambda delimiter: counts[delimiter])
    return best if counts[best] else _DELIMITERS[-1] if decimal == "." else _DELIMITERS[0]


def _split(text: str, delimiter: str) -> list[str]:
    """Split one line into cells, undoing what spreadsheet programs add to it."""
    text = text.strip(" \r\n")
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


def _is_number(cell: str) -> bool:
    text = cell.strip(' "\t')
    if text.lower() in _EMPTY:
        return text != ""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
