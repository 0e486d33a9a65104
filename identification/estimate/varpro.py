"""Variable projection: given the Stribeck speed, each stage of the model is linear.

With Ms = Mc + dM and bounds on the coefficients (none but the offset below 0, no rise above the greatest torque seen),
the linear part follows from least squares for any trial omega_s. That leaves a search in one unknown, log omega_s,
without the wrong basins of a search in all of them. Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from identification.recording import Array

GRID = 40
"""Trial Stribeck speeds before the bracketed search."""


@dataclass(frozen=True)
class Design:
    """The linear problem left at one omega_s: ``target`` is to be explained by ``columns`` x.

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


@dataclass(frozen=True)
class Solution:
    """A solved stage.

    Attributes:
        omega_s: Stribeck speed of the least cost.
        coefficients: Linear coefficients there, shape (p,).
        cost: Sum of squared residuals.
        evaluations: Least-squares solutions spent.
        omega_history: Best omega_s after each evaluation, shape (e,).
        coefficient_history: Its coefficients, shape (e, p).
        cost_history: Its cost, shape (e,).
    """

    omega_s: float
    coefficients: Array
    cost: float
    evaluations: int
    omega_history: Array
    coefficient_history: Array
    cost_history: Array


def bounded_least_squares(design: Design) -> tuple[Array, float]:
    """Solve least squares within the bounds; return (coefficients, sum of squared residuals).

    The problem is first reduced by QR, so the cost keeps full precision on noise-free data.
    """
    p = design.columns.shape[1]
    scale = np.linalg.norm(design.columns, axis=0)
    scale[scale == 0.0] = 1.0
    reduced: Array = np.asarray(np.linalg.qr(np.column_stack([design.columns / scale, design.target]), mode="r"))
    matrix, right = reduced[:p, :p], reduced[:p, p]
    rest = float(reduced[p, p] ** 2) if reduced.shape[0] > p else 0.0
    low, high = design.low * scale, design.high * scale
    solution = np.linalg.lstsq(matrix, right, rcond=None)[0]
    if np.any(solution < low) or np.any(solution > high):
        solution = optimize.lsq_linear(matrix, right, bounds=(low, high), method="bvls").x
    misfit = matrix @ solution - right
    return solution / scale, float(misfit @ misfit) + rest


def solve(design: Callable[[float], Design], low: float, high: float) -> Solution:
    """Minimise the cost of ``design(omega_s)`` over its coefficients and over log omega_s.

    Args:
        design: omega_s to the linear problem left.
        low: Least omega_s tried, rad/s.
        high: Greatest omega_s tried, rad/s; equal to ``low`` to hold it there.
    """
    tried: list[tuple[float, float, Array]] = []

    def cost(log_omega: float) -> float:
        omega_s = float(np.exp(log_omega))
        coefficients, value = bounded_least_squares(design(omega_s))
        if not tried or value < tried[-1][0]:
            tried.append((value, omega_s, coefficients))
        else:
            tried.append(tried[-1])
        return value

    if low == high:
        cost(float(np.log(low)))
    else:
        grid = np.linspace(np.log(low), np.log(high), GRID)
        costs = [cost(float(g)) for g in grid]
        k = int(np.argmin(costs))
        bracket = (grid[max(k - 1, 0)], grid[min(k + 1, GRID - 1)])
        optimize.minimize_scalar(cost, bounds=bracket, method="bounded", options={"xatol": 1e-9})
    best = tried[-1]
    return Solution(
        omega_s=best[1],
        coefficients=best[2],
        cost=best[0],
        evaluations=len(tried),
        omega_history=np.array([t[1] for t in tried]),
        coefficient_history=np.array([t[2] for t in tried]),
        cost_history=np.array([t[0] for t in tried]),
    )
