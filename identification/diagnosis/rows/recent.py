"""Cache of computed series of recordings, which is emptied before the next diagnosis.

Views and nominal values are keys that are compared by identity, so that a diagnosis uses no series
of an earlier one. The cache is emptied because it would keep the earlier recordings in memory.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")
KEPT = 128
"""Number of results that are kept for each function; hundreds of trial parameters use the same
series.
"""
_CACHES: list[Any] = []


def recent(function: Callable[P, R]) -> Callable[P, R]:
    """Keep the latest results of a function; the arguments of the function must be hashable."""
    kept = lru_cache(maxsize=KEPT)(function)
    _CACHES.append(kept)
    return cast(Callable[P, R], kept)


def forget() -> None:
    """Remove all results from the caches."""
    for kept in _CACHES:
        kept.cache_clear()
