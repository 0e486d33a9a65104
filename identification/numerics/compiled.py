"""Compilation of numeric kernels by numba, with the same options everywhere.

The machine code is cached beside each module and renewed when that module changes, not when a kernel it calls changes:
after editing a called kernel run ``make clean``, or touch the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numeric kernel with numba and cache the machine code on disk.

    The kernel releases the interpreter lock, so it must touch nothing but its arguments.
    """
    return cast(Callable[P, R], njit(cache=True, nogil=True, error_model="numpy")(function))


def compiled_sums(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel of long sums whose terms may be added in any order, several at a time."""
    return cast(Callable[P, R], njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})(function))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small kernel into every caller: a call would cost as much as the kernel."""
    return cast(Callable[P, R], njit(inline="always", error_model="numpy")(function))
