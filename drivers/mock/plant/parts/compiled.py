"""Compiles the numeric kernels of the simulation with numba, all with the same options.

:mod:`drivers.mock.plant.parts.kernel_cache` keeps the machine code on disk for the next process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.mock.plant.parts.kernel_cache import KernelCache

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
    operations, which take longer than the formulas: the kernel with injected effects would be 2.7
    times slower, and the nominal kernel slower by a sixth.
    """
    return _kept(function, **_INLINED)


def _kept(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    kernel = njit(**options)(function)
    kernel._cache = KernelCache(kernel.py_func)
    return cast(Callable[P, R], kernel)
