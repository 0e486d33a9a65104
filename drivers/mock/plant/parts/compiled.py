"""Compiles the numeric kernels of the simulation with numba, all with the same options.

Numba keeps the machine code on disk for the next process (docs/decisions/0057-kernel-cache.md).
"""

from __future__ import annotations

import hashlib
import logging
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numpy.typing import NDArray

_LOG = logging.getLogger(__name__)


@cache
def _shared_sources() -> str:
    """Return a digest of the files whose code is compiled into kernels of other files."""
    files = sorted(Path(__file__).parents[1].rglob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


class _Cache(FunctionCache):
    """Numba's cache of one kernel, obsolete also when a shared file has changed."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp(), _shared_sources()
        self._cache_file = IndexDataCacheFile(self.cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the machine code for a signature, or None if it is missing or damaged."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # noqa: BLE001 - unpickling a damaged file raises anything; compiling is the remedy
            _LOG.info("%s is compiled anew: %s", self._name, error)
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the machine code for a signature to disk, or log why this is not possible."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _say_not_kept(error.strerror or "")


@cache
def _say_not_kept(reason: str) -> None:
    _LOG.warning(
        "compiled kernels cannot be stored, so each start of the program compiles them again (%s)",
        reason,
    )


@cache
def _say_compiling() -> None:
    _LOG.warning(
        "compiling numeric kernels for this computer, once for each version of the program; this "
        "takes up to a minute"
    )


class _Waiting(event.Listener):
    """Logs once, if a person may be waiting, that compiling makes the first start slow."""

    def on_start(self, event: Any) -> None:
        """Log the reason for the wait."""
        own = __name__.partition(".")[0]
        ours = event.data["dispatcher"].py_func.__module__.partition(".")[0] == own
        if ours and sys.stderr is not None and sys.stderr.isatty():
            _say_compiling()

    def on_end(self, event: Any) -> None:
        """Do nothing."""


event.register("numba:compile", _Waiting())


Vector = NDArray[np.float64]

_INLINED: dict[str, Any] = {"error_model": "numpy", "forceinline": True, "_nrt": False}

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numeric kernel with numba and keep the machine code for the next process."""
    return _kept(function, error_model="numpy")


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel that allocates no memory, for inner loops, into its compiled callers.

    Without ``_nrt=False`` numba would count references to every array at every call by atomic
    operations, which take longer than the formulas: the kernel would be 2.7 times slower.
    """
    return _kept(function, **_INLINED)


def _kept(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    kernel = njit(**options)(function)
    try:
        kernel._cache = _Cache(function)
    except RuntimeError:
        # The message of numba is replaced, because it states the name of a kernel, which does not
        # help an operator.
        _say_not_kept("no cache folder is writable")
    return cast(Callable[P, R], kernel)
