"""Solves linear least squares with bounds on the coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from identification.numerics.arrays import Array


@dataclass(frozen=True)
class Design:
    """A bounded linear problem: minimise |columns x - target|^2 with low <= x <= high.

    Attributes:
        columns: Shape (n, p).
        target: Shape (n,).
        low: Least value of each coefficient, shape (p,).
        high: Greatest value of each coefficient, shape (p,).
    """

    columns: Array
    target: Array
    low: Array
    high: Array


def bounded_least_squares(design: Design) -> tuple[Array, float]:
    """Solve least squares within the bounds; return (coefficients, sum of squared residuals).

    A QR decomposition first reduces the problem, so that the cost keeps full precision on
    noise-free data.
    """
    p = design.columns.shape[1]
    scale = np.linalg.norm(design.columns, axis=0)
    scale[scale == 0.0] = 1.0
    reduced: Array = np.asarray(
        np.linalg.qr(np.column_stack([design.columns / scale, design.target]), mode="r")
    )
    matrix, right = reduced[:p, :p], reduced[:p, p]
    rest = float(reduced[p, p] ** 2) if reduced.shape[0] > p else 0.0
    low, high = design.low * scale, design.high * scale
    solution = np.linalg.lstsq(matrix, right, rcond=None)[0]
    if np.any(solution < low) or np.any(solution > high):
        solution = optimize.lsq_linear(matrix, right, bounds=(low, high), method="bvls").x
    misfit = matrix @ solution - right
    return solution / scale, float(misfit @ misfit) + rest
