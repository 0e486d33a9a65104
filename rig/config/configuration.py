"""Validates YAML files against a pydantic schema, and reports every error with its place."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from rig.common.errors import InputError
from rig.common.places import is_file, require_plain
from rig.common.yaml_tree import DocumentError, Mark, Node, parse, read_text

Loc = tuple[str | int, ...]
M = TypeVar("M", bound=BaseModel)
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
_ABSENT = object()
_INDEX = re.compile(r"\[\d+\]")
_Found = tuple[Mark, str, str, object]
_Described = dict[str, Any]


class Schema(BaseModel):
    """Base of every configuration record: frozen; unknown keys and infinite numbers are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, validate_default=True
    )


@dataclass(frozen=True)
class Document(Generic[M]):
    """A validated file with the position of each of its values."""

    value: M
    path: Path
    _root: Node

    def problem(self, loc: Loc, message: str, value: object = _ABSENT) -> str:
        """Return a problem that was found after the validation, as the text of an InputError.

        ``loc`` are keys and indices from the top of the file, e.g. ``("stages", 2, "speed")``; a
        place that the file does not contain (a default was used) gives the nearest enclosing value.
        Without ``value`` the message shows that of the file.
        """
        node, mark, path, _ = _resolve(self._root, loc)
        if value is _ABSENT and path == loc:
            value = node.plain()
        return _format(self.path, mark, _dotted(loc), message, value)

    def states(self, *loc: str) -> bool:
        """Return whether the file itself has a key, and not only its completion by the program."""
        node = self._root
        for name in loc:
            if name not in node.keys or not isinstance(node.value, dict):
                return False
            node = node.value[name]
        return True

    def other_files(self) -> list[Path]:
        """Return the other files from which values were read."""
        files = (node.mark.file for node in self._root.walk())
        return list(dict.fromkeys(file for file in files if file is not None))

    def require(self, problems: Iterable[tuple[Loc, str]]) -> None:
        """Raise an InputError that lists the problems, if any, each a location and a message."""
        lines = [self.problem(loc, message) for loc, message in problems]
        if lines:
            raise InputError(lines)


def load_located(
    path: Path, schema: type[M], prepare: Callable[[Node], Node] | None = None
) -> Document[M]:
    """Read and validate a file (InputError with all errors), after ``prepare`` changed its tree."""
    with placed(path):
        text = read_text(path)
    return located_text(path, text, schema, prepare)


@contextmanager
def placed(path: Path) -> Iterator[None]:
    """Turn an error in a document into an InputError with its place."""
    try:
        yield
    except DocumentError as error:
        raise InputError(_format(path, error.mark, "document", error.message)) from error


def located_text(
    path: Path, text: str, schema: type[M], prepare: Callable[[Node], Node] | None = None
) -> Document[M]:
    """Validate the text of a configuration file as :func:`load_located` does."""
    with placed(path):
        root, duplicates = parse(text)
    found: list[_Found] = [(mark, key, message, _ABSENT) for mark, key, message in duplicates]
    if prepare is not None:
        root = prepare(root)
    return validated(path, root, schema, found)


def validated(path: Path, root: Node, schema: type[M], found: Iterable[_Found] = ()) -> Document[M]:
    """Validate a tree from ``path``; report the problems ``found`` in reading, too."""
    found = list(found)
    try:
        # With JSON input in strict mode, "5" and true are not numbers, but lists are accepted as
        # tuples and text as enums.
        value = schema.model_validate_json(json.dumps(root.plain()), strict=True)
    except ValidationError as error:
        found.extend(_explain(root, schema, error))
        raise InputError(_lines(path, found)) from None
    if found:
        raise InputError(_lines(path, found))
    return Document(value, path, root)


def explain_json(path: Path, text: str, schema: type[Any], error: ValidationError) -> list[str]:
    """Format the validation problems of a JSON file (record or standard dataclass) with places."""
    with placed(path):
        root, _ = parse(text)  # JSON is a subset of YAML
    return _lines(path, list(_explain(root, schema, error)))


def place_json(path: Path, text: str, problems: Iterable[tuple[Loc, str]]) -> list[str]:
    """Format problems found in a JSON file after validation, each with its place."""
    found = []
    with placed(path):
        root, _ = parse(text)
    for loc, message in problems:
        node, mark, path_found, _ = _resolve(root, loc)
        found.append((mark, _dotted(loc), message, node.plain() if path_found == loc else _ABSENT))
    return _lines(path, found)


def _lines(path: Path, found: list[_Found]) -> list[str]:
    """Format the problems in the order of the file, one of a merged default only once."""
    unique: dict[tuple[Mark, str, str], _Found] = {}
    for item in sorted(found, key=lambda item: (item[0].line, item[0].column)):
        unique.setdefault((item[0], _INDEX.sub("", item[1]), item[2]), item)
    return [_format(path, *item) for item in unique.values()]


def _explain(root: Node, schema: type[Any], error: ValidationError) -> Iterator[_Found]:
    """Convert pydantic's errors to messages with places; branches of a union make one message."""
    places: dict[tuple[Mark, Loc], tuple[list[str], object]] = {}
    errors = error.errors(include_url=False)
    described = _described(schema)  # type: ignore[arg-type] # a class is hashable
    for details in errors:
        loc = details["loc"]
        if details["type"] == "too_short" and any(
            e["loc"][: len(loc)] == loc != e["loc"] for e in errors
        ):
            continue  # pydantic does not count invalid items of a tuple
        mark, path, message, value = _place(root, described, details)
        messages, _ = places.setdefault((mark, path), ([], value))
        if message not in messages:
            messages.append(message)
        if details["type"] == "missing":
            for below in _required_below(described, path):
                places.setdefault((mark, below), ([message], _ABSENT))
    for (mark, path), (messages, value) in places.items():
        yield mark, _dotted(path), " or ".join(messages), value


