"""Reads JSON files that contain records (a list of objects) or columns (an object of lists)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, cast

import numpy as np

from rig.common.errors import InputError
from rig.sources.table import EXACT, Array, Table
from rig.sources.text import encoding_of, nanoseconds, open_text

LONGEST_LIST = 64
"""Greatest length of a list whose elements become columns; longer lists are left out."""
_STAMPS = ({"sec", "nanosec"}, {"secs", "nsecs"}, {"sec", "nsec"}, {"seconds", "nanos"})
_LARGEST = 2**64
"""Integers with at least this magnitude are not read as numbers."""
_DATE_LENGTHS = range(8, 41)


class Stamp(int):
    """Time stamp, ns; its column is read as seconds since the first stamp of the topic."""


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


def stamp_of(value: Mapping[str, object]) -> Stamp | None:
    """Return the time stamp in an object of seconds and nanoseconds, or None."""
    parts = {key: part for key, part in value.items() if isinstance(part, int)}
    if set(parts) not in _STAMPS or len(parts) != len(value):
        return None
    whole, rest = (parts[key] for key in sorted(parts, key=lambda key: key[0] == "n"))
    return Stamp(whole * 10**9 + rest)


def numbers(value: object, prefix: str) -> Iterator[tuple[str, float]]:
    """Yield dotted name and value of every number inside a JSON message.

    An element of a list is ``name[0]``. A time stamp of seconds and nanoseconds gives one
    additional column, named by both keys; a date in text is one column.
    """
    if isinstance(value, dict):
        for key, child in value.items():
            yield from numbers(child, f"{prefix}.{key}" if prefix else str(key))
        if prefix and (stamp := stamp_of(value)) is not None:
            yield prefix, stamp
    elif isinstance(value, list):
        if len(value) <= LONGEST_LIST:
            for index, child in enumerate(value):
                yield from numbers(child, f"{prefix}[{index}]")
    elif (found := number(value)) is not None:
        yield prefix, found


_DEEPEST = 16
_FEWEST = 2
"""Least number of values with which a list counts as a column."""


_Rows = tuple[str, Sequence[Mapping[str, float]]]
"""Place of a list or object in the file, empty for the whole file, and its rows."""


class RowsTable(Table):
    """Rows of numbers by name, in one or several time bases, with NaN for what a row lacks."""

    def _lay_out(
        self, bases: Iterable[tuple[str, Sequence[Mapping[str, float]]]], prefixed: bool
    ) -> None:
        names, self._bases = zip(*bases, strict=True)
        self._columns = [
            (base, name)
            for base, rows in enumerate(self._bases)
            for name in dict.fromkeys(name for row in rows for name in row)
        ]
        self.base_names = names
        self.bases = tuple(base for base, _ in self._columns)
        self.names = tuple(
            f"{self.base_names[base]}.{name}" if prefixed and self.base_names[base] else name
            for base, name in self._columns
        )

    def _read(self, columns: Sequence[int]) -> list[Array]:
        found = []
        for k in columns:
            base, name = self._columns[k]
            values, note = series(self._bases[base], name)
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
        self._lay_out(tables, len(tables) > 1)
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
        self._lay_out([("", self._rows)], False)
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
