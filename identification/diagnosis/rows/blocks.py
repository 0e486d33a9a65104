"""Divides time into blocks, the same for all equations, within which the mismatch may be
correlated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from identification.diagnosis.rows.equations import Equation
from identification.estimate.equation_error import BLOCK_CORRELATION_TIMES
from identification.numerics.compiled import compiled
from identification.numerics.spread import correlation_samples
from identification.recording import Array

LEAST_BLOCK_S = 1.0
GREATEST_BLOCK_S = 3.0
"""Greatest length of a block, s. The mismatch is correlated over whole half cycles, but with longer
blocks the number of blocks would be too small.
"""


def gather_of(
    equations: Sequence[Equation], block: np.ndarray, blocks: int
) -> tuple[sparse.csr_matrix, ...]:
    """Return for each equation the matrix that sums the rows of each block, shape (blocks, n_e)."""
    out, start = [], 0
    for equation in equations:
        count = len(equation.residual)
        mine = block[start : start + count]
        out.append(
            sparse.csr_matrix((np.ones(count), (mine, np.arange(count))), shape=(blocks, count))
        )
        start += count
    return tuple(out)


@compiled
def in_blocks(
    columns: Array, residual: Array, block: np.ndarray, blocks: int
) -> tuple[Array, Array]:
    """Return for each block the inner products of columns, shape (n, k), with the residual and with
    each other.

    Returns:
        Shapes (b, k) and (b, k, k).
    """
    rows, width = columns.shape
    sums, weights = np.zeros((blocks, width)), np.zeros((blocks, width, width))
    for i in range(rows):
        at = block[i]
        for j in range(width):
            value = columns[i, j]
            sums[at, j] += value * residual[i]
            for k in range(j + 1):
                weights[at, j, k] += value * columns[i, k]
    for at in range(blocks):
        for j in range(width):
            for k in range(j):
                weights[at, k, j] = weights[at, j, k]
    return sums, weights


def numbered(equations: Sequence[Equation], residuals: Sequence[Array]) -> tuple[np.ndarray, int]:
    """Return the block number of each row and the number of blocks. A block has ten correlation
    times of the most correlated residual, within limits, and is the same for all equations.
    """
    length = LEAST_BLOCK_S
    for equation, residual in zip(equations, residuals, strict=True):
        if not equation.judges:
            continue
        for view in equation.views:
            mine = residual[equation.owner == view.index]
            step = view.step * view.low_pass.factor
            if len(mine) > 8:
                length = max(length, BLOCK_CORRELATION_TIMES * correlation_samples(mine) * step)
    views = {v.index: v for e in equations for v in e.views}
    longest = max(float(v.time[-1] - v.time[0]) for v in views.values())
    length = min(length, GREATEST_BLOCK_S, max(LEAST_BLOCK_S, longest / 4.0))
    first: dict[int, int] = {}
    count = 0
    for index in sorted(views):
        first[index] = count
        count += max(1, round(float(views[index].time[-1] - views[index].time[0]) / length))
    parts = []
    for equation in equations:
        for_rows = np.empty(len(equation.residual), dtype=np.int64)
        for view in equation.views:
            mine = equation.owner == view.index
            span = float(view.time[-1] - view.time[0])
            number = max(1, round(span / length))
            place = (equation.time[mine] - view.time[0]) / span * number
            for_rows[mine] = first[view.index] + np.clip(place.astype(np.int64), 0, number - 1)
        parts.append(for_rows)
    return np.concatenate(parts), count
