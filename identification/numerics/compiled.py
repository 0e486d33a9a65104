"""Compiles numeric kernels with numba, with the same options for all kernels.

:mod:`identification.numerics.kernel_cache` keeps the machine code on disk for the next process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

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
