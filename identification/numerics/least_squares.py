"""Solves linear least squares of many rows and few columns, and scales normal equations."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled

LEAST_EIGENVALUE_RATIO = 1e-8
"""Least ratio of the smallest to the greatest eigenvalue of the correlation matrix of the columns
for which the normal equations are used.
"""

LEAST_LENGTH = 1e-140
"""Least norm of a column; the square of a smaller one nears the smallest normal number."""


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


def unit_columns(columns: Array) -> tuple[Array, Array]:
    """Return columns of unit norm, shape (n, p), and the scale by which they were divided, (p,); a
    column of zeros stays.
    """
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    return columns / scale, scale


def scaled_least_squares(columns: Array, target: Array, rcond: float = 1e-10) -> Array:
    """Return :func:`least_squares` coefficients of columns whose norms may differ by far."""
    even, scale = unit_columns(columns)
    return least_squares(even, target, rcond) / scale


def equilibrated(normal: Array) -> tuple[Array, Array]:
    """Return a normal matrix scaled to a diagonal of ones, shape (p, p), and the scale of its
    columns, shape (p,).

    Unscaled elements differ by many orders of magnitude, because the parameters have different
    units. The diagonal element of a parameter without effect is zero and stays zero.
    """
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    return normal / np.outer(scale, scale), scale


@dataclass(frozen=True)
class Design:
    """A bounded linear problem: minimise |columns x - target|^2 with low <= x <= high."""

    columns: Array  # shape (n, p)
    target: Array  # shape (n,)
    low: Array  # least value of each coefficient, shape (p,)
    high: Array  # greatest value of each coefficient, shape (p,)


def bounded_least_squares(design: Design) -> tuple[Array, float]:
    """Solve least squares within the bounds; return (coefficients, sum of squared residuals).

    A QR decomposition first reduces the problem, so that the cost keeps full precision on
    noise-free data.
    """
    p = design.columns.shape[1]
    even, scale = unit_columns(design.columns)
    reduced: Array = np.asarray(np.linalg.qr(np.column_stack([even, design.target]), mode="r"))
    matrix, right = reduced[:p, :p], reduced[:p, p]
    rest = float(reduced[p, p] ** 2) if reduced.shape[0] > p else 0.0
    low, high = design.low * scale, design.high * scale
    solution = np.linalg.lstsq(matrix, right, rcond=None)[0]
    if np.any(solution < low) or np.any(solution > high):
        solution = optimize.lsq_linear(matrix, right, bounds=(low, high), method="bvls").x
    misfit = matrix @ solution - right
    return solution / scale, float(misfit @ misfit) + rest


_Known = TypeVar("_Known")
_EASIER, _HARDER = 0.2, 4.0
_FIRST_DAMPING, _LAST_DAMPING, _LAST_DAMPING_WITHIN = 1e-3, 1e9, 1e6
_MOST_STEPS = 25
_RIDGE = 1e-12  # least damping within bounds, and what is added to it


class Slope(Protocol):
    """A Jacobian of shape (n, p) that is not stored as a dense array."""

    def product(self, weight: Array, /) -> Array:
        """Return the normal matrix J.T diag(weight) J, shape (p, p)."""

    def back(self, vector: Array, /) -> Array:
        """Return J.T times a vector of shape (n,), shape (p,)."""


@dataclass(frozen=True)
class Box:
    """Bounds of the parameters, both of shape (p,)."""

    low: Array
    high: Array

    def clip(self, x: Array) -> Array:
        """Return the nearest point within the bounds."""
        return np.clip(x, self.low, self.high)


@dataclass(frozen=True)
class Minimum:
    """End of a search."""

    x: Array  # point at which the search ended, shape (p,)
    cost: float  # cost at this point
    steps: int  # number of steps tried
    # Whether the search was stopped because it would not have reached the cost `reach` of another
    # search.
    beaten: bool = False


def huber(residual: Array, threshold: float | Array) -> Array:
    """Return the Huber cost of each residual r, an array of the shape of ``residual``: r^2/2 within
    the threshold, and threshold (|r| - threshold/2) beyond. ``threshold`` is one value for all
    residuals, or one value for each residual.
    """
    size = np.minimum(np.abs(residual), threshold)
    return np.asarray(size * (np.abs(residual) - 0.5 * size))


def huber_weight(residual: Array, threshold: float | Array) -> Array:
    """Return Huber's weights, 1 within the threshold and threshold / |r| beyond it."""
    return np.asarray(np.minimum(1.0, threshold / np.maximum(np.abs(residual), 1e-300)))


