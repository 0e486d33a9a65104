"""Covariance of equation-error estimates whose residuals are correlated in time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from identification.estimate.regression import model_torque
from identification.numerics.arrays import Array
from identification.prepare import Prepared

CONFIDENCE = 0.90
BLOCK_CORRELATION_TIMES = 10.0
"""Block length over the residual's correlation time."""
LEAST_BLOCKS = 8


@dataclass(frozen=True)
class Spread:
    """Covariance of named parameters, shape (p, p), and the degrees of freedom behind it."""

    names: tuple[str, ...]
    covariance: Array
    freedom: float

    def half_width(self, name: str) -> float:
        """Return the half width of the 90 % interval; infinite where the data say nothing."""
        k = self.names.index(name)
        return self._half(float(self.covariance[k, k]))

    def half_width_above(self, name: str, base: str) -> float:
        """Return that of ``name`` less ``base``; a ``base`` that was not fitted is known exactly."""
        if base not in self.names:
            return self.half_width(name)
        j, k = self.names.index(base), self.names.index(name)
        c = self.covariance
        return self._half(float(c[k, k] + c[j, j] - 2.0 * c[j, k]))

    def half_width_along(self, weights: Mapping[str, float]) -> float:
        """Return that of a weighted sum of parameters."""
        row = np.array([weights.get(name, 0.0) for name in self.names])
        return self._half(float(row @ self.covariance @ row))

    def _half(self, variance: float) -> float:
        if not math.isfinite(variance) or variance < 0.0:
            return math.inf
        return float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, self.freedom)) * math.sqrt(variance)


def correlation_samples(residual: Array) -> float:
    """Return the correlation time of a series in samples: 1 + 2 sum of its autocorrelation up to the first zero."""
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


def block_sandwich(
    prepared: Sequence[Prepared], values: Mapping[str, float], names: Sequence[str], alpha: float
) -> Spread:
    """Return the covariance of ``names`` at ``values`` from all recordings jointly, clustered by blocks of time.

    Blocks are ten residual correlation times long, at least eight over all, and never span two recordings, so that what
    the model leaves out from stretch to stretch widens the interval (Liang and Zeger, Biometrika 73 (1986) 13).
    """
    if not names:
        return Spread((), np.zeros((0, 0)), math.inf)
    jacobians, residuals, owners = [], [], []
    blocks = 0
    total = sum(int(np.sum(p.used)) for p in prepared)
    for p in prepared:
        used = p.used
        if not np.any(used):
            continue
        here = model_torque(p, values, alpha)
        residual = (p.torque - here)[used]
        columns = []
        for name in names:
            step = 1e-5 * max(abs(values[name]), 1e-9)
            columns.append((model_torque(p, {**values, name: values[name] + step}, alpha) - here)[used] / step)
        length = max(1, round(BLOCK_CORRELATION_TIMES * correlation_samples(residual)))
        length = max(1, min(length, total // LEAST_BLOCKS))
        count = max(1, round(len(residual) / length))
        owners.append(blocks + np.minimum(np.arange(len(residual)) * count // max(len(residual), 1), count - 1))
        blocks += count
        jacobians.append(np.column_stack(columns))
        residuals.append(residual)
    jacobian, residual, owner = np.concatenate(jacobians), np.concatenate(residuals), np.concatenate(owners)
    count = len(names)
    scale = np.linalg.norm(jacobian, axis=0)
    blind = scale == 0.0
    scale[blind] = 1.0
    scaled = jacobian / scale
    bread = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    scores = np.zeros((blocks, count))
    np.add.at(scores, owner, scaled * residual[:, None])
    freedom = max(blocks - count, 3)
    covariance = bread @ (scores.T @ scores) @ bread * blocks / freedom / np.outer(scale, scale)
    covariance[blind, :] = covariance[:, blind] = 0.0
    covariance[blind, blind] = math.inf
    return Spread(tuple(names), covariance, float(freedom))
