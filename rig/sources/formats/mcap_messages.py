"""Decodes the numbers inside the messages of MCAP files: JSON, and CDR (ROS 2) and protobuf with
their schema.

The decoders of CDR and protobuf are optional libraries.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from mcap.records import Schema

from rig.sources.formats.json_numbers import (
    LONGEST_LIST,
    Stamp,
    number,
    numbers,
    parse,
    stamp_of,
)
from rig.sources.formats.library import library

Decoder = Callable[[bytes], dict[str, float]]
"""Function that returns dotted name and value of every number in a message."""
_LIBRARIES: Final = {
    "cdr": ("mcap_ros2.decoder", "CDR messages of ROS 2"),
    "protobuf": ("mcap_protobuf.decoder", "protobuf messages"),
}
"""Module of the decoder, and name of the encoding for messages, by encoding."""
_DURATION = "Duration"


class Decoders:
    """Chooses the decoder of each channel."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._factories: dict[str, Any] = {}

    def of(self, encoding: str, schema: Schema | None) -> Decoder | None:
        """Return the decoder of a channel, or None if no decoder reads its encoding.

        Raises:
            InputError: The library that decodes this encoding is not installed.
        """
        if encoding == "json":
            return lambda data: dict(numbers(parse(data.decode("utf-8")), ""))
        if encoding not in _LIBRARIES:
            return None
        if encoding not in self._factories:
            module, words = _LIBRARIES[encoding]
            self._factories[encoding] = library(module, self._path, words, "mcap").DecoderFactory()
        decode = self._factories[encoding].decoder_for(encoding, schema)
        if decode is None:
            return None
        walk = _of_protobuf if encoding == "protobuf" else _of_ros
        return lambda data: dict(walk(decode(data), ""))


def _of_ros(value: Any, prefix: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a decoded ROS message, or of a value inside it."""
    fields = getattr(type(value), "__slots__", None)
    if fields is not None and hasattr(type(value), "_type"):
        members = {field: getattr(value, field) for field in fields}
        for field, member in members.items():
            yield from _of_ros(member, f"{prefix}.{field}" if prefix else field)
        if prefix:
            yield from _time(members, prefix, str(type(value)._type))
    elif isinstance(value, bytes | bytearray | str):
        return
    elif hasattr(value, "__len__"):
        yield from _elements(value, prefix, _of_ros)
    elif (found := number(value)) is not None:
        yield prefix, found


def _of_protobuf(value: Any, prefix: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a protobuf message; a field that has neither a value nor a default is
    left out.
    """
    descriptor = getattr(value, "DESCRIPTOR", None)
    if descriptor is None:
        found = None if isinstance(value, bytes | str) else number(value)
        if found is not None:
            yield prefix, found
        return
    members: dict[str, Any] = {}
    for field in descriptor.fields:
        if field.has_presence and not value.HasField(field.name):
            continue
        member = members[field.name] = getattr(value, field.name)
        place = f"{prefix}.{field.name}" if prefix else field.name
        if not hasattr(member, "__len__") or isinstance(member, bytes | str):
            yield from _of_protobuf(member, place)
        elif hasattr(member, "keys"):
            for key in list(member)[:LONGEST_LIST]:
                yield from _of_protobuf(member[key], f"{place}.{key}")
        else:
            yield from _elements(member, place, _of_protobuf)
    if prefix:
        yield from _time(members, prefix, str(descriptor.full_name))


def _elements(
    value: Any, prefix: str, walk: Callable[[Any, str], Iterator[tuple[str, float]]]
) -> Iterator[tuple[str, float]]:
    if len(value) <= LONGEST_LIST:
        for index, child in enumerate(value):
            yield from walk(child, f"{prefix}[{index}]")


def _time(members: dict[str, Any], prefix: str, kind: str) -> Iterator[tuple[str, float]]:
    """Yield a time stamp of seconds and nanoseconds as one column; a duration is in s."""
    stamp = stamp_of(members)
    if stamp is not None and kind.endswith(_DURATION):
        yield prefix, int(stamp) / 1e9
    elif stamp is not None:
        yield prefix, Stamp(stamp)
