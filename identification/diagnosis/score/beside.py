"""The share of a mismatch that functions of a coordinate explain beside the nominal parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.diagnosis.fit.stack import Stack
from identification.diagnosis.rules import RULES
from identification.recording import Array

FOLDS = 10
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
        fold: Part of each row, from 0, shape (n,).
    """

    step: int
    other: Array
    residual: Array
    fold: np.ndarray

    def explained(self, columns: Array, factor: Array) -> float:
        """Return the share of the mismatch that regressors predict: coefficients are fitted to all
        parts of the blocks but one, together with the nominal parameters, and predict this part.

        A function that occurs nearly in one part only predicts nothing there.

        Args:
            columns: Regressors at all rows of the equation, shape (m, k).
            factor: Factor of all regressors at each row, shape (m,).
        """
        made = columns[:: self.step] * factor[:: self.step, None]
        lengths = np.linalg.norm(made, axis=0)
        made = made[:, lengths > 0.0] / lengths[lengths > 0.0]
        power = float(self.residual @ self.residual)
        if not made.shape[1] or power == 0.0:
            return 0.0
        rest = made - self.other @ (self.other.T @ made)
        values, vectors = np.linalg.eigh(rest.T @ rest)
        keep = values > RULES.collinear_below
        q = rest @ (vectors[:, keep] / np.sqrt(values[keep]))
        coefficients = q.T @ self.residual
        errors = self.residual - q @ coefficients
        left = 0.0
        for part in range(int(np.max(self.fold)) + 1):
            rows = self.fold == part
            here, error = q[rows], errors[rows]
            leverage, axes = np.linalg.eigh(here.T @ here)
            alone = leverage > ALONE
            change = np.where(
                alone,
                axes.T @ coefficients,
                axes.T @ (here.T @ error) / np.where(alone, 1.0, 1.0 - leverage),
            )
            left += float(np.sum((error + here @ (axes @ change)) ** 2))
        return min(max(0.0, 1.0 - left / power), 1.0)


def mismatch_of(stack: Stack, equation: str) -> Mismatch:
    """Return the mismatch of one equation of a stack, without its nominal tangent and its effect
    basis.
    """
    rows = stack.part(equation)
    number = next(k for k, e in enumerate(stack.equations) if e.name == equation)
    step = max(1, -(-(rows.stop - rows.start) // MOST_ROWS))
    given = np.concatenate([stack.basis[number], stack.effect_basis[rows]], axis=1)[::step]
    q, r = np.linalg.qr(given)
    other = q[:, np.abs(np.diag(r)) > ROUNDING]
    residual = stack.residual[rows][::step]
    return Mismatch(
        step, other, residual - other @ (other.T @ residual), stack.block[rows][::step] % FOLDS
    )
