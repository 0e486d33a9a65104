"""Reads the numbers inside JSON values: one column for each number, named by its path."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np

from identification.recording import Array
from rig.sources.formats.doubles import EXACT
from rig.sources.formats.text_layout import nanoseconds

LONGEST_LIST = 64
"""Greatest length of a list whose elements become columns; longer lists, such as images, are left
out.
"""
_STAMPS = ({"sec", "nanosec"}, {"secs", "nsecs"}, {"sec", "nsec"}, {"seconds", "nanos"})
_LARGEST = 2**64
"""Integers with at least this magnitude are not read as numbers."""
_DATE_LENGTHS = range(8, 41)


class Stamp(int):
    """Time stamp in nanoseconds; its column is read as seconds since the first stamp of the
    topic.
    """


def parse(text: str) -> Any:
    """Parse a JSON text.

    Raises:
        ValueError: The text is not JSON, or an object has a key twice.
        RecursionError: The text is nested too deeply.
    """
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
    """Return a JSON value as a number, or None if it is not a number.

    Integers stay integers, dates become :class:`Stamp`.
    """
    if isinstance(value, bool | float):
        return float(value)
    if isinstance(value, int):
        return value if abs(value) < _LARGEST else None
    if isinstance(value, str) and len(value) in _DATE_LENGTHS and ":" in value:
        when = nanoseconds(value)
        return None if when is None else Stamp(when)
    return None


def stamp_of(value: Mapping[str, object]) -> Stamp | None:
    """Return the time stamp in an object of seconds and nanoseconds, or None if the object has no
    time stamp.
    """
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
