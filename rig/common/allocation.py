"""Memory that is given back and asked for again within a millisecond, kept in between."""

from __future__ import annotations

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt, malloc.h."""
_KEPT_BYTES = 1 << 30
_LARGEST_BYTES = 1 << 25
"""The most that the C library takes from its heap at all."""


def keep_freed_memory() -> None:
    """Have the C library keep what numpy frees, instead of returning it to the system array by
    array.

    A series of 30 s is 240 kB; beyond 128 kB each one would be mapped, zeroed page by page at its
    first touch, and unmapped again, which costs ten times what is done with it. Elsewhere than on
    Linux with glibc nothing is changed.
    """
    if sys.platform != "linux":
        return
    tune = getattr(ctypes.CDLL(None), "mallopt", None)
    if tune is not None:
        tune(_MMAP_THRESHOLD, _LARGEST_BYTES)
        tune(_TRIM_THRESHOLD, _KEPT_BYTES)
