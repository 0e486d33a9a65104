"""Reads JSON files that contain records (a list of objects) or columns (an object of lists)."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from identification.recording import Array
from rig.common.errors import InputError
from rig.config.campaign_columns import ReadSection
from rig.sources.formats.json_numbers import number, numbers, parse, series
from rig.sources.formats.table import Table, damaged
from rig.sources.formats.text_layout import encoding_of, open_text

_DEEPEST = 16
_FEWEST = 2
"""Least number of values with which a list counts as a column."""


@dataclass(frozen=True)
class _Rows:
    """Rows with the same names.

    Attributes:
        place: Place of the list or object in the file; empty for the whole file.
        rows: Numbers by column, one mapping per row.
    """

    place: str
    rows: Sequence[Mapping[str, float]]


class JsonTable(Table):
    """Table with one column for each number, named by its path in the file.

    These forms are read: a list of objects; a list of lists, whose first list is the header if it
    is text; an object whose lists are equally long; and the forms that pandas writes, ``split``
    (``columns`` and ``data``), ``table``, ``index`` and ``columns``. Each form may be inside an
    object; if a file has several tables, the names of the columns begin with the place of the
    table. A date in text is read as seconds since the first date.

    Raises:
        InputError: The file is not JSON, or has no numbers.
    """

    def __init__(self, path: Path, _: ReadSection) -> None:
        self.path = path
        self._left_out: list[str] = []
        encoding = encoding_of(path)
        try:
            with open_text(path, "utf-8-sig" if encoding == "latin-1" else encoding) as stream:
                text = stream.read()
        except (OSError, EOFError, zlib.error) as error:
            raise damaged(path, error, "check that the file was copied completely") from error
        try:
            found = list(self._tables(parse(text), "", 0))
        except (ValueError, RecursionError) as error:
            lines = sum(1 for line in islice(text.splitlines(), 3) if line.strip())
            several = lines > 1 and text.lstrip().startswith("{")
            remedy = "; one object a line is named .jsonl" if several else ""
            raise InputError(f"{path}: not JSON ({error}){remedy}") from error
        self._tables_found = [one for one in found if one.rows and any(one.rows)]
        words = "; ".join(self._left_out[:4])
        if not self._tables_found:
            raise InputError(
                f"{path}: holds no table of numbers{f' ({words})' if words else ''}; write a list "
                f"of objects, or an object whose lists are equally long"
            )
        if words:
            self.note(f"left out: {words}")
        several = len(self._tables_found) > 1
        self._columns = [
            (base, name)
            for base, one in enumerate(self._tables_found)
            for name in dict.fromkeys(name for row in one.rows for name in row)
        ]
        self.bases = tuple(base for base, _ in self._columns)
        self.base_names = tuple(
            f"{one.place or 'the file'} ({len(one.rows)} rows)" for one in self._tables_found
        )
        self.names = tuple(
            f"{self._tables_found[base].place}.{name}"
            if several and self._tables_found[base].place
            else name
            for base, name in self._columns
        )

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        self.require_one_base(columns)
        found = []
        for k in columns:
            base, name = self._columns[k]
            values, note = series(self._tables_found[base].rows, name)
            if note:
                self.note(f"`{self.names[k]}`: {note}")
            found.append(values)
        return found

    def _tables(self, value: Any, place: str, depth: int) -> Iterator[_Rows]:
        """Yield the tables inside a JSON value."""
        if depth > _DEEPEST:
            return
        if isinstance(value, list):
            yield from self._of_list(value, place)
        elif isinstance(value, dict):
            data, names = value.get("data"), value.get("columns")
            if isinstance(data, list) and _are_names(names):
                yield from self._matrix([names, *data], place)
            elif _are_labels(value) and all(isinstance(v, dict) for v in value.values()):
                yield _Rows(place, [dict(numbers(row, "")) for row in value.values()])
            else:
                yield from self._of_object(value, place, depth)

    def _of_list(self, value: list[Any], place: str) -> Iterator[_Rows]:
        if len(value) < _FEWEST:
            return
        if all(isinstance(row, dict) for row in value):
            yield _Rows(place, [dict(numbers(row, "")) for row in value])
        elif all(isinstance(row, list) for row in value):
            yield from self._matrix(value, place)
        elif all(not isinstance(cell, dict | list) for cell in value):
            yield _Rows(place, _transposed({"values": value}))
        else:
            self._left_out.append(f"{place or 'the file'} mixes objects, lists and values")

    def _of_object(self, value: dict[str, Any], place: str, depth: int) -> Iterator[_Rows]:
        """Yield the columns of an object, grouped by their length, then the tables inside its
        values.
        """
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
            yield _Rows(place, _transposed(columns))
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
        yield _Rows(place, _transposed(columns))


def _transposed(columns: Mapping[str, Sequence[Any]]) -> list[dict[str, float]]:
    """Return one mapping for each row from columns of equal length; values that are not numbers are
    left out.
    """
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
