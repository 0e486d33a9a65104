"""Minimises a robust cost of few parameters by Levenberg-Marquardt steps within bounds.

Each step minimises the damped quadratic model of the cost within the bounds, so that a parameter
can stop at a bound and leave the bound in a later step. Source: Kanzow, Yamashita and Fukushima,
Journal of Computational and Applied Mathematics 172 (2004) 375.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from identification.numerics.arrays import Array
from identification.numerics.least_squares import equilibrated
from identification.numerics.levenberg_marquardt import Minimum, huber, huber_weight

_EASIER, _HARDER = 0.2, 4.0
_FIRST_DAMPING, _LAST_DAMPING = 1e-3, 1e6
_RIDGE = 1e-12


@dataclass(frozen=True)
class Box:
    """Bounds of the parameters, both of shape (p,)."""

    low: Array
    high: Array

    def clip(self, x: Array) -> Array:
        """Return the nearest point within the bounds."""
        return np.clip(x, self.low, self.high)


def minimise_within(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array, Array], Array],
    start: Array,
    box: Box,
    *,
    threshold: Array,
    tolerance: float,
    most_steps: int = 40,
) -> Minimum:
    """Minimise the sum of the Huber costs of ``residuals`` within bounds.

    Args:
        residuals: Function of x that returns the residuals, shape (n,).
        jacobian: Function of x and of the residuals at x that returns the Jacobian, shape (n, p).
        start: Start values, shape (p,); values beyond a bound are moved to the bound.
        box: The bounds.
        threshold: Size up to which each residual's cost is quadratic, shape (n,); infinite for
            least squares.
        tolerance: The search ends when a step decreases the cost by less than this share.
        most_steps: Greatest number of steps that are tried.
    """
    x = box.clip(start)
    here = residuals(x)
    cost = float(np.sum(huber(here, threshold)))
    damping, steps = _FIRST_DAMPING, 0
    while steps < most_steps:
        slope = jacobian(x, here)
        weight = huber_weight(here, threshold)
        normal = slope.T @ (slope * weight[:, None])
        gradient = slope.T @ (weight * here)
        gain = 0.0
        while steps < most_steps and damping < _LAST_DAMPING:
            steps += 1
            trial = box.clip(x + bounded_step(normal, gradient, damping, x, box))
            there = residuals(trial)
            value = float(np.sum(huber(there, threshold)))
            if value < cost:
                gain, x, cost, here = cost - value, trial, value, there
                damping = max(damping * _EASIER, _RIDGE)
                break
            damping *= _HARDER
        # A cost of NaN is not less than the present cost, so that the gain stays zero.
        if not gain > tolerance * (cost + gain):
            break
    return Minimum(x, cost, steps)


def bounded_step(normal: Array, gradient: Array, damping: float, x: Array, box: Box) -> Array:
    """Return the step that minimises the damped quadratic model within the bounds, shape (p,).

    Args:
        normal: Normal matrix, shape (p, p).
        gradient: Shape (p,).
        damping: Share of the diagonal that is added to the diagonal.
        x: The point, shape (p,).
        box: The bounds.
    """
    even, scale = equilibrated(normal)
    factor = np.linalg.cholesky(even + (damping + _RIDGE) * np.eye(len(x)))
    right = -np.linalg.solve(factor, gradient / scale)
    low, high = (box.low - x) * scale, (box.high - x) * scale
    step = np.linalg.solve(factor.T, right)
    if np.any(step < low) or np.any(step > high):
        step = optimize.lsq_linear(factor.T, right, bounds=(low, high + 1e-300), method="bvls").x
    return np.asarray(step / scale)
