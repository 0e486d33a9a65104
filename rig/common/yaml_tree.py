"""Parses YAML text into a tree with the position of each value.

Only plain data are accepted: mappings with text keys, lists, and the scalars of the YAML 1.2 core
schema, so that ``1e3`` is a number and ``on`` or ``2020-01-01`` stay text. Anchors are allowed,
with a limit on their expansion.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.reader import Reader

from rig.common.places import require_plain

MAX_BYTES = 1 << 20
MAX_DEPTH = 40
MAX_NODES = 200_000

Scalar = str | int | float | bool | None
_CORE = "tag:yaml.org,2002:"


@dataclass(frozen=True)
class Mark:
    """A place in a file, counted from 1."""

    line: int
    column: int
    file: Path | None = None


@dataclass(frozen=True)
class Node:
    """One value and the place at which it starts."""

    value: Scalar | list[Node] | dict[str, Node]
    mark: Mark
    keys: Mapping[str, Mark]

    def plain(self) -> Any:
        """Return dicts, lists and scalars without marks."""
        if isinstance(self.value, dict):
            return {key: child.plain() for key, child in self.value.items()}
        if isinstance(self.value, list):
            return [child.plain() for child in self.value]
        return self.value

    def walk(self) -> Iterator[Node]:
        """Yield this value and all values in it."""
        yield self
        below = list(self.value.values()) if isinstance(self.value, dict) else self.value
        for child in below if isinstance(below, list) else ():
            yield from child.walk()

    def over(self, under: Node) -> Node:
        """Return this value, with the keys that it lacks from another one."""
        if not isinstance(under.value, dict) or not isinstance(self.value, dict):
            return self
        both = {k: v.over(under.value[k]) for k, v in self.value.items() if k in under.value}
        children = {**under.value, **self.value, **both}
        return Node(children, self.mark, {**under.keys, **self.keys})


class DocumentError(Exception):
    """The text is not usable YAML from ``mark`` on."""

    def __init__(self, message: str, mark: Mark | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.mark = mark or Mark(1, 1)


# libyaml is eight times as fast, but PyYAML may be built without it.
_Parser: Any = (Composer, yaml.CSafeLoader) if yaml.__with_libyaml__ else (yaml.SafeLoader,)


class _Loader(*_Parser):  # type: ignore[misc]
    """Composes nodes with limited depth; scalars are those of the YAML 1.2 core schema."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - the base class owns this attribute
    depth = 0

    def __init__(self, text: str) -> None:
        _Parser[-1].__init__(self, text)
        Composer.__init__(self)

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose one node, refusing nesting that would exhaust the stack."""
        if self.depth > MAX_DEPTH:
            mark = _mark(parent.start_mark if parent else None)
            raise DocumentError(f"nested deeper than {MAX_DEPTH} levels; use fewer levels", mark)
        self.depth += 1
        try:
            node: yaml.Node | None = super().compose_node(parent, index)
            return node
        finally:
            self.depth -= 1


_SCALARS = (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    (
        "float",
        r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        "-+.0123456789",
    ),
)
for _name, _pattern, _first in _SCALARS:
    # Order matters: the first pattern that matches names the type, so integers come before floats.
    _Loader.add_implicit_resolver(_CORE + _name, re.compile(f"^(?:{_pattern})$"), list(_first))


def scalar(text: str) -> Scalar:
    """Return the value that plain text, such as a cell of a table, would have in YAML."""
    kinds = (name for name, pattern, _ in _SCALARS if re.fullmatch(pattern, text))
    return _scalar(yaml.ScalarNode(_CORE + next(kinds, "str"), text), Mark(1, 1))


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file."""
    try:
        if path.is_dir():
            raise DocumentError("is a folder; name a YAML file")
        require_plain(path)
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise DocumentError(f"{size} bytes; configuration files hold at most {MAX_BYTES} bytes")
        raw = path.read_bytes()
    except FileNotFoundError:
        raise DocumentError(f"no such file{_nearby(path)}") from None
    except OSError as error:
        raise DocumentError(f"cannot be read: {error.strerror or error}") from error
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        mark = Mark(before.count(b"\n") + 1, error.start - before.rfind(b"\n"))
        message = f"byte 0x{raw[error.start]:02X} is not UTF-8; save the file as UTF-8"
        raise DocumentError(message, mark) from error


def parse(text: str) -> tuple[Node, list[tuple[Mark, str, str]]]:
    """Parse one YAML document whose top level is a mapping.

    Returns:
        The tree, and the duplicate keys as (mark, key, message); the tree has the first of the
        duplicates.
    """
    if (wrong := Reader.NON_PRINTABLE.search(text)) is not None:
        before = text[: wrong.start()]
        mark = Mark(before.count("\n") + 1, wrong.start() - before.rfind("\n"))
        raise DocumentError(f"character U+{ord(wrong[0]):04X} is not allowed in YAML", mark)
    try:
        root = _Loader(text).get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = _mark(error.problem_mark or error.context_mark)
        raise DocumentError(_explain(error, text, mark), mark) from error
    if root is None:
        raise DocumentError("the file is empty")
    if not isinstance(root, yaml.MappingNode):
        raise DocumentError(
            "the top level must be a mapping of `key: value` lines", _mark(root.start_mark)
        )
    builder = _Builder()
    return builder.build(root, ()), builder.duplicates


