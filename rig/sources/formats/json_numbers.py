"""Numbers inside JSON values: one column per number, named by its place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from identification.recording import Array


def series(rows: Sequence[Mapping[str, float]], field: str) -> Array:
    """Return one field of all rows, shape (n,); NaN where a row has none.

    Stamps are seconds since the first one: nanoseconds since 1970 exceed the 53 bits of a double,
    their differences do not.
    """
    known = [row.get(field) for row in rows]
    first = next((stamp for stamp in known if isinstance(stamp, Stamp)), None)
    if first is not None:
        return np.array(
            [(s - first) * 1e-9 if isinstance(s, Stamp) else np.nan for s in known], np.float64
        )
    return np.array([np.nan if value is None else value for value in known], np.float64)


class Stamp(int):
    """A time stamp in nanoseconds; read as seconds since the first of its topic."""


LONGEST_LIST = 64
"""Elements of a list that become columns; longer ones are images and the like, and are left out."""
_STAMPS = ({"sec", "nanosec"}, {"secs", "nsecs"}, {"sec", "nsec"}, {"seconds", "nanos"})


def numbers(value: object, prefix: str) -> Iterator[tuple[str, float]]:
    """Yield dotted name and value of every number inside a JSON message.

    An element of a list is ``name[0]``. A time stamp of seconds and nanoseconds is one more column
    under the name of both.
    """
    if isinstance(value, dict):
        for key, child in value.items():
            yield from numbers(child, f"{prefix}.{key}" if prefix else str(key))
        if prefix and set(value) in _STAMPS and all(isinstance(v, int) for v in value.values()):
            whole, rest = (value[key] for key in sorted(value, key=lambda key: key[0] == "n"))
            yield prefix, Stamp(whole * 10**9 + rest)
    elif isinstance(value, list) and len(value) <= LONGEST_LIST:
        for index, child in enumerate(value):
            yield from numbers(child, f"{prefix}[{index}]")
    elif isinstance(value, bool | int | float):
        yield prefix, float(value)
