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


REPEATABILITY = "repeatability"
_DRAWS = 2000
_STEPS = 12


@dataclass(frozen=True)
class Scatter:
    """A standard deviation with its 90 % interval, in the unit of the values."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Components:
    """Parts of the scatter of grouped values.

    Attributes:
        parts: Standard deviation of :data:`REPEATABILITY` and of each factor that was separated.
        between: Standard deviation of all factors together; None without a factor.
        total: Standard deviation of everything together.
        merged: Factors whose scatter the values cannot separate; another part contains it.
    """

    parts: Mapping[str, Scatter]
    between: Scatter | None
    total: Scatter
    merged: tuple[str, ...]


def variance_components(
    values: Array, factors: Mapping[str, Sequence[str]], rng: np.random.Generator
) -> Components | None:
    """Return the variance components of values in groups, balanced or not; None if the values do
    not determine the scatter within a group.

    The model is the sum of a mean, of one random effect for each factor, and of the scatter of
    repeatability, all normal and independent. The sum of squares that no factor explains gives the
    repeatability. For a factor, the contrasts u of the values that do not depend on the other
    factors have the covariance s A + V, where s is the variance of the factor and V that of the
    rest; s solves u' (s A + V)^-1 u = q, where q is the number of contrasts. If each level of
    another factor belongs to one level of this factor, the other factor stays in V with its
    estimate. The intervals are generalised confidence intervals: in both equations, draws of
    chi-squared replace the degrees of freedom.

    Args:
        values: Values, shape (n,).
        factors: Level of each value, by factor. A factor of one level is left out.
        rng: Orders the draws; the draws themselves are quantiles.
    """
    rows = {name: _indicators(levels) for name, levels in factors.items() if len(set(levels)) > 1}
    # A factor may be nested in a later one of fewer levels; of two equal ones, the first is left.
    order = sorted(rows, key=lambda name: rows[name].shape[1], reverse=True)
    merged: list[str] = []
    while (freedom := _outside(rows, order, len(values)).shape[1]) < 1 and order:
        merged.append(order.pop(0))
    if freedom < 1:
        return None
    rest = _outside(rows, order, len(values)).T @ values
    least = np.finfo(float).tiny + (np.finfo(float).eps * np.max(np.abs(values))) ** 2
    drawn = {REPEATABILITY: max(float(rest @ rest), least) / _chi_squared(freedom, rng)}
    for name in order:
        others = [other for other in order if other != name and other not in merged]
        nested: list[str] = []
        basis, contrasts = _contrasts(rows, name, others, values)
        if not contrasts.size:
            nested = [other for other in others if other in drawn]
            others = [other for other in others if other not in drawn]
            basis, contrasts = _contrasts(rows, name, others, values)
        if not contrasts.size:
            merged.append(name)
            continue
        inner = [(drawn[other], basis.T @ rows[other]) for other in nested]
        drawn[name] = _variance(
            contrasts,
            basis.T @ rows[name],
            drawn[REPEATABILITY],
            inner,
            _chi_squared(contrasts.size, rng),
        )
    between = sum(drawn[name] for name in drawn if name != REPEATABILITY)
    return Components(
        {name: _scatter(variance) for name, variance in drawn.items()},
        _scatter(between) if len(drawn) > 1 else None,
        _scatter(between + drawn[REPEATABILITY]),
        tuple(merged),
    )


def _indicators(levels: Sequence[str]) -> Array:
    """Return the matrix whose columns mark the values of each level."""
    return np.asarray(np.array(levels)[:, None] == np.unique(levels), dtype=np.float64)


def _outside(rows: Mapping[str, Array], names: Sequence[str], count: int) -> Array:
    """Return a basis of what neither the mean nor these factors explain, shape (n, freedom)."""
    explained = np.hstack([np.ones((count, 1)), *(rows[name] for name in names)])
    left, sizes, _ = np.linalg.svd(explained)
    return np.asarray(left[:, np.count_nonzero(sizes > 1e-9 * sizes[0]) :])


def _contrasts(
    rows: Mapping[str, Array], name: str, others: Sequence[str], values: Array
) -> tuple[Array, Array]:
    """Return a basis of what a factor explains beyond others, and the values in it."""
    outside = _outside(rows, others, len(values))
    left, sizes, _ = np.linalg.svd(outside.T @ rows[name], full_matrices=False)
    basis = outside @ left[:, sizes > 1e-9 * math.sqrt(len(values))]
    return basis, np.asarray(basis.T @ values)


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
