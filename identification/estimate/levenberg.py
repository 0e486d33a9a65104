"""Levenberg-Marquardt on the normal equations, with a Huber cost.

A library's trust-region solver decomposes the whole Jacobian, 40 000 rows by a few dozen columns, at every step; its
normal equations hold the same few numbers at a fraction of the cost. Marquardt, J. SIAM 11 (1963) 431; Huber, Ann.
Math. Statist. 35 (1964) 73.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identification.recording import Array

_EASIER, _HARDER = 0.2, 4.0
_FIRST_DAMPING, _LAST_DAMPING = 1e-3, 1e9


@dataclass(frozen=True)
class Minimum:
    """Where the search ended: ``x`` of shape (p,), the Huber cost there, and how many steps were tried."""

    x: Array
    cost: float
    steps: int


def huber(residual: Array, threshold: float) -> Array:
    """Return r^2/2 within the threshold and threshold (|r| - threshold/2) beyond, shape of ``residual``."""
    size = np.minimum(np.abs(residual), threshold)
    return np.asarray(size * (np.abs(residual) - 0.5 * size))


def huber_weight(residual: Array, threshold: float) -> Array:
    """Return by how much each residual counts beside one within the threshold, at most 1, shape of ``residual``."""
    return np.asarray(np.minimum(1.0, threshold / np.maximum(np.abs(residual), 1e-300)))


def huber_cost(residual: Array, threshold: float) -> float:
    """Return the sum of :func:`huber`."""
    return float(np.sum(huber(residual, threshold)))


def minimise(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array, Array], Array],
    start: Array,
    *,
    threshold: float,
    tolerance: float,
    most_steps: int = 25,
) -> Minimum:
    """Minimise the Huber cost of ``residuals``.

    Args:
        residuals: x to residuals, shape (n,).
        jacobian: (x, residuals there) to the Jacobian, shape (n, p).
        start: Shape (p,).
        threshold: Residual size up to which the cost is quadratic.
        tolerance: The search ends when a step gains less than this share of the cost.
        most_steps: Steps tried at most.
    """
    x = start.copy()
    residual = residuals(x)
    cost = huber_cost(residual, threshold)
    damping = _FIRST_DAMPING
    steps = 0
    while steps < most_steps:
        slope = jacobian(x, residual)
        weighted = slope * huber_weight(residual, threshold)[:, None]
        normal = slope.T @ weighted
        gradient = weighted.T @ residual
        scale = np.sqrt(np.diag(normal))
        scale[scale == 0.0] = 1.0
        normal /= np.outer(scale, scale)
        gain = 0.0
        while steps < most_steps and damping < _LAST_DAMPING:
            steps += 1
            step = np.linalg.solve(normal + damping * np.eye(len(x)), -gradient / scale) / scale
            trial = residuals(x + step)
            value = huber_cost(trial, threshold)
            if value < cost:
                gain, x, residual, cost = (cost - value) / cost, x + step, trial, value
                damping *= _EASIER
                break
            damping *= _HARDER
        if gain <= tolerance:
            break
    return Minimum(x, cost, steps)
