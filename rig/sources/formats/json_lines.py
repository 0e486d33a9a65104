"""Reads logs with one JSON object per line."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path

from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.formats.json_numbers import numbers, parse, series
from rig.sources.formats.table import Table, damaged
from rig.sources.formats.text_layout import encoding_of, open_text


class JsonLinesTable(Table):
    """Table with one column for each number in the objects, named ``field``, ``field.inner`` or
    ``field[0]``.

    If a line lacks a field, the value is NaN.

    Raises:
        InputError: A line is not a JSON object, or no object contains a number.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._rows: list[dict[str, float]] = []
        self._lines: list[int] = []
        encoding = encoding_of(path)
        try:
            with open_text(path, "utf-8-sig" if encoding == "latin-1" else encoding) as stream:
                for line, text in enumerate(stream, start=1):
                    if text.strip():
                        self._take(line, text)
        except (OSError, EOFError, zlib.error) as error:
            raise damaged(path, error, "check that the file was copied completely") from error
        self.names = tuple(dict.fromkeys(field for row in self._rows for field in row))
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

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        found = []
        for k in columns:
            values, note = series(self._rows, self.names[k])
            if note:
                self.note(f"`{self.names[k]}`: {note}")
            found.append(values)
        return found

    def place(self, row: int) -> str:
        """Return the line number of a row."""
        return f"{self.path}:{self._lines[row]}" if row < len(self._lines) else str(self.path)
