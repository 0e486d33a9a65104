"""Type names of numpy arrays, for the type hints of all numerical modules."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


Progress = Callable[[str, float], None]
"""Function that is called with the label of the current step and the share of the step that is
done, 0 to 1.
"""


def silent(_what: str, _share: float) -> None:
    """Ignore the progress."""
