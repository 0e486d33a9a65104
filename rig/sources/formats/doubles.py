"""Converts arrays of any numeric type to doubles, and notes each loss of accuracy.

The functions depend only on their arguments.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array

EXACT = 2**53
"""Greatest integer up to which doubles represent every integer exactly."""
_LARGEST = 2**63 - 1
_UNIT_S = {"D": 86400.0, "h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TIME_UNITS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}


def seconds_per(unit: str) -> float | None:
    """Return the length of a unit of time, as files write it, in seconds, or None for any other
    unit.
    """
    return _TIME_UNITS.get(unit.strip().lower())


class NotNumbersError(Exception):
    """The values are not real numbers; the message states their type."""


def as_doubles(values: NDArray[Any]) -> tuple[Array, str]:
    """Return values as doubles, and a note if the conversion changed them.

    Integers beyond 2^53 are read as differences to the first integer; dates and times are read as
    seconds since the first date or time; missing dates and times are NaN.

    Args:
        values: Shape (n,), of any type.

    Raises:
        NotNumbersError: The values are text, complex, or objects.
    """
    kind = values.dtype.kind
    if kind in "iu":
        if values.size and (int(values.max()) > EXACT or int(values.min()) < -EXACT):
            first = int(values[0])
            return _differences(values), (
                f"64-bit integers beyond 2^53: read as the difference to the first, {first}"
            )
        return np.ascontiguousarray(values, np.float64), ""
    if kind in "bf":
        # A float of another width may be a signalling NaN, whose conversion raises a warning.
        with np.errstate(invalid="ignore", over="ignore"):
            return np.ascontiguousarray(values, np.float64), ""
    if kind in "Mm":
        return _seconds(values)
    if values.dtype.names is not None and set(values.dtype.names) == {"real", "imag"}:
        raise NotNumbersError("complex numbers")
    words = {"c": "complex numbers", "S": "text", "U": "text", "O": "text or objects"}
    raise NotNumbersError(words.get(kind, f"of the type {values.dtype}"))


def _differences(values: NDArray[Any]) -> Array:
    first = int(values[0])
    if int(values.max()) - first > _LARGEST or first - int(values.min()) > _LARGEST:
        return np.array([float(int(value) - first) for value in values])
    differences = values - values[0]
    if values.dtype.kind == "u":
        differences = differences.view(differences.dtype.str.replace("u", "i"))
    return cast(Array, differences.astype(np.float64))


def _seconds(values: NDArray[Any]) -> tuple[Array, str]:
    unit, count = np.datetime_data(values.dtype)
    if unit not in _UNIT_S:
        raise NotNumbersError(f"times in units of {unit}")
    missing = np.isnat(values)
    known = values[~missing]
    first = known[0] if known.size else values.dtype.type(0, unit)
    dated = values.dtype.kind == "M"
    since = values - first if dated else values
    ticks = np.where(missing, 0, since.astype(np.int64)).astype(np.float64) * count
    scale = _UNIT_S[unit]
    seconds = ticks * scale if scale >= 1.0 else ticks / round(1.0 / scale)
    seconds[missing] = np.nan
    note = f"dates: read as seconds since {first}" if dated and known.size else ""
    return seconds, note
