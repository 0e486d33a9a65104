"""Compiles numeric kernels with numba, all with the same options, and computes in two threads.

Numba keeps the machine code on disk for the next process (docs/decisions/0057-kernel-cache.md).
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile

_LOG = logging.getLogger(__name__)
_SHARED = ("numerics", "model")
"""Folders of the package whose code is compiled into kernels of other files."""


@cache
def _shared_sources() -> str:
    """Return a digest of the files whose code is compiled into kernels of other files."""
    root = Path(__file__).parents[1]
    files = sorted(file for folder in _SHARED for file in (root / folder).glob("*.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


class _Cache(FunctionCache):
    """Numba's cache of one kernel; in addition to the kernel's own file, which numba watches, a
    change of a shared file makes the machine code obsolete.
    """

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


P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numeric kernel with numba and keep the machine code for the next process.

    The kernel releases the interpreter lock; therefore a kernel must read and write nothing but its
    arguments.
    """
    return _kept(function, nogil=True, error_model="numpy")


def compiled_sums(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel of long sums; additions may be reordered, vectorised and fused."""
    return _kept(function, error_model="numpy", fastmath={"reassoc", "contract"})


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small kernel into every caller, because a call takes as long as the kernel."""
    return cast(Callable[P, R], njit(inline="always", error_model="numpy")(function))


def _kept(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    kernel = njit(**options)(function)
    try:
        kernel._cache = _Cache(function)
    except RuntimeError:
        # The message of numba is replaced, because it states the name of a kernel, which does not
        # help an operator.
        _say_not_kept("no cache folder is writable")
    return cast(Callable[P, R], kernel)


LEAST = -700.0
"""Least exponent; for a smaller exponent the result would not be a normal floating-point number."""
_LOG2_E = 1.0 / math.log(2.0)
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""Natural logarithm of 2 as a sum of two numbers; the first number has 32 bits, so that its small
multiples are exact (fdlibm, e_exp.c).
"""
_ROUNDING = 1.5 * 2.0**52
"""Number that is added to a value so that the last bits of the sum hold the nearest integer."""
_BIAS, _FRACTION = 1023, 52
_2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13 = (1.0 / math.factorial(k) for k in range(2, 14))


@inlined
def exponential(x: float) -> float:
    """Return exp(x) for ``LEAST`` <= x <= 0, to 1.1 units in the last place.

    exp(x) = 2^n exp(r) with |r| <= ln(2) / 2, where 14 terms of the series suffice.
    """
    shifted = x * _LOG2_E + _ROUNDING
    n = shifted - _ROUNDING
    r = (x - n * _LN2_HIGH) - n * _LN2_LOW
    square = r * r
    fourth = square * square
    low = (_2 + r * _3) + square * (_4 + r * _5)
    middle = (_6 + r * _7) + square * (_8 + r * _9)
    high = (_10 + r * _11) + square * (_12 + r * _13)
    series = 1.0 + (r + square * (low + fourth * (middle + fourth * high)))
    power = (np.float64(shifted).view(np.int64) + _BIAS) << _FRACTION
    return float(series * np.int64(power).view(np.float64))


One = TypeVar("One")
Other = TypeVar("Other")
Item = TypeVar("Item")
THREAD = "second thread of the kernels"  # first part of the name of the thread


@cache
def _second(_process: int) -> tuple[ThreadPoolExecutor, Lock]:
    """Return a process' second thread and its lock; a forked process gets a new one."""
    return ThreadPoolExecutor(1, thread_name_prefix=THREAD), Lock()


def idle() -> bool:
    """Return whether the second thread is free."""
    return not _second(os.getpid())[1].locked()


def both(one: Callable[[], One], other: Callable[[], Other]) -> tuple[One, Other]:
    """Return the results of two functions that are called at the same time.

    If the second thread is busy, for example because one of the functions uses it, the functions
    are called one after the other.
    """
    thread, used = _second(os.getpid())
    if not used.acquire(blocking=False):
        return one(), other()
    try:
        beside = thread.submit(other)
        try:
            first = one()
        finally:
            wait([beside])
        return first, beside.result()
    finally:
        used.release()


def each(function: Callable[[Item], One], items: Iterable[Item]) -> list[One]:
    """Return the results of a function for all items, in their order, with two items at a time.

    The function must not change data that another call of it reads.
    """
    todo, found, taking = iter(enumerate(items)), dict[int, One](), Lock()

    def work() -> None:
        while True:
            with taking:
                number, item = next(todo, (None, None))
            if number is None:
                return
            found[number] = function(cast(Item, item))

    both(work, work)
    return [found[number] for number in range(len(found))]
