"""Covariance of named estimates with 90 % intervals; correlation time of a series of residuals."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
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
