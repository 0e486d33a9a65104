"""Least squares over many rows and few columns."""

from __future__ import annotations

import numpy as np

from identification.recording import Array

FIT_FOR_NORMAL = 1e-8
"""Least over greatest eigenvalue of the columns' correlations from which on the normal equations will do."""


def least_squares(columns: Array, target: Array, rcond: float = 1e-10) -> Array:
    """Return the coefficients of columns, shape (n, k), that leave least of a target, shape (n,).

    By normal equations and one correction, which takes a tenth of the time and is as exact where columns are apart; by
    singular values, those below ``rcond`` of the greatest left out, where they are not.
    """
    inner = columns.T @ columns
    length = np.sqrt(np.diag(inner))
    if not len(length) or np.any(length == 0.0):
        return np.asarray(np.linalg.lstsq(columns, target, rcond=rcond)[0])
    values, vectors = np.linalg.eigh(inner / np.outer(length, length))
    if not values[0] > FIT_FOR_NORMAL * values[-1]:
        return np.asarray(np.linalg.lstsq(columns, target, rcond=rcond)[0])
    inverse = (vectors / values) @ vectors.T / np.outer(length, length)
    found = inverse @ (columns.T @ target)
    return np.asarray(found + inverse @ (columns.T @ (target - columns @ found)))
