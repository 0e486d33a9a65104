"""Solves least squares with a block-arrow Jacobian: common parameters and one extra unknown for
each block (M12).

The rows are divided into blocks. Each row depends on the parameters, which all blocks have in
common, and on the extra unknown of its block. The Jacobian is therefore stored as the columns of
the parameters and one column of derivatives with respect to the extra unknowns. As a dense matrix,
240 000 rows with 300 blocks take half a gigabyte, and their normal matrix takes minutes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from identification.numerics.arrays import Array


@dataclass(frozen=True)
class Eliminated:
    """Normal equations with the extra unknowns eliminated; p parameters, m blocks.

    Attributes:
        matrix: Schur complement of the own unknowns, shape (p, p).
        scores: Each block's gradient of half the sum of squares, shape (m, p).
        cross: Block of the normal matrix between own unknowns and parameters, shape (m, p).
        pull: Gradient with respect to each own unknown, shape (m,).
        held: Diagonal elements of the own unknowns, shape (m,); infinite where a block does not
            depend on its own unknown, so that this unknown keeps its value.
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
    """Jacobian in p parameters and m extra unknowns; as a matrix of shape (r, p + m).

    Attributes:
        parameters: Derivatives with respect to the parameters, shape (r, p).
        own: Derivative with respect to the own unknown of the row's block, shape (r,).
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
        right = self if other is None else other
        weighted = self if weight is None else self.scaled(weight)
        p = self.parameters.shape[1]
        out = np.zeros((p + self.blocks, p + self.blocks))
        out[:p, :p] = weighted.parameters.T @ right.parameters
        out[p:, :p] = self._by_block(weighted.own, right.parameters)
        out[:p, p:] = (
            out[p:, :p].T if other is None else self._by_block(right.own, weighted.parameters).T
        )
        at = p + np.arange(self.blocks)
        out[at, at] = np.bincount(self.owners, weighted.own * right.own, self.blocks)
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
        """Return the normal equations of weighted residuals of shape (r,) without the extra
        unknowns.

        Each row is read once. The normal equations of several sets of blocks may be added.
        """
        p = self.parameters.shape[1]
        whole = self.product(weight)
        cross, own = whole[p:, :p], np.diag(whole)[p:]
        pull = np.asarray(
            np.bincount(self.owners, self.own * weight * residual, self.blocks), dtype=np.float64
        )
        held = np.where(own > 0.0, own, np.inf)
        share = cross / held[:, None]
        scores = self._by_block(weight * residual, self.parameters) - share * pull[:, None]
        return Eliminated(whole[:p, :p] - cross.T @ share, scores, cross, pull, held)

    def information_by_block(self) -> Array:
        """Return each block's information on the parameters, with its extra unknown eliminated
        (M12), shape (m, p, p).
        """
        p = self.parameters.shape[1]
        squares = np.zeros((self.blocks, p, p))
        for k, column in enumerate(self.parameters.T):
            squares[:, k] = self._by_block(column, self.parameters)
        cross = self._by_block(self.own, self.parameters)
        own = np.bincount(self.owners, self.own**2, self.blocks)
        share = cross / np.where(own > 0.0, own, np.inf)[:, None]
        return squares - cross[:, :, None] * share[:, None, :]

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

    def _by_block(self, own: Array, columns: Array) -> Array:
        """Return the sum of ``own`` times each column over the rows of every block, shape (m,
        p).
        """
        sums = [np.bincount(self.owners, own * column, self.blocks) for column in columns.T]
        return np.stack(sums, axis=-1) if sums else np.zeros((self.blocks, 0))
