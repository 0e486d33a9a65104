"""Keeps freed memory in the process for reuse by later arrays."""

from __future__ import annotations

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of mallopt, malloc.h."""
_KEPT_BYTES = 1 << 30
_LARGEST_BYTES = 1 << 25
"""Largest allocation that the C library serves from its heap."""


def keep_freed_memory() -> None:
    """Have the C library keep memory freed by numpy, instead of returning each array to the system.

    A series of 30 s is 240 kB; arrays beyond 128 kB would each be mapped, zeroed on first use and
    unmapped, which takes ten times as long as the computation. Has an effect only on Linux with
    glibc.
    """
    if sys.platform != "linux":
        return
    tune = getattr(ctypes.CDLL(None), "mallopt", None)
    if tune is not None:
        tune(_MMAP_THRESHOLD, _LARGEST_BYTES)
        tune(_TRIM_THRESHOLD, _KEPT_BYTES)
