"""Pages of the keys of a YAML file, from the records that validate it."""

from __future__ import annotations

import dataclasses
import math
import re
import typing
from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic import BaseModel
from pydantic_core import PydanticUndefined
from shapes import Shape, is_record, shape

from rig.cli.authoring.schema import meanings, summary
from rig.config.simulated_machine import may_be

REQUIRED = "**required**"


class Key(NamedTuple):
    """One key of a record.

    Attributes:
        name: As written in the file.
        shape: What it takes.
        default: In words.
    """

    name: str
    shape: Shape
    default: str


def fields(record: type) -> Iterator[Key]:
    """Yield the keys of a record in the order of their declaration."""
    if issubclass(record, BaseModel):
        for name, info in record.model_fields.items():
            made = shape(info.annotation, tuple(info.metadata))
            missing = info.default is PydanticUndefined and info.default_factory is None
            value = info.get_default(call_default_factory=True) if not missing else None
            yield Key(info.alias or name, made, REQUIRED if missing else plain(value))
        return
    hints = typing.get_type_hints(record, include_extras=True)
    for field in dataclasses.fields(record):
        value: Any = field.default
        if field.default_factory is not dataclasses.MISSING:
            value = field.default_factory()
        made = shape(hints[field.name])
        if record.__module__ == "drivers.mock.plant.parts.constants" and "number" in made.words:
            made = made._replace(words=f"{made.words} {may_be(field.name)}".strip())
        yield Key(field.name, made, REQUIRED if value is dataclasses.MISSING else plain(value))


def plain(value: Any) -> str:
    """Return a default as it would be written in the file."""
    if is_record(type(value)):
        return "see below"
    if value is None:
        return "`null`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, float) and not math.isnan(value):
        return f"`{value:.10g}`"
    if isinstance(value, tuple):
        return f"`{list(value)}`"
    return f"`{value}`"


def page(title: str, intro: str, root: type, tail: str = "") -> str:
    """Return the page of one kind of file."""
    parts = [
        f"# {title}",
        intro,
        *_sections(root, "", {root: "Top level"}),
        *([tail] if tail else []),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _sections(record: type, path: str, titles: dict[type, str]) -> Iterator[str]:
    """Yield the section of a record, then those of the records inside it, each record once.

    Args:
        record: The record.
        path: Keys that lead to it from the top of the file.
        titles: Record to the heading of its section, for those that have one.
    """
    keys, known = list(fields(record)), meanings(record)
    if lacking := [key.name for key in keys if key.name not in known]:
        raise KeyError(
            f"{record.__module__}.{record.__name__}: no description of {', '.join(lacking)}"
        )
    rows = []
    deeper: list[tuple[str, type]] = []
    for key in keys:
        meaning = known[key.name]
        links = []
        for at, inside in key.shape.records:
            place = ".".join(filter(None, (path, key.name))) + at
            if inside not in titles:
                titles[inside] = getattr(inside, "heading", place + _variant(inside, key.shape))
                deeper.append((place, inside))
            links.append(f"[{titles[inside]}](#{_anchor(titles[inside])})")
        words = (
            key.shape.words.replace("section", " or ".join(links), 1) if links else key.shape.words
        )
        rows.append((f"`{key.name}`", meaning.unit, words, key.default, meaning.text))
    about = re.sub(r":\w+:`~?([\w.]+)`", r"`\1`", summary(record.__doc__ or "").replace("``", "`"))
    keys = table(("key", "unit", "value", "default", "meaning"), rows)
    yield f"## {titles[record]}\n\n{about}\n\n{keys}"
    for place, inside in deeper:
        yield from _sections(inside, place, titles)


def _variant(record: type, made: Shape) -> str:
    """Return what tells a record from the others that may stand in its place."""
    if len(made.records) < 2:
        return ""
    for name in ("kind", "interface"):
        key = next((k for k in fields(record) if k.name == name), None)
        if key is not None:
            return (
                f" ({name}: {key.shape.words.strip('`')})" if "`" in key.shape.words else " (CAN)"
            )
    return ""


def _anchor(title: str) -> str:
    """Return the anchor of a heading, as GitHub and MyST make it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(re.sub(r" +\|", " |", line) for line in lines)
