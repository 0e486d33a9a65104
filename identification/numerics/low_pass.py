"""Low-pass filter without phase: a fourth-order Butterworth filter, forwards and backwards.

scipy.signal has such a filter, but the import of scipy.signal takes a fifth of the time of all
imports.
"""

from __future__ import annotations

import math

import numpy as np

from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled

_ANGLES = (math.pi / 8.0, 3.0 * math.pi / 8.0)
"""Angles of the poles of a fourth-order Butterworth filter from the imaginary axis."""


def sections(share: float) -> Array:
    """Return numerator and denominator of the two second-order sections of a fourth-order
    Butterworth low-pass, by the bilinear transformation, shape (2, 6).

    Args:
        share: Cut-off over half the sampling rate, between 0 and 1.
    """
    warped = math.tan(0.5 * math.pi * share)
    square = warped * warped
    out = []
    for angle in _ANGLES:
        damping = 2.0 * warped * math.sin(angle)
        whole = 1.0 + damping + square
        gain = square / whole
        denominator = (1.0, 2.0 * (square - 1.0) / whole, (1.0 - damping + square) / whole)
        out.append((gain, 2.0 * gain, gain, *denominator))
    return np.array(out)


def forwards_and_backwards(filters: Array, values: Array, padding: int) -> Array:
    """Return values filtered forwards and backwards, shape (n,).

    The series is continued at both ends by its point reflection in the end value. Each pass of the
    filter starts in the steady state for its first value (alternatives: Gustafsson, IEEE
    Transactions on Signal Processing 44 (1996) 988).

    Args:
        filters: Second-order sections of unit static gain, shape (k, 6).
        values: Shape (n,).
        padding: Number of values added at each end, less than n.
    """
    longer = np.concatenate(
        [
            2.0 * values[0] - values[padding:0:-1],
            values,
            2.0 * values[-1] - values[-2 : -padding - 2 : -1],
        ]
    )
    for _ in range(2):
        _filter(filters, longer)
        longer = longer[::-1].copy()
    return longer[padding : padding + len(values)].copy()


@compiled
def _filter(filters: Array, values: Array) -> None:
    """Filter values in place through second-order sections (transposed direct form II)."""
    for s in filters:
        b0, b1, b2, a1, a2 = s[0], s[1], s[2], s[4], s[5]
        # The initial state is the steady state for a constant input of the first value; the static
        # gain is one.
        one, two = (1.0 - b0) * values[0], (b2 - a2) * values[0]
        for k in range(len(values)):
            x = values[k]
            y = b0 * x + one
            one = b1 * x - a1 * y + two
            two = b2 * x - a2 * y
            values[k] = y