@cache
def _described(schema: type[Any]) -> _Described:
    return TypeAdapter(schema).json_schema()


def _place(
    root: Node, described: _Described, details: ErrorDetails
) -> tuple[Mark, Loc, str, object]:
    loc: Loc = details["loc"]
    kind = details["type"]
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        loc = (*loc, details["ctx"]["discriminator"].strip("'"))
    if kind in ("missing", "union_tag_not_found"):
        _, mark, path, _ = _resolve(root, loc[:-1])
        return mark, (*path, loc[-1]), "missing; this key is required", _ABSENT
    node, mark, path, key_mark = _resolve(root, loc)
    message = details["msg"].removeprefix("Value error, ")
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        names = {name for record in _records_at(described, loc[:-1]) for name in record}
        # Another branch of a union may have the key.
        known = sorted(names - {str(loc[-1])})
        return key_mark or mark, path, f"unknown key; {nearest(str(loc[-1]), known)}", _ABSENT
    if loc[-1:] == ("[key]",):
        return key_mark or mark, path, message, _ABSENT
    if kind == "too_short":
        message = "has {actual_length} entries, needs {min_length}".format(**details["ctx"])
    if kind != "value_error":
        message = message[:1].lower() + message[1:]
    return mark, path, message, node.plain()


def nearest(name: str, known: list[str]) -> str:
    """Return a text with the known names that are closest to a mistyped name, or with all names."""
    same = [k for k in known if k.casefold() == name.casefold()]
    close = same or difflib.get_close_matches(name, known, n=3, cutoff=0.6)
    if close:
        return f"did you mean {' or '.join(repr(k) for k in close)}?"
    return f"known are {', '.join(known)}" if known else "no key is known here"


def _required_below(described: _Described, loc: Loc) -> Iterator[Loc]:
    """Yield the required keys of a missing section, which are reported with the section."""
    records = _records_at(described, loc)
    if len(records) == 1:
        for name in (name for name, required in records[0].items() if required):
            yield (*loc, name)
            yield from _required_below(described, (*loc, name))


def _records_at(described: _Described, loc: Loc) -> list[dict[str, bool]]:
    """Return the records that a JSON Schema permits at a location: whether each key is required.

    Elements of the location that name a branch of a union are skipped.
    """

    def branches(node: _Described) -> Iterator[_Described]:
        if "$ref" in node:
            node = described["$defs"][node["$ref"].rpartition("/")[2]]
        for branch in (*node.get("anyOf", ()), *node.get("oneOf", ())):
            yield from branches(branch)
        yield node

    nodes = list(branches(described))
    for element in loc:
        if isinstance(element, int):
            below = [node["items"] for node in nodes if "items" in node]
        else:
            below = [
                node.get("properties", {}).get(element) or node.get("additionalProperties")
                for node in nodes
            ]
        found = [branch for node in below if isinstance(node, dict) for branch in branches(node)]
        nodes = found or nodes
    return [
        {name: name in node.get("required", ()) for name in node["properties"]}
        for node in nodes
        if "properties" in node
    ]


def _resolve(root: Node, loc: Loc) -> tuple[Node, Mark, Loc, Mark | None]:
    """Follow a location as far as the tree has it, without names of union branches.

    Returns:
        The node, its mark, the keys and indices followed, and the mark of the last key (None for an
        index).
    """
    node = root
    path: Loc = ()
    key_mark: Mark | None = None
    for element in loc:
        children, child = node.value, None
        if isinstance(children, dict):
            child = children.get(str(element))
        elif isinstance(children, list) and isinstance(element, int):
            child = children[element] if 0 <= element < len(children) else None
        if child is not None:
            key_mark = node.keys.get(str(element))
            node, path = child, (*path, element)
    return node, node.mark, path, key_mark


def _dotted(loc: Loc) -> str:
    text = "".join(f"[{e}]" if isinstance(e, int) else f".{e}" for e in loc).removeprefix(".")
    return text or "document"


def _format(file: Path, mark: Mark, path: str, message: str, value: object = _ABSENT) -> str:
    got = (
        ""
        if value is _ABSENT or (isinstance(value, dict | list) and len(value) > 8)
        else f" (got {_short(value)})"
    )
    return f"{mark.file or file}:{mark.line}:{mark.column}: {path}: {message}{got}"


def _short(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


_HERE = Path(__file__).parent


def names(kind: Literal["benches", "sequences"]) -> list[str]:
    """Return the packaged names of one kind."""
    return sorted(path.stem for path in (_HERE / kind).glob("*.yaml"))


def packaged(name: str, kind: Literal["benches", "sequences"]) -> Path:
    """Return the path of the packaged file of this name; the file need not exist."""
    return _HERE / kind / f"{name}.yaml"


def beside(document: Document[Any], folder: Path, word: str) -> Path:
    """Return the path of a changed bench file: beside a file of the user, else in a folder."""
    path = document.path
    if path == packaged(path.stem, "benches"):
        return folder / "bench.yaml"
    return path.with_name(f"{path.stem}.{word}{path.suffix}")


def resolve(name: str | Path, kind: Literal["benches", "sequences"]) -> Path:
    """Return the file for a name: at this path, else packaged; the InputError has near names."""
    path = Path(name)
    if is_file(path):
        return path
    shipped = packaged(str(name), kind)
    if path.name == str(name) and is_file(shipped):
        return shipped
    try:
        require_plain(path)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror}") from error
    raise InputError(
        f"{name}: no such file, and not a packaged name; {nearest(str(name), names(kind))}"
    )
