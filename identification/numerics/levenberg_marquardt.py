"""Levenberg-Marquardt method on the normal equations, for a Huber cost or a likelihood.

The trust-region solvers of common libraries decompose the whole Jacobian (here of 40 000 rows and a
few dozen columns) at every step; a step by the normal equations takes a fraction of the time of
such a decomposition. Sources: Marquardt, SIAM Journal 11 (1963) 431; Huber, Annals of Mathematical
Statistics 35 (1964) 73.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from identification.numerics.arrays import Array
from identification.numerics.least_squares import equilibrated

_Known = TypeVar("_Known")
_EASIER, _HARDER = 0.2, 4.0
_FIRST_DAMPING, _LAST_DAMPING = 1e-3, 1e9


class Slope(Protocol):
    """A Jacobian of shape (n, p) that is not stored as a dense array."""

    def product(self, weight: Array, /) -> Array:
        """Return the normal matrix J.T diag(weight) J, shape (p, p)."""

    def back(self, vector: Array, /) -> Array:
        """Return J.T times a vector of shape (n,), shape (p,)."""


@dataclass(frozen=True)
class Minimum:
    """End of a search.

    Attributes:
        x: Point at which the search ended, shape (p,).
        cost: Cost at this point.
        steps: Number of steps tried.
        beaten: Whether the search was stopped because it would not have reached the cost ``reach``
            of another search.
    """

    x: Array
    cost: float
    steps: int
    beaten: bool = False


def huber(residual: Array, threshold: float | Array) -> Array:
    """Return the Huber cost of each residual r, an array of the shape of ``residual``: r^2/2 within
    the threshold, and threshold (|r| - threshold/2) beyond. ``threshold`` is one value for all
    residuals, or one value for each residual.
    """
    size = np.minimum(np.abs(residual), threshold)
    return np.asarray(size * (np.abs(residual) - 0.5 * size))


def huber_weight(residual: Array, threshold: float | Array) -> Array:
    """Return Huber's weight of each residual r, an array of the shape of ``residual``: 1 within the
    threshold, and threshold / |r| beyond.
    """
    return np.asarray(np.minimum(1.0, threshold / np.maximum(np.abs(residual), 1e-300)))


def huber_cost(residual: Array, threshold: float) -> float:
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
    threshold: float,
    tolerance: float,
    most_steps: int = 25,
) -> Minimum:
    """Minimise the Huber cost of ``residuals``.

    Args:
        residuals: Function of x that returns the residuals, shape (n,).
        jacobian: Function of x and of the residuals at x that returns the Jacobian, shape (n, p).
        start: Start values, shape (p,).
        threshold: Residual size up to which the cost is quadratic.
        tolerance: The search ends when a step decreases the cost by less than this share.
        most_steps: Greatest number of steps that are tried.
    """

    def evaluate(x: Array) -> tuple[float, Array]:
        residual = residuals(x)
        return huber_cost(residual, threshold), residual

    def linearise(x: Array, residual: Array) -> tuple[Array, Array]:
        slope = jacobian(x, residual)
        weight = huber_weight(residual, threshold)
        return _normal(slope, weight), _back(slope, weight * residual)

    found, _ = _descend(
        evaluate, linearise, start, lambda gain, cost: gain <= tolerance * (cost + gain), most_steps
    )
    return found


def minimise_deviance(
    predictions: Callable[[Array], tuple[Array, Array]],
    derivatives: Callable[[Array, Array, Array], tuple[Array, Array] | tuple[Slope, Slope]],
    start: Array,
    *,
    threshold: float,
    tolerance: float,
    most_steps: int = 25,
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
        most_steps: Greatest number of steps that are tried.
        reach: Cost that another search reached. The search ends when ``most_steps`` steps, each
            with the decrease of the last step, would not reach this cost.
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
        return cost - reach > most_steps * gain

    found, gain = _descend(
        evaluate,
        linearise,
        start,
        lambda gain, cost: gain <= tolerance or beaten(gain, cost),
        most_steps,
    )
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
    """
    x = start.copy()
    cost, here = evaluate(x)
    damping = _FIRST_DAMPING
    steps, gain = 0, 0.0
    while steps < most_steps:
        normal, gradient = linearise(x, here)
        normal, scale = equilibrated(normal)
        gain = 0.0
        while steps < most_steps and damping < _LAST_DAMPING:
            steps += 1
            step = np.linalg.solve(normal + damping * np.eye(len(x)), -gradient / scale) / scale
            value, there = evaluate(x + step)
            if value < cost:
                gain, x, cost, here = cost - value, x + step, value, there
                damping *= _EASIER
                break
            damping *= _HARDER
        # A cost of NaN is not less than the present cost, so that the gain stays zero.
        if not gain > 0.0 or settled(gain, cost):
            break
    return Minimum(x, cost, steps), gain
