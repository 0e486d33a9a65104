"""The one place that asks for compilation, so that options are the same everywhere.

The machine code is kept beside each module and renewed when that module changes, not when one it calls does: after
editing a called kernel run ``make clean``, or touch the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numeric kernel with numba and keep the machine code on disk for the next process.

    Other threads run meanwhile: a kernel touches nothing but its arguments.
    """
    return cast(Callable[P, R], njit(cache=True, nogil=True, error_model="numpy")(function))


def compiled_sums(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel of long sums, whose terms may be added in any order: several at a time, and fused."""
    return cast(Callable[P, R], njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})(function))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small kernel into each that calls it: a call costs as much as a few operations."""
    return cast(Callable[P, R], njit(inline="always", error_model="numpy")(function))
