"""Reads the rows of a table as trees of values: each column names a key; a dot separates a key from
a key inside it.

A cell is read as text in a YAML file is; the key of an empty cell is left out.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rig.common.yaml_tree import DocumentError, Mark, Node, scalar

_DELIMITERS = ";\t,"


class _Entry(NamedTuple):
    """One cell: the keys that lead to its value, the place where its column is named, and its
    value.
    """

    keys: list[str]
    named: Mark
    value: Node


def csv_rows(text: str, path: Path) -> list[Node]:
    """Return the rows of a CSV file as mappings.

    The first line that is not a comment is the header, which names the columns; the delimiter is
    the semicolon, tab or comma that the header has. Lines that are empty or begin with ``#`` are
    left out.

    Args:
        text: Content of the file.
        path: The file, for the places of the values.

    Raises:
        DocumentError: The text is not CSV, the header is empty or has equal names, or the number of
            cells of a row differs from that of the header; the error's mark names the file.
    """
    lines = text.split("\n")
    used = [n for n, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if len(used) < 2:
        raise DocumentError(
            "a table needs a line that names its columns, and at least one row", Mark(1, 1, path)
        )
    head = lines[used[0]]
    delimiter = next((d for d in _DELIMITERS if d in head), ",")
    header: list[Node] = []
    rows = []
    for n in used:
        cells = _cells(lines[n], delimiter, Mark(n + 1, 1, path))
        if header:
            rows.append(row(header, cells, cells[0].mark))
        else:
            header = cells
    return rows


def _cells(line: str, delimiter: str, start: Mark) -> list[Node]:
    try:
        texts = next(csv.reader(io.StringIO(line.rstrip("\r")), delimiter=delimiter, strict=True))
    except csv.Error as error:
        raise DocumentError(f"not valid CSV: {error}", start) from error
    cells, column = [], 1
    for text in texts:
        cells.append(Node(text.strip(), Mark(start.line, column, start.file), {}))
        column += len(text) + 1
    return cells


def row(header: Sequence[Node], cells: Sequence[Node], place: Mark) -> Node:
    """Return one row as a mapping; cells that are text are read as in a YAML file.

    Args:
        header: Names of the columns.
        cells: Values of the row, one below each column name.
        place: Where the row starts.

    Raises:
        DocumentError: The numbers of names and cells differ, or a name is missing or given twice.
    """
    names = [name.value for name in header]
    if len(cells) != len(header):
        raise DocumentError(
            f"{len(cells)} cells under {len(header)} columns; add or remove cells", place
        )
    for name, node in zip(names, header, strict=True):
        if not isinstance(name, str) or not all(name.split(".")):
            raise DocumentError(f"a column must be named by a key (got {name!r})", node.mark)
        if names.count(name) > 1:
            raise DocumentError(f"two columns are named {name!r}; remove one column", node.mark)
    entries = [
        _Entry(str(name).split("."), node.mark, _value(cell))
        for name, node, cell in zip(names, header, cells, strict=True)
        if cell.value != ""
    ]
    return _nested(entries, place)


def _nested(entries: Sequence[_Entry], place: Mark) -> Node:
    """Return the entries as a mapping; entries that begin with the same key are together in an
    inner mapping.
    """
    children: dict[str, Node] = {}
    marks: dict[str, Mark] = {}
    for key in dict.fromkeys(entry.keys[0] for entry in entries):
        below = [e._replace(keys=e.keys[1:]) for e in entries if e.keys[0] == key]
        whole = [entry.value for entry in below if not entry.keys]
        if whole and len(below) > 1:
            raise DocumentError(
                f"one column names the key {key!r}, and another a key inside {key!r}; remove one "
                "of the columns",
                below[0].named,
            )
        marks[key] = below[0].named
        children[key] = whole[0] if whole else _nested(below, below[0].value.mark)
    return Node(children, place, marks)


def _value(cell: Node) -> Node:
    return Node(scalar(cell.value), cell.mark, {}) if isinstance(cell.value, str) else cell