class _Builder:
    """Converts composed nodes to the tree, and limits the expansion of anchors."""

    def __init__(self) -> None:
        self.duplicates: list[tuple[Mark, str, str]] = []
        self._count = 0

    def build(self, node: yaml.Node, above: tuple[int, ...]) -> Node:
        mark = _mark(node.start_mark)
        self._count += 1
        if self._count > MAX_NODES:
            raise DocumentError(f"expands to more than {MAX_NODES} values; use fewer aliases", mark)
        if id(node) in above:
            raise DocumentError("an alias refers to a value that contains this alias", mark)
        above = (*above, id(node))
        if isinstance(node, yaml.SequenceNode):
            return Node([self.build(child, above) for child in node.value], mark, {})
        if not isinstance(node, yaml.MappingNode):
            return Node(_scalar(node, mark), mark, {})
        children: dict[str, Node] = {}
        marks: dict[str, Mark] = {}
        for key_node, value_node in node.value:
            at, key = _mark(key_node.start_mark), str(key_node.value)
            if not isinstance(key_node, yaml.ScalarNode):
                raise DocumentError("a key must be plain text", at)
            if key in children:
                text = f"duplicate key {key!r}, first given on line {marks[key].line}; remove one"
                self.duplicates.append((at, key, text))
                continue
            marks[key] = at
            children[key] = self.build(value_node, above)
        return Node(children, mark, marks)


def _scalar(node: yaml.Node, mark: Mark) -> Scalar:
    text = str(node.value)
    kind = str(node.tag).removeprefix(_CORE)
    try:
        match kind:
            case "str":
                return text
            case "null":
                return None
            case "bool":
                return text.lower() == "true"
            case "int":
                return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
            case "float":
                special = text.lower().lstrip("+-")
                if special in (".inf", ".nan"):
                    return math.copysign(float(special[1:]), -1.0 if text.startswith("-") else 1.0)
                return float(text)
    except ValueError as error:
        raise DocumentError(f"{text[:40]!r} is not a usable {kind}", mark) from error
    raise DocumentError(f"tag {node.tag} is not allowed; write plain values", mark)


def _mark(mark: yaml.Mark | None) -> Mark:
    return Mark(1, 1) if mark is None else Mark(mark.line + 1, mark.column + 1)


def _explain(error: yaml.MarkedYAMLError, text: str, mark: Mark) -> str:
    problem = str(error.problem or error.context)
    line = [*text.split("\n"), ""][mark.line - 1]
    if line[mark.column - 1 : mark.column] == "\t":
        return "a tab character; indent with spaces"
    if "expected a single document" in str(error.context):
        return "a second document starts here ('---'); keep one document per file"
    context = f" {error.context}" if error.context and error.context != problem else ""
    return f"not valid YAML: {problem}{context}"


def _nearby(path: Path) -> str:
    """Return the names of up to three files of the same type in the folder of a missing file."""
    if not path.parent.is_dir():
        return f"; the folder {path.parent} does not exist either"
    names = sorted(p.name for p in path.parent.glob("*.y*ml"))
    return f"; beside it: {', '.join(names[:3])}" if names else ""


_DELIMITERS = ";\t,"


def csv_rows(text: str, path: Path, rename: Mapping[str, str] = MappingProxyType({})) -> list[Node]:
    """Return the rows of a CSV file as mappings.

    The first line that is not a comment is the header, which names the columns; the delimiter is
    the semicolon, tab or comma that the header has. Lines that are empty or begin with ``#`` are
    left out.

    ``path``: the file, for the places of the values. ``rename``: keys, with dots, of columns whose
    names are not the keys.
    """
    lines = text.split("\n")
    used = [n for n, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    if len(used) < 2:
        raise DocumentError(
            "a table needs a line that names its columns, and at least one row", Mark(1, 1, path)
        )
    delimiter = next((d for d in _DELIMITERS if d in lines[used[0]]), ",")
    header, *rows = [_cells(lines[n], delimiter, Mark(n + 1, 1, path)) for n in used]
    header = [replace(name, value=rename.get(str(name.value), name.value)) for name in header]
    return [row(header, cells, cells[0].mark) for cells in rows]


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
        header: Names of the columns, each a key, with dots for a key inside another key.
        cells: Values of the row, one below each column name.
        place: Where the row starts.
    """
    if len(cells) != len(header):
        raise DocumentError(
            f"{len(cells)} cells under {len(header)} columns; add or remove cells", place
        )
    names = [name.value for name in header]
    for name, node in zip(names, header, strict=True):
        if not isinstance(name, str) or not all(name.split(".")):
            raise DocumentError(f"a column must be named by a key (got {name!r})", node.mark)
        if names.count(name) > 1:
            raise DocumentError(f"two columns are named {name!r}; remove one column", node.mark)
        if any(str(other).startswith(f"{name}.") for other in names):
            raise DocumentError(
                f"one column names the key {name!r}, and another a key inside {name!r}; remove one "
                "of the columns",
                node.mark,
            )
    top: dict[str, Node] = {}
    marks: dict[str, Mark] = {}
    for node, cell in zip(header, cells, strict=True):
        if cell.value == "":
            continue
        *sections, key = str(node.value).split(".")
        children, places = top, marks
        for section in sections:
            places.setdefault(section, node.mark)
            inner = children.setdefault(section, Node({}, cell.mark, {}))
            children, places = inner.value, inner.keys  # type: ignore[assignment]
        places[key] = node.mark
        plain_text = isinstance(cell.value, str)
        children[key] = Node(scalar(str(cell.value)), cell.mark, {}) if plain_text else cell
    return Node(top, place, marks)
