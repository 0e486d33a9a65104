"""Compiles numeric kernels with numba, with the same options for all kernels.

:mod:`identification.numerics.kernel_cache` keeps the machine code on disk for the next process.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from threading import Lock
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit

from identification.numerics.kernel_cache import KernelCache

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numeric kernel with numba and keep the machine code for the next process.

    The kernel releases the interpreter lock; therefore a kernel must read and write nothing but its
    arguments.
    """
    return _kept(function, nogil=True, error_model="numpy")


def compiled_sums(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel of long sums; the compiler may reorder additions, vectorise them, and fuse
    them with multiplications.
    """
    return _kept(function, error_model="numpy", fastmath={"reassoc", "contract"})


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small kernel into every caller, because a call would take as long as the kernel
    itself.
    """
    return cast(Callable[P, R], njit(inline="always", error_model="numpy")(function))


def _kept(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    kernel = njit(**options)(function)
    kernel._cache = KernelCache(kernel.py_func)
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
THREAD = "second thread of the kernels"
"""First part of the name of the thread."""


@cache
def _second(_process: int) -> tuple[ThreadPoolExecutor, Lock]:
    """Return the second thread of a process, and the lock of the caller that uses the thread.

    The process is an argument, so that a forked process, which inherits only its main thread, gets
    a new second thread.
    """
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
