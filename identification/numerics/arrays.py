"""Types of numpy arrays for the hints of all numerics; arrays and records as values for JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


Progress = Callable[[str, float], None]
"""Called with the label of the current step and the share of it that is done, 0 to 1."""


def silent(_what: str, _share: float) -> None:
    """Ignore the progress."""


RANGED = ("angle", "velocity", "moment")


def spanned(recordings: Iterable[Sequence[Array]]) -> dict[str, tuple[float, float]]:
    """Return least and greatest angle, velocity and moment of the load over recordings, by name."""
    return {
        name: (float(min(np.min(x) for x in own)), float(max(np.max(x) for x in own)))
        for name, own in zip(RANGED, zip(*recordings, strict=True), strict=True)
    }


def finite(value: float | None) -> float | None:
    """Return a plain float, or None for infinities and NaN, which JSON does not have."""
    return float(value) if value is not None and math.isfinite(value) else None


def plain(value: Any, *left_out: str) -> Any:
    """Return a value for JSON: dataclasses as mappings, arrays as lists, NaN as None."""
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value):
        names = [field.name for field in fields(value) if field.name not in left_out]
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if hasattr(value, "tolist"):  # an array
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return finite(value) if isinstance(value, float) else value
