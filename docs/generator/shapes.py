"""What values a key takes, from the annotation that validates it."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterator, Mapping
from datetime import date
from enum import Enum
from typing import Any, NamedTuple

import annotated_types
from pydantic import AfterValidator, AllowInfNan, BaseModel, Discriminator, Tag
from pydantic.fields import FieldInfo

_SCALARS = {
    float: "number",
    int: "whole number",
    str: "text",
    bool: "`true` or `false`",
    date: "date, YYYY-MM-DD",
}
_VALIDATORS = {
    "_buildable": "> 1e-9, < 1e9",
    "_not_zero": "not 0",
    "_measured": "",
    "iso_time": "(ISO 8601 date and time)",
    "known_channel": "a [canonical channel](#channels)",
    "known_parameter": "a [parameter](../glossary.md)",
    "known_friction": "one of `coulomb_viscous`, `stribeck`, `load_dependent`, "
    "`stribeck_load_dependent`",
    "_acceptable": "(a limit)",
    "_known_term": "one of `offset`, `load_dependent_friction`",
}
"""Function that checks a value to what it accepts."""


class Shape(NamedTuple):
    """What a key takes.

    Attributes:
        words: Type and range.
        records: The records inside, each with what leads from the key to it: "", "[]" or ".NAME".
    """

    words: str
    records: tuple[tuple[str, type], ...] = ()


def is_record(kind: object) -> bool:
    """Whether a type is described field by field."""
    return isinstance(kind, type) and (
        issubclass(kind, BaseModel) or dataclasses.is_dataclass(kind)
    )


def shape(annotation: Any, metadata: tuple[Any, ...] = ()) -> Shape:
    """Return the words and the records of an annotation."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return shape(arguments[0], (*arguments[1:], *metadata))
    limits = ", ".join(_limits(metadata))
    if origin in (typing.Union, types.UnionType):
        parts = [shape(argument) for argument in arguments if argument is not type(None)]
        words = [_joined(w, limits) for w in dict.fromkeys(part.words for part in parts)]
        if type(None) in arguments:
            words.append("`null`")
        return Shape(_either(words), tuple(record for part in parts for record in part.records))
    if origin is typing.Literal:
        return Shape(_either([f"`{value}`" for value in arguments]))
    if origin is tuple:
        if arguments[-1] is not Ellipsis:
            return Shape(
                f"list of {len(arguments)}: {'; '.join(shape(a).words for a in arguments)}"
            )
        inner = shape(arguments[0])
        return Shape(
            _joined(f"list of {inner.words}", limits),
            tuple(("[]" + at, r) for at, r in inner.records),
        )
    if origin in (dict, Mapping) or (isinstance(origin, type) and issubclass(origin, Mapping)):
        key, value = (shape(argument) for argument in arguments)
        return Shape(
            f"mapping of {key.words} to {value.words}",
            tuple((".NAME" + at, r) for at, r in value.records),
        )
    if is_record(annotation):
        return Shape("section", (("", annotation),))
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return Shape(" or ".join(f"`{member.value}`" for member in annotation))
    if annotation is object:
        return Shape(limits or "mapping")
    if annotation not in _SCALARS:
        raise TypeError(f"docs/generator/shapes.py does not know the type {annotation!r}; add it")
    return Shape(_joined(_SCALARS[annotation], limits))


def _joined(words: str, limits: str) -> str:
    if limits.startswith(("a [", "one of")):
        return limits
    return f"{words} {limits}" if limits else words


def _either(words: list[str]) -> str:
    """Return "a or b"; "a, b or c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _limits(metadata: tuple[Any, ...]) -> Iterator[str]:
    """Yield the bounds that metadata states, in words."""
    items = list(_flat(metadata))
    buildable = any(
        isinstance(item, AfterValidator) and item.func.__name__ == "_buildable" for item in items
    )
    for item in items:
        match item:
            case annotated_types.Gt(gt=0) if buildable:
                pass
            case annotated_types.MinLen(min_length=1) if any(
                isinstance(i, annotated_types.MaxLen) for i in items
            ):
                pass
            case annotated_types.Gt(gt=bound):
                yield f"> {bound:.10g}"
            case annotated_types.Ge(ge=bound):
                yield f"≥ {bound:.10g}"
            case annotated_types.Lt(lt=bound):
                yield f"< {bound:.10g}"
            case annotated_types.Le(le=bound):
                yield f"≤ {bound:.10g}"
            case annotated_types.MultipleOf(multiple_of=of):
                yield f"multiple of {of:g}"
            case annotated_types.MinLen(min_length=1):
                yield "(at least one)"
            case annotated_types.MaxLen():
                yield "(one character)"
            case AfterValidator(func=check) if check.__name__ in _VALIDATORS:
                yield _VALIDATORS[check.__name__]
            case AllowInfNan() | Discriminator() | Tag():
                pass
            case _ if (pattern := getattr(item, "pattern", None)) is not None:
                yield f"of `{pattern.strip('^$')}`"
            case _:
                raise TypeError(
                    f"docs/generator/shapes.py does not know the condition {item!r}; add it"
                )


def _flat(metadata: tuple[Any, ...]) -> Iterator[Any]:
    for item in metadata:
        if isinstance(item, FieldInfo):
            yield from _flat(tuple(item.metadata))
        elif isinstance(item, annotated_types.GroupedMetadata):
            yield from item
        else:
            yield item
