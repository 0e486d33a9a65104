"""Cache of the latest series of recordings, released before the next diagnosis.

Views and nominal values are keys by identity, so that the next diagnosis uses no old series;
without the release, the old recordings would stay in memory.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")
KEPT = 128
"""Number of results that each function keeps: hundreds of trials use the same series."""
_CACHES: list[Any] = []


def recent(function: Callable[P, R]) -> Callable[P, R]:
    """Keep the latest results of a function; its arguments must be hashable."""
    kept = lru_cache(maxsize=KEPT)(function)
    _CACHES.append(kept)
    return cast(Callable[P, R], kept)


def forget() -> None:
    """Release all results."""
    for kept in _CACHES:
        kept.cache_clear()
