"""The one place that asks for compilation, so that options are the same everywhere.

The machine code is kept on disk for the next process: :mod:`identification.kernel_cache`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

from numba import njit

from identification.kernel_cache import KernelCache

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numeric kernel with numba and keep the machine code for the next process.

    Other threads run meanwhile: a kernel touches nothing but its arguments.
    """
    return _kept(function, nogil=True, error_model="numpy")


def compiled_sums(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel of long sums, whose terms may be added in any order: several at a time, and fused."""
    return _kept(function, error_model="numpy", fastmath={"reassoc", "contract"})


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small kernel into each that calls it: a call costs as much as a few operations."""
    return cast(Callable[P, R], njit(inline="always", error_model="numpy")(function))


def _kept(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    kernel = njit(**options)(function)
    kernel._cache = KernelCache(kernel.py_func)
    return cast(Callable[P, R], kernel)
