"""Computes the covariance of equation-error estimates whose residuals are correlated in time
(M10).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from identification.estimate.equation_error.regression import model_torque
from identification.numerics.spread import Spread, correlation_samples
from identification.prepare import Prepared

BLOCK_CORRELATION_TIMES = 10.0
"""Ratio of the block length to the correlation time of the residual."""
LEAST_BLOCKS = 8


def block_sandwich(
    prepared: Sequence[Prepared], values: Mapping[str, float], names: Sequence[str], alpha: float
) -> Spread:
    """Return the sandwich covariance of the parameters ``names`` at ``values`` from all recordings
    jointly, clustered by blocks of time (M10).

    A block is ten correlation times of the residual long, or shorter so that there are at least
    eight blocks, and lies in one recording. The covariance therefore includes model errors that
    differ between blocks (Liang and Zeger, Biometrika 73 (1986) 13).
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
            columns.append(
                (model_torque(p, {**values, name: values[name] + step}, alpha) - here)[used] / step
            )
        length = max(1, round(BLOCK_CORRELATION_TIMES * correlation_samples(residual)))
        length = max(1, min(length, total // LEAST_BLOCKS))
        count = max(1, round(len(residual) / length))
        owners.append(
            blocks
            + np.minimum(np.arange(len(residual)) * count // max(len(residual), 1), count - 1)
        )
        blocks += count
        jacobians.append(np.column_stack(columns))
        residuals.append(residual)
    jacobian, residual, owner = (
        np.concatenate(jacobians),
        np.concatenate(residuals),
        np.concatenate(owners),
    )
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