def huber_cost(residual: Array, threshold: float | Array) -> float:
    """Return the sum of the Huber costs (:func:`huber`) of the residuals."""
    return float(np.sum(huber(residual, threshold)))


def negative_log_likelihood(error: Array, deviation: Array, threshold: float) -> float:
    """Return the negative log likelihood of errors with these standard deviations, shape (n,) each
    (M23), up to a constant; for errors beyond the threshold Huber's cost replaces the square.
    """
    return huber_cost(error / deviation, threshold) + float(np.sum(np.log(deviation)))


def minimise(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array, Array], Array | Slope],
    start: Array,
    *,
    threshold: float | Array,
    tolerance: float,
    most_steps: int = _MOST_STEPS,
    box: Box | None = None,
) -> Minimum:
    """Minimise the Huber cost of ``residuals``, within bounds if there are any.

    Args:
        residuals: Function of x that returns the residuals, shape (n,).
        jacobian: Function of x and of the residuals at x that returns the Jacobian, shape (n, p).
        start: Start values, shape (p,); values beyond a bound are moved to the bound.
        threshold: Residual size up to which the cost is quadratic, of all residuals or of each,
            shape (n,); infinite for least squares.
        tolerance: The search ends when a step decreases the cost by less than this share.
        most_steps: Greatest number of steps that are tried.
        box: Bounds of x, or None.
    """

    def evaluate(x: Array) -> tuple[float, Array]:
        residual = residuals(x)
        return huber_cost(residual, threshold), residual

    def linearise(x: Array, residual: Array) -> tuple[Array, Array]:
        slope = jacobian(x, residual)
        weight = huber_weight(residual, threshold)
        return _normal(slope, weight), _back(slope, weight * residual)

    def settled(gain: float, cost: float) -> bool:
        return gain <= tolerance * (cost + gain)

    return _descend(evaluate, linearise, start, settled, most_steps, box)[0]


def minimise_deviance(
    predictions: Callable[[Array], tuple[Array, Array]],
    derivatives: Callable[[Array, Array, Array], tuple[Array, Array] | tuple[Slope, Slope]],
    start: Array,
    *,
    threshold: float,
    tolerance: float,
    reach: float = math.inf,
) -> Minimum:
    """Minimise the negative log likelihood of errors whose standard deviations depend on x too
    (M23), by the scoring method with damping.

    For errors beyond the threshold, Huber's cost replaces the square.

    Args:
        predictions: Function of x that returns the errors and their standard deviations, shape (n,)
            each.
        derivatives: Function of x and of the errors and deviations at x that returns two Jacobians
            of shape (n, p): of the errors, divided by their deviations, and of the logarithms of
            the deviations.
        start: Shape (p,).
        threshold: Error over deviation up to which the cost is quadratic.
        tolerance: The search ends when a step decreases the cost by no more than this value.
        reach: Cost that another search reached. The search ends when :data:`_MOST_STEPS` steps,
            each with the decrease of the last step, would not reach this cost.
    """

    def evaluate(x: Array) -> tuple[float, tuple[Array, Array]]:
        error, deviation = predictions(x)
        return negative_log_likelihood(error, deviation, threshold), (error, deviation)

    def linearise(x: Array, here: tuple[Array, Array]) -> tuple[Array, Array]:
        mean, spread = derivatives(x, *here)
        ratio = here[0] / here[1]
        weight = huber_weight(ratio, threshold)
        normal = _normal(mean, weight) + 2.0 * _normal(spread, np.ones_like(weight))
        return normal, _back(mean, weight * ratio) + _back(spread, 1.0 - weight * ratio**2)

    def beaten(gain: float, cost: float) -> bool:
        return cost - reach > _MOST_STEPS * gain

    def settled(gain: float, cost: float) -> bool:
        return gain <= tolerance or beaten(gain, cost)

    found, gain = _descend(evaluate, linearise, start, settled, _MOST_STEPS)
    return replace(found, beaten=beaten(gain, found.cost))


def _normal(slope: Array | Slope, weight: Array) -> Array:
    """Return the normal matrix of weighted rows, shape (p, p)."""
    if isinstance(slope, np.ndarray):
        return np.asarray(slope.T @ (slope * weight[:, None]))
    return slope.product(weight)


def _back(slope: Array | Slope, vector: Array) -> Array:
    """Return the transpose of ``slope`` times a vector, shape (p,)."""
    return np.asarray(slope.T @ vector) if isinstance(slope, np.ndarray) else slope.back(vector)


