"""Covariance of named estimates with 90 % intervals; correlation time of a series of residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import special

from identification.numerics.arrays import Array

CONFIDENCE = 0.90


@dataclass(frozen=True)
class Spread:
    """Covariance of named parameters, shape (p, p), and the degrees of freedom of the estimated
    covariance.
    """

    names: tuple[str, ...]
    covariance: Array
    freedom: float

    def half_width(self, name: str) -> float:
        """Return the half width of the 90 % interval of a parameter; infinite if the data do not
        determine the parameter.
        """
        k = self.names.index(name)
        return self._half(float(self.covariance[k, k]))

    def half_width_above(self, name: str, base: str) -> float:
        """Return the half width of the 90 % interval of the difference ``name`` - ``base``; a
        ``base`` that was not fitted counts as exact.
        """
        if base not in self.names:
            return self.half_width(name)
        j, k = self.names.index(base), self.names.index(name)
        c = self.covariance
        return self._half(float(c[k, k] + c[j, j] - 2.0 * c[j, k]))

    def half_width_along(self, weights: Mapping[str, float]) -> float:
        """Return the half width of the 90 % interval of a weighted sum of parameters."""
        row = np.array([weights.get(name, 0.0) for name in self.names])
        return self._half(float(row @ self.covariance @ row))

    def _half(self, variance: float) -> float:
        if not math.isfinite(variance) or variance < 0.0:
            return math.inf
        return _quantile(self.freedom) * math.sqrt(variance)


def _quantile(freedom: float) -> float:
    """Return the half width of the central 90 % of Student's t of unit scale."""
    level = 0.5 + 0.5 * CONFIDENCE
    return float(special.ndtri(level) if freedom == math.inf else special.stdtrit(freedom, level))


def correlation_samples(residual: Array) -> float:
    """Return the correlation time of a series in samples: 1 + 2 times the sum of its
    autocorrelation up to the first zero.
    """
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
