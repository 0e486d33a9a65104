"""Writes a record as YAML text with a comment on every key: meaning, unit and default."""

from __future__ import annotations

import dataclasses
import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from rig.cli.authoring.schema import describe, meanings

_COLUMNS: Final = 100
_PLAIN: Final = re.compile(r"[A-Za-z_][\w./+-]*")
_WORDS_OF_YAML: Final = frozenset({"true", "false", "null", "yes", "no", "on", "off", "y", "n"})


@dataclass(frozen=True)
class Block:
    """A record to be written.

    Attributes:
        record: Class of the record, whose docstring explains the keys.
        values: Value of each key: a scalar, a list of scalars, plain data, or further blocks.
        notes: Texts, by key, that replace the comment on the default.
        bare: Whether to omit the comments, as in all but the first item of a list.
    """

    record: type
    values: Mapping[str, Any]
    notes: Mapping[str, str] = field(default_factory=dict)
    bare: bool = False


@dataclass(frozen=True)
class Raw:
    """A mapping given as YAML text."""

    text: str


def render(block: Block, indent: int = 0) -> str:
    """Return the text of a record."""
    return "\n".join(_lines(block, indent)) + "\n"


def _lines(block: Block, indent: int) -> Iterator[str]:
    known = meanings(block.record)
    for key, value in block.values.items():
        if not block.bare and key in known:
            words = describe(known[key])
            default = block.notes.get(key, _default(block.record, key))
            yield from _comment(f"{words}{f' {default}' if default else ''}", indent)
        pad = " " * indent
        if isinstance(value, Block):
            yield f"{pad}{key}:"
            yield from _lines(value, indent + 2)
        elif isinstance(value, Raw):
            yield f"{pad}{key}:"
            yield from textwrap.indent(value.text.rstrip("\n"), f"{pad}  ").split("\n")
        elif isinstance(value, Sequence) and value and isinstance(value[0], Block):
            yield f"{pad}{key}:"
            for item in value:
                first, *rest = _item(item, indent + 4)
                yield first
                yield from rest
        else:
            yield f"{pad}{key}: {scalar(value)}"


def _item(block: Block, indent: int) -> list[str]:
    """Return the lines of an item of a list; the dash stands before its first key."""
    lines = list(_lines(block, indent))
    first = next(n for n, line in enumerate(lines) if not line.lstrip().startswith("#"))
    lines[first] = f"{' ' * (indent - 2)}- {lines[first].lstrip()}"
    return lines


def _comment(words: str, indent: int) -> Iterator[str]:
    start = f"{' ' * indent}# "
    yield from textwrap.wrap(
        words, _COLUMNS, initial_indent=start, subsequent_indent=start, break_long_words=False
    )


def _default(record: type, key: str) -> str:
    """Return text for the default of a key; empty if the key is required."""
    value: Any = PydanticUndefined
    if issubclass(record, BaseModel):
        value = record.model_fields[key].get_default(call_default_factory=True)
    elif dataclasses.is_dataclass(record):
        value = next(item.default for item in dataclasses.fields(record) if item.name == key)
    plain = value is None or isinstance(value, int | float | str | tuple)
    return f"Default: {scalar(value)}." if plain and not _of_records(value) else ""


def _of_records(value: Any) -> bool:
    return isinstance(value, tuple) and any(isinstance(item, BaseModel) for item in value)


def scalar(value: Any) -> str:
    """Return plain data in the flow style of YAML; numbers have twelve digits."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, Mapping):
        return (
            "{" + ", ".join(f"{scalar(key)}: {scalar(item)}" for key, item in value.items()) + "}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(scalar(item) for item in value) + "]"
    text = str(value)
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS_OF_YAML:
        return text
    return json.dumps(text, ensure_ascii=False)