def _descend(
    evaluate: Callable[[Array], tuple[float, _Known]],
    linearise: Callable[[Array, _Known], tuple[Array, Array]],
    start: Array,
    settled: Callable[[float, float], bool],
    most_steps: int,
    box: Box | None = None,
) -> tuple[Minimum, float]:
    """Take damped steps until ``settled`` returns true; return the end point and the decrease of
    the cost in the last step.

    Args:
        evaluate: Function of x that returns its cost and the data that ``linearise`` needs at x.
        linearise: Function of x and of these data that returns the normal matrix, shape (p, p), and
            the gradient, shape (p,).
        start: Shape (p,).
        settled: Function of the decrease of the cost in a step, and of the cost after the step; it
            returns whether the search ends.
        most_steps: Greatest number of steps that are tried.
        box: Bounds of x, or None.
    """
    x = start.copy() if box is None else box.clip(start)
    last, least = (_LAST_DAMPING, 0.0) if box is None else (_LAST_DAMPING_WITHIN, _RIDGE)
    cost, here = evaluate(x)
    damping = _FIRST_DAMPING
    steps, gain = 0, 0.0
    while steps < most_steps:
        normal, gradient = linearise(x, here)
        even, scale = equilibrated(normal)
        right = -gradient / scale
        gain = 0.0
        while steps < most_steps and damping < last:
            steps += 1
            if box is None:
                trial = x + np.linalg.solve(even + damping * np.eye(len(x)), right) / scale
            else:
                trial = box.clip(x + _bounded_step(even, scale, right, damping, x, box))
            value, there = evaluate(trial)
            if value < cost:
                gain, x, cost, here = cost - value, trial, value, there
                damping = max(damping * _EASIER, least)
                break
            damping *= _HARDER
        # A cost of NaN is not less than the present cost, so that the gain stays zero.
        if not gain > 0.0 or settled(gain, cost):
            break
    return Minimum(x, cost, steps), gain


def _bounded_step(
    even: Array, scale: Array, right: Array, damping: float, x: Array, box: Box
) -> Array:
    """Return the step that minimises the damped quadratic model within the bounds, shape (p,);
    ``even`` and ``right`` are normal matrix and negative gradient of scaled parameters.
    """
    factor = np.linalg.cholesky(even + (damping + _RIDGE) * np.eye(len(x)))
    right = np.linalg.solve(factor, right)
    low, high = (box.low - x) * scale, (box.high - x) * scale
    step = np.linalg.solve(factor.T, right)
    if np.any(step < low) or np.any(step > high):
        step = optimize.lsq_linear(factor.T, right, bounds=(low, high + 1e-300), method="bvls").x
    return np.asarray(step / scale)


@dataclass(frozen=True)
class Eliminated:
    """Normal equations with the extra unknowns eliminated; p parameters, m blocks."""

    matrix: Array  # schur complement of the extra unknowns in the normal matrix, shape (p, p)
    scores: Array  # gradient of half the sum of squares of each block, shape (m, p)
    # Part of the normal matrix with extra unknowns as rows and parameters as columns, shape (m, p).
    cross: Array
    pull: Array  # gradient with respect to each extra unknown, shape (m,)
    # Diagonal elements of the extra unknowns, shape (m,); infinite if a block does not depend on
    # its extra unknown, so that this unknown keeps its value.
    held: Array

    def own_step(self, step: Array) -> Array:
        """Return the step of the extra unknowns for a ``step`` of the parameters, shape (m,)."""
        return -(self.pull + self.cross @ step) / self.held


