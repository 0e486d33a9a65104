"""Covariance of named estimates with 90 % intervals; variance components of grouped values;
correlation time of a series of residuals; change of a history of estimates.

The test of a history is against a drift, or one step. For values x_i with standard errors s_i and
weights w_i = 1 / s_i^2, a pattern p_i (a line, or a step before run k) is fitted by weighted least
squares with the amplitude a. The ratio of the amplitude to its standard error is Z = a sqrt(sum w_i
(p_i - p)^2), where p is the weighted mean of the pattern. The residuals r_i have the scatter c^2 =
sum w_i r_i^2 / (n - 2), which is one if the standard errors are right. The two statistics are T =
|Z| / max(c, 1) of the line, and the greatest T of all steps. The stated p value is twice the
smaller of the p values of the two statistics.

The distributions without change are simulated for the same weights and patterns with T = |Z| / c,
which does not depend on the scale of the scatter and is never less than |Z| / max(c, 1). Therefore
the stated false-alarm rate holds if the values scatter as their intervals state, and if the values
scatter more (because of temperature and lubricant). If the values scatter less, the false-alarm
rate is below the stated rate.
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
        """Correlation of the parameters, shape (p, p); zero with a parameter of no variance."""
        deviation = np.sqrt(np.diag(self.matrix))
        scale = np.where(deviation == 0.0, 1.0, deviation)
        found = np.asarray(self.matrix / np.outer(scale, scale))
        np.fill_diagonal(found, 1.0)
        return found

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
        rng: Permutes the quantiles of chi-squared that serve as draws.
    """
    # Columns that mark the rows of each level.
    rows = {
        name: np.asarray(np.array(levels)[:, None] == np.unique(levels), dtype=np.float64)
        for name, levels in factors.items()
        if len(set(levels)) > 1
    }
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


LEAST_RUNS = 6
"""Least number of values for a test; with fewer values, at most four degrees of freedom remain."""
_LEAST_SIDE = 2  # least number of values before and after a step
_MOST_STEPS = 40
"""Greatest number of positions at which a step is sought, spread evenly in a longer history."""
_NULL_DRAWS = 100_000
_FLOOR = 1.0 / 3.0
"""Least standard error over the median one, so that one value does not outweigh all others."""


@dataclass(frozen=True)
class Change:
    """Change that fits a history best."""

    start: int | None  # index of the first value after the step, or None for a drift
    size: float  # size of the step, or change of the drift from the first to the last value
    half_width: float  # half width of the 90 % interval of the size
    p_value: float  # probability that a history without change shows a change of this size or more


class ChangeTest:
    """The test for histories of values with these standard errors.

    Args:
        errors: Standard errors in the order of time, shape (n,), n at least :data:`LEAST_RUNS`,
            above 0.
        rng: Random generator for the simulated distributions of the statistics without change.

    Raises:
        ValueError: There are fewer values, or an error is not positive.
    """

    def __init__(self, errors: Array, rng: np.random.Generator) -> None:
        count = len(errors)
        if count < LEAST_RUNS or not (np.asarray(errors) > 0.0).all():
            raise ValueError(
                f"{count} values; the test needs at least {LEAST_RUNS} values, each with a "
                "standard error above 0"
            )
        errors = np.maximum(errors, _FLOOR * float(np.median(errors)))
        self._starts = step_starts(count)
        patterns = _patterns(count, self._starts)
        self._root = 1.0 / errors
        weights = self._root**2
        centred = patterns - (patterns @ weights / weights.sum())[:, None]
        self._norms = np.sqrt(centred**2 @ weights)
        self._unit = centred * self._root / self._norms[:, None]
        self._mean = self._root / math.sqrt(weights.sum())
        self._null = _null(count, self._unit, self._mean, rng)

    def __call__(self, values: Array) -> Change:
        """Return the drift or step that fits a history best, with its p value.

        Args:
            values: Values in the order of time, shape (n,).
        """
        # The mean does not affect the statistics; it is subtracted so that rounding does not
        # either.
        white = (values - values.mean()) * self._root
        sizes, scatter = _fitted(white[None, :], self._unit, self._mean)
        beyond = np.maximum(scatter[0], 1.0)
        statistic = np.abs(sizes[0]) / beyond
        step = 1 + int(np.argmax(statistic[1:]))
        chances = {
            k: _chance(null, statistic[k]) for k, null in zip((0, step), self._null, strict=True)
        }
        best = min(chances, key=lambda k: (chances[k], -statistic[k]))
        # A scatter beyond the standard errors is estimated from n - 2 degrees of freedom.
        wide = quantile(len(values) - 2.0 if beyond[best] > 1.0 else math.inf)
        return Change(
            None if best == 0 else int(self._starts[best - 1]),
            float(sizes[0, best] / self._norms[best]),
            float(wide * beyond[best] / self._norms[best]),
            min(1.0, 2.0 * chances[best]),
        )


def step_starts(count: int) -> Array:
    """Return the indices before which a step is sought."""
    last = count - _LEAST_SIDE
    places = min(_MOST_STEPS, last - _LEAST_SIDE + 1)
    return np.unique(np.round(np.linspace(_LEAST_SIDE, last, places)).astype(np.int64))


def _patterns(count: int, starts: Array) -> Array:
    """Return a line that rises by one, then all steps of height one; shape (patterns, count)."""
    index = np.arange(count)
    steps = (index[None, :] >= starts[:, None]).astype(np.float64)
    return np.vstack((index / (count - 1.0), steps))


def _fitted(white: Array, unit: Array, mean: Array) -> tuple[Array, Array]:
    """Return amplitudes over errors, and scatters of residuals, (histories, patterns) each."""
    sizes = white @ unit.T
    total = np.sum(white**2, axis=1) - (white @ mean) ** 2
    left = np.maximum(total[:, None] - sizes**2, 1e-300)
    return sizes, np.sqrt(left / (white.shape[1] - 2.0))


def _null(count: int, unit: Array, mean: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the sorted statistics of histories without change: of lines and of steps, (draws,)."""
    lines, steps = [], []
    block = max(1, 2_000_000 // count)
    for done in range(0, _NULL_DRAWS, block):
        draws = rng.standard_normal((min(block, _NULL_DRAWS - done), count))
        sizes, scatter = _fitted(draws, unit, mean)
        statistic = np.abs(sizes) / scatter
        lines.append(statistic[:, 0])
        steps.append(np.max(statistic[:, 1:], axis=1))
    return np.sort(np.concatenate(lines)), np.sort(np.concatenate(steps))


def _chance(null: Array, statistic: float) -> float:
    """Return the share of a sorted null distribution that is at least as great as a statistic."""
    above = len(null) - int(np.searchsorted(null, statistic))
    return (1.0 + above) / (1.0 + len(null))
