"""Imports a module in a thread while the program computes something else.

Keeps freed memory in the process for reuse by later arrays, and finds a folder for compiled
kernels.
"""

from __future__ import annotations

import ctypes
import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
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


def find_kernel_folder() -> None:
    """Let numba store compiled kernels in a private temporary folder if neither the folder of the
    program nor the cache folder of the user is writable; must be called before numba is imported.
    """
    if os.name != "posix":
        return
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    existing = next((path for path in (home, *home.parents) if path.exists()), home)
    if any(
        os.access(path, os.W_OK, effective_ids=os.access in os.supports_effective_ids)
        for path in (Path(__file__).parent, existing)
    ):
        return
    private = Path(tempfile.gettempdir()) / f"loadrig-kernels-{os.geteuid()}"
    with suppress(OSError):
        private.mkdir(mode=0o700, exist_ok=True)
        found = private.lstat()
        # Machine code is executed; no other user may be able to write it.
        mine = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
        if mine and not found.st_mode & 0o077:
            os.environ.setdefault("NUMBA_CACHE_DIR", str(private))
