"""The share of a mismatch that functions of a coordinate predict beside the nominal parameters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from identification.diagnosis.fit.stack import Stack
from identification.diagnosis.rules import RULES
from identification.recording import Array

PARTS = 10
"""Number of parts of the blocks, each of which is predicted from the other parts."""
MOST_ROWS = 20_000
"""Number of rows of an equation, of which at most this many are used, at equal distances."""
ALONE = 0.9
"""Leverage of one part from which a function counts as occurring in this part only."""
ROUNDING = 1e-9


@dataclass(frozen=True)
class Mismatch:
    """The mismatch of one equation, with everything else projected out.

    Attributes:
        step: Distance of the rows that are used.
        other: Orthonormal columns of the nominal tangent and of other effects, shape (n, g).
        residual: Whitened mismatch without these columns, shape (n,).
        part: Part of each row, from 0, shape (n,).
        unexplained: Sum of squares of the parts, each predicted by the columns ``other`` that are
            fitted to the other parts.
    """

    step: int
    other: Array
    residual: Array
    part: np.ndarray
    unexplained: float

    def explained(self, resolutions: Iterable[Array], factor: Array) -> float:
        """Return the share of the mismatch that functions predict, at the best resolution.

        Coefficients of the functions and of the columns ``other`` are fitted to all parts of the
        blocks but one, and predict this part. A function that occurs nearly in one part only
        predicts nothing there.

        Args:
            resolutions: Sets of functions at the rows that are used, shape (n, k) each.
            factor: Factor of all functions at these rows, shape (n,).
        """
        return max((self._share(columns * factor[:, None]) for columns in resolutions), default=0.0)

    def _share(self, made: Array) -> float:
        lengths = np.linalg.norm(made, axis=0)
        made = made[:, lengths > 0.0] / lengths[lengths > 0.0]
        if not made.shape[1] or self.unexplained == 0.0:
            return 0.0
        rest = made - self.other @ (self.other.T @ made)
        values, vectors = np.linalg.eigh(rest.T @ rest)
        keep = values > RULES.collinear_below
        q = rest @ (vectors[:, keep] / np.sqrt(values[keep]))
        basis = np.concatenate([self.other, q], axis=1)
        left = unpredicted(basis, self.residual, self.part)
        return min(max(0.0, 1.0 - left / self.unexplained), 1.0)


def mismatch_of(stack: Stack, equation: str) -> Mismatch:
    """Return the mismatch of one equation of a stack, without its nominal tangent and its effect
    basis.
    """
    rows = stack.part(equation)
    number = next(k for k, e in enumerate(stack.equations) if e.name == equation)
    step = max(1, -(-(rows.stop - rows.start) // MOST_ROWS))
    given = np.concatenate([stack.basis[number], stack.effect_basis[rows]], axis=1)[::step]
    vectors, sizes, _ = np.linalg.svd(given, full_matrices=False)
    other = vectors[:, sizes > ROUNDING]
    residual = stack.residual[rows][::step]
    residual = residual - other @ (other.T @ residual)
    part = parts(stack.block[rows][::step])
    return Mismatch(step, other, residual, part, unpredicted(other, residual, part))


def parts(block: np.ndarray) -> np.ndarray:
    """Return the part of each row, from 0, shape (n,).

    Blocks are assigned to parts of equal size in a random order, because recordings may repeat one
    motion after a whole number of blocks.
    """
    blocks, place = np.unique(block, return_inverse=True)
    order = np.random.default_rng(0).permutation(len(blocks))
    return np.asarray((order % min(PARTS, len(blocks)))[place])


def unpredicted(basis: Array, residual: Array, part: np.ndarray) -> float:
    """Return the sum of squares that remains if each part is predicted by orthonormal columns that
    are fitted to the other parts.

    Args:
        basis: Orthonormal columns, shape (n, k).
        residual: What is predicted, shape (n,).
        part: Part of each row, from 0, shape (n,).
    """
    coefficients = basis.T @ residual
    errors = residual - basis @ coefficients
    left = 0.0
    for k in range(int(np.max(part, initial=-1)) + 1):
        rows = part == k
        here, error = basis[rows], errors[rows]
        leverage, axes = np.linalg.eigh(here.T @ here)
        alone = leverage > ALONE
        change = np.where(
            alone,
            axes.T @ coefficients,
            axes.T @ (here.T @ error) / np.where(alone, 1.0, 1.0 - leverage),
        )
        left += float(np.sum((error + here @ (axes @ change)) ** 2))
    return left
