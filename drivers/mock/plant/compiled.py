"""The one place that asks for compilation, so that options are the same everywhere.

The machine code is kept beside each module and renewed when that module changes, not when one it calls does: after
editing a called kernel run ``make clean``, or touch the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]

_INLINED: dict[str, Any] = {"cache": True, "error_model": "numpy", "forceinline": True, "_nrt": False}

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numeric kernel with numba and keep the machine code on disk for the next process."""
    return cast(Callable[P, R], njit(cache=True, error_model="numpy")(function))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel that allocates nothing, for inner loops: its compiled callers take it in whole.

    Without ``_nrt=False`` numba counts references to every array at every call, atomically, which costs more than the
    formulas: the hiding kernel is 2.7 times slower so, and the nominal one by a sixth.
    """
    return cast(Callable[P, R], njit(**_INLINED)(function))
