"""Solves linear least squares of many rows and few columns, and scales normal equations."""

from __future__ import annotations

import numpy as np

from identification.numerics.arrays import Array

LEAST_EIGENVALUE_RATIO = 1e-8
"""Least ratio of the smallest to the greatest eigenvalue of the correlation matrix of the columns
for which the normal equations are used.
"""

LEAST_LENGTH = 1e-140
"""Least norm of a column; the square of a smaller norm would be close to the smallest normal
floating-point number.
"""


def least_squares(columns: Array, target: Array, rcond: float = 1e-10) -> Array:
    """Return the least-squares coefficients of columns, shape (n, k), for a target, shape (n,).

    For well-conditioned columns the normal equations are solved with one step of iterative
    refinement; the result is as exact as with a singular value decomposition and takes a tenth of
    the time. Ill-conditioned columns are solved by singular value decomposition, without the
    singular values below ``rcond`` times the greatest singular value. The coefficient of a column
    whose norm is about zero is zero, because the quotient of two numbers at the limit of the number
    format may be infinite.
    """
    inner = columns.T @ columns
    length = np.sqrt(np.diag(inner))
    seen = ~(length < LEAST_LENGTH)
    if not np.all(seen):
        found = np.zeros(len(length))
        if np.any(seen):
            found[seen] = least_squares(columns[:, seen], target, rcond)
        return found
    if not len(length):
        return length
    values, vectors = np.linalg.eigh(inner / length / length[:, None])
    if not values[0] > LEAST_EIGENVALUE_RATIO * values[-1]:
        return np.asarray(np.linalg.lstsq(columns, target, rcond=rcond)[0])
    # Rows and columns are scaled one after the other, because the product of two small norms may
    # underflow.
    inverse = (vectors / values) @ vectors.T
    found = inverse @ (columns.T @ target / length) / length
    return np.asarray(found + inverse @ (columns.T @ (target - columns @ found) / length) / length)


def equilibrated(normal: Array) -> tuple[Array, Array]:
    """Return a normal matrix scaled to a diagonal of ones, shape (p, p), and the scale of its
    columns, shape (p,).

    Unscaled elements differ by many orders of magnitude, because the parameters have different
    units. The diagonal element of a parameter without effect is zero and stays zero.
    """
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    return normal / np.outer(scale, scale), scale
