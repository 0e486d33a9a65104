"""Covariance of named estimates with 90 % intervals; variance components of grouped values;
correlation time of a series of residuals.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from identification.numerics.arrays import Array, plain

CONFIDENCE = 0.90


@dataclass(frozen=True)
class Spread:
    """Covariance of named parameters.

    The half width of the 90 % interval of a parameter is the quantile of Student's t with
    ``freedom`` degrees times the root of its variance.

    >>> spread = Spread(("a", "b"), np.array([[4.0, 1.0], [1.0, 1.0]]), math.inf)
    >>> spread.correlation[0, 1], round(spread.half_width("a"), 3)
    (np.float64(0.5), 3.29)

    Attributes:
        names: Names of the parameters.
        matrix: Covariance in this order, shape (p, p), in the units of the parameters.
        freedom: Degrees of freedom of the estimated covariance; infinite if it counts as known.
    """

    names: tuple[str, ...]
    matrix: Array
    freedom: float

    @property
    def correlation(self) -> Array:
        """Correlation of the parameters, shape (p, p)."""
        deviation = np.sqrt(np.diag(self.matrix))
        return np.asarray(self.matrix / np.outer(deviation, deviation))

    def only(self, names: Collection[str]) -> Spread:
        """Return the covariance of those of its parameters that are among ``names``."""
        kept = [k for k, name in enumerate(self.names) if name in names]
        left = tuple(self.names[k] for k in kept)
        return replace(self, names=left, matrix=self.matrix[np.ix_(kept, kept)])

    def to_dict(self) -> dict[str, Any]:
        """Return names, matrix and degrees of freedom, None if infinite, as values for JSON."""
        return plain(self)  # type: ignore[no-any-return]

    def half_width(self, name: str) -> float:
        """Return the half width of a parameter's 90 % interval; infinite if not determined."""
        k = self.names.index(name)
        return self._half(float(self.matrix[k, k]))

    def half_width_above(self, name: str, base: str) -> float:
        """Return the half width of the 90 % interval of the difference ``name`` - ``base``; a
        ``base`` that was not fitted counts as exact.
        """
        if base not in self.names:
            return self.half_width(name)
        j, k = self.names.index(base), self.names.index(name)
        c = self.matrix
        return self._half(float(c[k, k] + c[j, j] - 2.0 * c[j, k]))

    def half_width_along(self, weights: Mapping[str, float]) -> float:
        """Return the half width of the 90 % interval of a weighted sum of parameters."""
        row = np.array([weights.get(name, 0.0) for name in self.names])
        return self._half(float(row @ self.matrix @ row))

    def _half(self, variance: float) -> float:
        if not math.isfinite(variance) or variance < 0.0:
            return math.inf
        return quantile(self.freedom) * math.sqrt(variance)


NO_SPREAD = Spread((), np.zeros((0, 0)), math.inf)
"""Covariance of nothing: no parameter was fitted, or the method has no covariance."""


def quantile(freedom: float) -> float:
    """Return the half width of the central 90 % of Student's t of unit scale."""
    level = 0.5 + 0.5 * CONFIDENCE
    return float(special.ndtri(level) if freedom == math.inf else special.stdtrit(freedom, level))


_DRAWS = 2000
_STEPS = 12


@dataclass(frozen=True)
class Scatter:
    """A standard deviation with its 90 % interval, in the unit of the values."""

    value: float
    low: float
    high: float


def variance_components(
    values: Array, factors: Mapping[str, Sequence[str]], rng: np.random.Generator
) -> tuple[dict[str, Scatter], tuple[str, ...]]:
    """Return the parts of the scatter of values in groups, balanced or not, and the factors that
    the values do not separate, whose scatter is in another part.

    The parts are ``repeatability`` (within a group), each factor, ``reproducibility`` (the sum of
    several factors) and ``total`` (the sum of several parts); none if no value is left to determine
    the repeatability. The model is the sum of a mean, one random effect for each factor, and the
    repeatability, all normal and independent. What no factor explains gives the repeatability. For
    a factor, let u be the q contrasts of the values that do not depend on the other factors, with
    covariance s A + V, where s is the variance of the factor; s solves u' (s A + V)^-1 u = q. If
    the levels of another factor are nested in those of this factor, the other factor is in V with
    its estimate. The intervals are generalised confidence intervals: draws of chi-squared replace
    the degrees of freedom.

    Args:
        values: Values, shape (n,).
        factors: Level of each value, by factor. A factor of one level is left out.
        rng: Orders the draws; the draws themselves are quantiles.
    """
    rows = {name: _indicators(levels) for name, levels in factors.items() if len(set(levels)) > 1}
    # Levels can be nested in those of a later factor; of equal factors the first is not separated.
    order = sorted(rows, key=lambda name: rows[name].shape[1], reverse=True)
    merged: list[str] = []
    while not (outside := _outside(rows, order, len(values))).shape[1]:
        if not order:
            return {}, ()
        merged.append(order.pop(0))
    rest = outside.T @ values
    least = np.finfo(float).tiny + (np.finfo(float).eps * np.max(np.abs(values))) ** 2
    repeatability = max(float(rest @ rest), least) / _chi_squared(len(rest), rng)
    drawn: dict[str, Array] = {}
    for name in order:
        others = [other for other in order if other != name and other not in merged]
        nested: list[str] = []
        basis = _contrasts(rows, name, others, len(values))
        if not basis.size:
            nested, others = list(drawn), [other for other in others if other not in drawn]
            basis = _contrasts(rows, name, others, len(values))
        if not basis.size:
            merged.append(name)
            continue
        inner = [(drawn[other], basis.T @ rows[other]) for other in nested]
        wanted = _chi_squared(basis.shape[1], rng)
        drawn[name] = _variance(
            basis.T @ values, basis.T @ rows[name], repeatability, inner, wanted
        )
    parts = {"repeatability": repeatability, **drawn}
    if len(drawn) > 1:
        parts["reproducibility"] = sum(drawn.values(), np.zeros(1))
    if drawn:
        parts["total"] = sum(drawn.values(), repeatability)
    return {name: _scatter(variance) for name, variance in parts.items()}, tuple(merged)


