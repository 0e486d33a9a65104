"""Solves least squares with a block-arrow Jacobian: common parameters and one extra unknown for
each block (M12).

The rows are divided into blocks. Each row depends on the parameters, which all blocks have in
common, and on the extra unknown of its block. The Jacobian is therefore stored as the columns of
the parameters and one column of derivatives with respect to the extra unknowns. A dense matrix of
240 000 rows with 300 blocks would take half a gigabyte, and minutes to compute its normal matrix.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from identification.numerics.arrays import Array
from identification.numerics.compiled import compiled


@dataclass(frozen=True)
class Eliminated:
    """Normal equations with the extra unknowns eliminated; p parameters, m blocks.

    Attributes:
        matrix: Schur complement of the extra unknowns in the normal matrix, shape (p, p).
        scores: Gradient of half the sum of squares of each block, shape (m, p).
        cross: Part of the normal matrix with extra unknowns as rows and parameters as columns,
            shape (m, p).
        pull: Gradient with respect to each extra unknown, shape (m,).
        held: Diagonal elements of the extra unknowns, shape (m,); infinite if a block does not
            depend on its extra unknown, so that this unknown keeps its value.
    """

    matrix: Array
    scores: Array
    cross: Array
    pull: Array
    held: Array

    def own_step(self, step: Array) -> Array:
        """Return the step of the extra unknowns for a ``step`` of the parameters, shape (m,)."""
        return -(self.pull + self.cross @ step) / self.held


@dataclass(frozen=True)
class BlockArrow:
    """Jacobian of r rows in p parameters and m extra unknowns; as a dense matrix, shape (r, p + m).

    Attributes:
        parameters: Derivatives with respect to the parameters, shape (r, p).
        own: Derivative of each row with respect to the extra unknown of its block, shape (r,).
        owners: Block of each row, shape (r,).
        blocks: Number of blocks, m.
    """

    parameters: Array
    own: Array
    owners: NDArray[np.int64]
    blocks: int

    def product(self, weight: Array | None = None, other: BlockArrow | None = None) -> Array:
        """Return ``self.T @ diag(weight) @ other``, shape (p + m, p + m); ``other`` defaults to
        self.
        """
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
        """Return ``self @ directions``, the change of every row, for ``directions`` of shape (p +
        m,) or (p + m, k).
        """
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
        """Return each block's information on the parameters, with its extra unknown eliminated
        (M12), shape (m, p, p).
        """
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

    def dense(self) -> Array:
        """Return the dense matrix, shape (r, p + m)."""
        p = self.parameters.shape[1]
        out = np.zeros((len(self.own), p + self.blocks))
        out[:, :p] = self.parameters
        out[np.arange(len(self.own)), p + self.owners] = self.own
        return out

    def by_block(self, factor: Array, columns: Array) -> Array:
        """Return the sum of ``factor`` times each column over the rows of every block, for columns
        of shape (r, k), shape (m, k).
        """
        out = np.zeros((self.blocks, columns.shape[1]))
        _add_by_block(np.ascontiguousarray(columns), factor, self.owners, out)
        return out

    def _products(self, weight: Array | None, other: BlockArrow) -> Array:
        """Return for each block the weighted sum over its rows of the products of two elements of a
        row, with the extra unknown last, shape (m, p + 1, p + 1).
        """
        weight = np.ones(len(self.own)) if weight is None else weight
        size, width = self.parameters.shape[1] + 1, other.parameters.shape[1] + 1
        out = np.zeros((self.blocks, size, width))
        rows = (np.ascontiguousarray(j.parameters) for j in (self, other))
        left, right = rows
        _add_products(left, self.own, right, other.own, weight, self.owners, out)
        return out


@compiled
def _add_by_block(columns: Array, factor: Array, owners: NDArray[np.int64], out: Array) -> None:
    """Add each row of ``columns``, shape (r, k), times the factor of the row, to the row of its
    block in ``out``.
    """
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
    """Add the products of two elements of each row, with the extra unknown last, to the sums of the
    row's block.

    Args:
        left: Shape (r, p).
        left_own: Shape (r,).
        right: Shape (r, q).
        right_own: Shape (r,).
        weight: Weight of each row, shape (r,).
        owners: Block of each row, shape (r,).
        out: Sums, shape (m, p + 1, q + 1).
    """
    p, q = left.shape[1], right.shape[1]
    for r in range(len(left)):
        sums = out[owners[r]]
        for i in range(p + 1):
            scale = weight[r] * (left[r, i] if i < p else left_own[r])
            row = sums[i]
            for j in range(q):
                row[j] += scale * right[r, j]
            row[q] += scale * right_own[r]
