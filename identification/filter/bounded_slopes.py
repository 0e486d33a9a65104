"""Scales and bounds the derivatives of residuals, in one pass over the array of derivatives."""

from __future__ import annotations

import numpy as np

from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled


def bounded(slopes: Array, ties: Array, scale: Array, bound: Array) -> tuple[Array, Array]:
    """Return the derivatives of innovations, shape (r - m, d), and of ties, shape (m, d), divided
    by the scale of their row and limited to the bound of their column; undefined derivatives become
    zero. The result has the columns of the parameters, shape (r, d - 1), and the column of the
    breakaway time, shape (r,).
    """
    parameters, own = np.empty((len(scale), len(bound) - 1)), np.empty(len(scale))
    cut = len(slopes)
    _limit(slopes, scale[:cut], bound, parameters[:cut], own[:cut])
    _limit(ties, scale[cut:], bound, parameters[cut:], own[cut:])
    return parameters, own


@compiled
def _limit(slopes: Array, scale: Array, bound: Array, parameters: Array, own: Array) -> None:
    """Fill ``parameters`` and ``own`` as described in :func:`bounded`."""
    last = slopes.shape[1] - 1
    for r in range(len(slopes)):
        for j in range(last + 1):
            slope = slopes[r, j] / scale[r]
            slope = min(max(slope, -bound[j]), bound[j]) if slope == slope else 0.0
            if j < last:
                parameters[r, j] = slope
            else:
                own[r] = slope
