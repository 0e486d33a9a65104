"""A Jacobian in which every row knows the parameters and one breakaway time: an arrow, kept as such.

No stretch of motion sees another's breakaway time. As one dense matrix a campaign of 240 000 rows and 300 stretches
takes half a gigabyte, and its normal matrix minutes; kept as parameters and one column of own times it takes neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array


@dataclass(frozen=True)
class Eliminated:
    """Normal equations of least squares without the breakaway times; p parameters, m stretches.

    Attributes:
        matrix: Schur complement of the breakaway times, shape (p, p).
        scores: Each stretch's gradient of half the squares, shape (m, p).
        cross: Of the whole normal matrix, each breakaway time's row in the parameters, shape (m, p).
        pull: Its gradient in each breakaway time, shape (m,).
        held: Its diagonal there; infinite where a stretch says nothing of its own, which then stays, shape (m,).
    """

    matrix: Array
    scores: Array
    cross: Array
    pull: Array
    held: Array

    def times(self, step: Array) -> Array:
        """Return the Newton step of the breakaway times beside a step of the parameters, shape (m,)."""
        return -(self.pull + self.cross @ step) / self.held


@dataclass(frozen=True)
class Arrow:
    """Slopes in p parameters and in the breakaway times of m stretches; as a matrix of shape (r, p + m).

    Attributes:
        parameters: In the parameters, shape (r, p).
        own: In the breakaway time of the row's own stretch, shape (r,).
        owners: The row's stretch, shape (r,).
        stretches: m.
    """

    parameters: Array
    own: Array
    owners: NDArray[np.int64]
    stretches: int

    def product(self, weight: Array | None = None, other: Arrow | None = None) -> Array:
        """Return the transpose of this times ``other``, rows weighted, shape (p + m, p + m); of itself if left out."""
        right = self if other is None else other
        weighted = self if weight is None else self.scaled(weight)
        p = self.parameters.shape[1]
        out = np.zeros((p + self.stretches, p + self.stretches))
        out[:p, :p] = weighted.parameters.T @ right.parameters
        out[p:, :p] = self._by_stretch(weighted.own, right.parameters)
        out[:p, p:] = out[p:, :p].T if other is None else self._by_stretch(right.own, weighted.parameters).T
        at = p + np.arange(self.stretches)
        out[at, at] = np.bincount(self.owners, weighted.own * right.own, self.stretches)
        return out

    def back(self, vector: Array) -> Array:
        """Return the transpose of this times a vector of shape (r,), shape (p + m,)."""
        times = np.bincount(self.owners, self.own * vector, self.stretches)
        return np.concatenate([self.parameters.T @ vector, times])

    def along(self, directions: Array) -> Array:
        """Return this times ``directions``, shape (p + m,) or (p + m, k): the change of every row."""
        p = self.parameters.shape[1]
        own = self.own if directions.ndim == 1 else self.own[:, None]
        return np.asarray(self.parameters @ directions[:p] + own * directions[p:][self.owners])

    def eliminated(self, residual: Array, weight: Array) -> Eliminated:
        """Return the normal equations of weighted residuals of shape (r,) with the breakaway times eliminated.

        They cost one pass over the rows. Those of several recordings add up to those of all of them.
        """
        p = self.parameters.shape[1]
        whole = self.product(weight)
        cross, own = whole[p:, :p], np.diag(whole)[p:]
        pull = np.asarray(np.bincount(self.owners, self.own * weight * residual, self.stretches), dtype=np.float64)
        held = np.where(own > 0.0, own, np.inf)
        share = cross / held[:, None]
        scores = self._by_stretch(weight * residual, self.parameters) - share * pull[:, None]
        return Eliminated(whole[:p, :p] - cross.T @ share, scores, cross, pull, held)

    def told(self) -> Array:
        """Return what each stretch says of the parameters, its breakaway time eliminated, shape (m, p, p)."""
        p = self.parameters.shape[1]
        squares = np.zeros((self.stretches, p, p))
        for k, column in enumerate(self.parameters.T):
            squares[:, k] = self._by_stretch(column, self.parameters)
        cross = self._by_stretch(self.own, self.parameters)
        own = np.bincount(self.owners, self.own**2, self.stretches)
        share = cross / np.where(own > 0.0, own, np.inf)[:, None]
        return squares - cross[:, :, None] * share[:, None, :]

    def scaled(self, weight: Array) -> Arrow:
        """Return this with every row multiplied by its weight."""
        return replace(self, parameters=self.parameters * weight[:, None], own=self.own * weight)

    def mixed(self, share: Array, other: Arrow) -> Arrow:
        """Return the share of every row of this, and of the other's the rest."""
        return replace(
            self,
            parameters=other.parameters + (self.parameters - other.parameters) * share[:, None],
            own=other.own + (self.own - other.own) * share,
        )

    def without(self, column: int) -> Arrow:
        """Return this without one parameter."""
        return replace(self, parameters=np.delete(self.parameters, column, axis=1))

    def dense(self) -> Array:
        """Return the whole matrix."""
        p = self.parameters.shape[1]
        out = np.zeros((len(self.own), p + self.stretches))
        out[:, :p] = self.parameters
        out[np.arange(len(self.own)), p + self.owners] = self.own
        return out

    def _by_stretch(self, own: Array, columns: Array) -> Array:
        """Return the sums of ``own`` times each column over every stretch, shape (m, p)."""
        sums = [np.bincount(self.owners, own * column, self.stretches) for column in columns.T]
        return np.stack(sums, axis=-1) if sums else np.zeros((self.stretches, 0))


def equilibrated(normal: Array) -> tuple[Array, Array]:
    """Return a normal matrix with a diagonal of ones, shape (p, p), and the scale taken out of rows and columns, (p,).

    The parameters' units spread its elements over many decades. A parameter that touches nothing keeps its zero.
    """
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    return normal / np.outer(scale, scale), scale
