"""Variable projection (M9): a search in the Stribeck speed, with linear least squares for all other
parameters.

At a given Stribeck speed omega_s, each stage of the equation error is linear. With Ms = Mc + dM and
bounds on the coefficients (only the offset may be below 0, and the rise is at most the greatest
recorded torque), bounded least squares give the coefficients for any trial omega_s. The only
remaining unknown is log omega_s; a search in all parameters would have several basins. Golub and
Pereyra, SIAM J. Numer. Anal. 10 (1973) 413.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from identification.numerics.arrays import Array
from identification.numerics.bounded_least_squares import Design, bounded_least_squares

GRID = 40
"""Number of Stribeck speeds that are tried before the bracketed search."""


@dataclass(frozen=True)
class Solution:
    """Solution of one stage, with the history of its search.

    Attributes:
        omega_s: Stribeck speed of least cost.
        coefficients: Linear coefficients at this Stribeck speed, shape (p,).
        cost: Sum of squared residuals.
        evaluations: Number of least-squares solutions.
        omega_history: Best omega_s so far after each evaluation, shape (e,).
        coefficient_history: Coefficients at these Stribeck speeds, shape (e, p).
        cost_history: Costs at these Stribeck speeds, shape (e,).
    """

    omega_s: float
    coefficients: Array
    cost: float
    evaluations: int
    omega_history: Array
    coefficient_history: Array
    cost_history: Array


def solve(design: Callable[[float], Design], low: float, high: float) -> Solution:
    """Minimise the cost of ``design(omega_s)`` over its coefficients and over log omega_s.

    Args:
        design: Function of omega_s that returns the remaining linear problem.
        low: Least omega_s that is tried, rad/s.
        high: Greatest omega_s that is tried, rad/s; equal to ``low`` to keep omega_s fixed.
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