@dataclass(frozen=True)
class BlockArrow:
    """Jacobian of r rows in p parameters and m extra unknowns; dense: shape (r, p + m)."""

    parameters: Array  # derivatives with respect to the parameters, shape (r, p)
    own: Array  # derivative of each row with respect to the extra unknown of its block, shape (r,)
    owners: NDArray[np.int64]  # block of each row, shape (r,)
    blocks: int  # number of blocks, m

    def product(self, weight: Array | None = None, other: BlockArrow | None = None) -> Array:
        """Return ``self.T @ diag(weight) @ other``, shape (p + m, p + m); ``other``: self."""
        found = self._products(weight, self if other is None else other)
        p = self.parameters.shape[1]
        out = np.zeros((p + self.blocks, p + self.blocks))
        out[:p, :p] = np.sum(found[:, :p, :p], axis=0)
        out[p:, :p], out[:p, p:] = found[:, p, :p], found[:, :p, p].T
        at = p + np.arange(self.blocks)
        out[at, at] = found[:, p, p]
        return out

    def back(self, vector: Array) -> Array:
        """Return ``self.T @ vector`` for a vector of shape (r,), shape (p + m,)."""
        times = np.bincount(self.owners, self.own * vector, self.blocks)
        return np.concatenate([self.parameters.T @ vector, times])

    def along(self, directions: Array) -> Array:
        """Return ``self @ directions``, for ``directions`` of shape (p + m,) or (p + m, k)."""
        p = self.parameters.shape[1]
        own = self.own if directions.ndim == 1 else self.own[:, None]
        return np.asarray(self.parameters @ directions[:p] + own * directions[p:][self.owners])

    def eliminated(self, residual: Array, weight: Array) -> Eliminated:
        """Return the normal equations of weighted residuals of shape (r,) with the extra unknowns
        eliminated.

        Each row is read once. The normal equations of two sets of rows without common blocks may be
        added.
        """
        p = self.parameters.shape[1]
        whole = self.product(weight)
        cross, own = whole[p:, :p], np.diag(whole)[p:]
        pull = np.asarray(
            np.bincount(self.owners, self.own * weight * residual, self.blocks), dtype=np.float64
        )
        held = np.where(own > 0.0, own, np.inf)
        share = cross / held[:, None]
        scores = self.by_block(weight * residual, self.parameters) - share * pull[:, None]
        return Eliminated(whole[:p, :p] - cross.T @ share, scores, cross, pull, held)

    def information_by_block(self) -> Array:
        """Return each block's information on the parameters, less its unknown (M12), (m, p, p)."""
        p = self.parameters.shape[1]
        found = self._products(None, self)
        cross, own = found[:, p, :p], found[:, p, p]
        share = cross / np.where(own > 0.0, own, np.inf)[:, None]
        return np.asarray(found[:, :p, :p] - cross[:, :, None] * share[:, None, :])

    def scaled(self, weight: Array) -> BlockArrow:
        """Return the Jacobian with every row multiplied by its weight."""
        return replace(self, parameters=self.parameters * weight[:, None], own=self.own * weight)

    def mixed(self, share: Array, other: BlockArrow) -> BlockArrow:
        """Return ``share * self + (1 - share) * other``, row by row."""
        return replace(
            self,
            parameters=other.parameters + (self.parameters - other.parameters) * share[:, None],
            own=other.own + (self.own - other.own) * share,
        )

    def without(self, column: int) -> BlockArrow:
        """Return the Jacobian without the column of one parameter."""
        return replace(self, parameters=np.delete(self.parameters, column, axis=1))

    def by_block(self, factor: Array, columns: Array) -> Array:
        """Return the sum of ``factor`` times each column over the rows of every block, for columns
        of shape (r, k), shape (m, k).
        """
        out = np.zeros((self.blocks, columns.shape[1]))
        _add_by_block(np.ascontiguousarray(columns), factor, self.owners, out)
        return out

    def _products(self, weight: Array | None, other: BlockArrow) -> Array:
        """Return each block's weighted products, extra unknown last, (m, p + 1, p + 1)."""
        weight = np.ones(len(self.own)) if weight is None else weight
        size, width = self.parameters.shape[1] + 1, other.parameters.shape[1] + 1
        out = np.zeros((self.blocks, size, width))
        rows = (np.ascontiguousarray(j.parameters) for j in (self, other))
        left, right = rows
        _add_products(left, self.own, right, other.own, weight, self.owners, out)
        return out


@compiled
def _add_by_block(columns: Array, factor: Array, owners: NDArray[np.int64], out: Array) -> None:
    """Add each row of ``columns`` times its factor to its block's row of ``out``."""
    for r in range(len(columns)):
        row, scale = out[owners[r]], factor[r]
        for j in range(columns.shape[1]):
            row[j] += scale * columns[r, j]


@compiled
def _add_products(
    left: Array,
    left_own: Array,
    right: Array,
    right_own: Array,
    weight: Array,
    owners: NDArray[np.int64],
    out: Array,
) -> None:
    """Add the products of each row, extra unknown last, to its block, (m, p + 1, q + 1)."""
    p, q = left.shape[1], right.shape[1]
    for r in range(len(left)):
        sums = out[owners[r]]
        for i in range(p + 1):
            scale = weight[r] * (left[r, i] if i < p else left_own[r])
            row = sums[i]
            for j in range(q):
                row[j] += scale * right[r, j]
            row[q] += scale * right_own[r]