def _indicators(levels: Sequence[str]) -> Array:
    """Return the matrix whose columns mark the values of each level."""
    return np.asarray(np.array(levels)[:, None] == np.unique(levels), dtype=np.float64)


def _outside(rows: Mapping[str, Array], names: Sequence[str], count: int) -> Array:
    """Return a basis of what neither the mean nor these factors explain, shape (n, freedom)."""
    explained = np.hstack([np.ones((count, 1)), *(rows[name] for name in names)])
    left, sizes, _ = np.linalg.svd(explained)
    return np.asarray(left[:, np.count_nonzero(sizes > 1e-9 * sizes[0]) :])


def _contrasts(rows: Mapping[str, Array], name: str, others: Sequence[str], count: int) -> Array:
    """Return a basis of what a factor explains beyond others, shape (n, contrasts)."""
    outside = _outside(rows, others, count)
    left, sizes, _ = np.linalg.svd(outside.T @ rows[name], full_matrices=False)
    return np.asarray(outside @ left[:, sizes > 1e-9 * math.sqrt(count)])


def _chi_squared(freedom: int, rng: np.random.Generator) -> Array:
    """Return the degrees of freedom, which give the estimate, and then the draws."""
    levels = (rng.permutation(_DRAWS) + 0.5) / _DRAWS
    return np.concatenate([[freedom], 2.0 * special.gammaincinv(0.5 * freedom, levels)])


def _variance(
    contrasts: Array,
    effect: Array,
    repeatability: Array,
    nested: Sequence[tuple[Array, Array]],
    wanted: Array,
) -> Array:
    """Return the variance of a factor for each draw: the solution of its equation, or zero."""
    if nested:
        noise = repeatability[:, None, None] * np.eye(len(contrasts))
        for variance, other in nested:
            noise = noise + variance[:, None, None] * (other @ other.T)
        whitened = np.linalg.inv(np.linalg.cholesky(noise))
        shape = whitened @ (effect @ effect.T) @ np.swapaxes(whitened, 1, 2)
        sizes, axes = np.linalg.eigh(shape)
        squares = np.einsum("dji,djk,k->di", axes, whitened, contrasts) ** 2
    else:
        sizes, axes = np.linalg.eigh(effect @ effect.T)
        squares = (axes.T @ contrasts) ** 2 / repeatability[:, None]
        sizes = sizes / repeatability[:, None]
    # The reciprocal of the sum is concave: Newton's steps from zero never pass the solution.
    found = np.zeros(len(wanted))
    for _ in range(_STEPS):
        below = sizes * found[:, None] + 1.0
        total = np.sum(squares / below, axis=1)
        slope = np.sum(squares * sizes / below**2, axis=1)
        found = np.maximum(found + total * (total / wanted - 1.0) / slope, 0.0)
    return found


def _scatter(variance: Array) -> Scatter:
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.sqrt(np.percentile(variance[1:], [tail, 100.0 - tail]))
    return Scatter(float(np.sqrt(variance[0])), float(low), float(high))


def correlation_samples(residual: Array) -> float:
    """Return a series' correlation time in samples: 1 + 2 autocorrelation sum to the first zero."""
    centred = residual - np.mean(residual)
    power = float(centred @ centred)
    if power == 0.0 or len(centred) < 4:
        return 1.0
    size = 1 << (2 * len(centred) - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, size)[: len(centred) // 4 + 1] / power
    below = np.flatnonzero(correlation <= 0.0)
    end = int(below[0]) if below.size else len(correlation)
    return float(1.0 + 2.0 * np.sum(correlation[1:end]))
