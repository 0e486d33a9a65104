"""Imports a module in a thread while the program computes something else.

Keeps freed memory in the process for reuse by later arrays.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Thread


@contextmanager
def imported_ahead(module: str) -> Iterator[None]:
    """Import a module in a thread while the block runs; compiled code in the block releases the
    interpreter.

    An error of this import is ignored; a later import statement raises the error again.
    """

    def load() -> None:
        with suppress(Exception):
            import_module(module)

    thread = Thread(target=load, name=f"import of {module}")
    thread.start()
    try:
        yield
    finally:
        thread.join()


_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of parameters of mallopt, from malloc.h."""
_KEPT_BYTES = 1 << 30
_LARGEST_BYTES = 1 << 25
"""Size of the largest allocation, bytes, for which the C library uses its heap."""


def keep_freed_memory() -> None:
    """Have the C library keep memory freed by numpy, instead of returning each array to the system.

    A series of 30 s takes 240 kB. By default, each array above 128 kB is mapped, zeroed on first
    use and unmapped, which takes ten times as long as the computation. The function has an effect
    only on Linux with glibc.
    """
    if sys.platform != "linux":
        return
    tune = getattr(ctypes.CDLL(None), "mallopt", None)
    if tune is not None:
        tune(_MMAP_THRESHOLD, _LARGEST_BYTES)
        tune(_TRIM_THRESHOLD, _KEPT_BYTES)
