"""An effect at trial parameters, with its score on the remaining mismatch."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from identification.diagnosis.rules import RULES
from identification.effects.effect import Shape
from identification.recording import Array

FEW_REGRESSORS = 4
"""Greatest number of regressors for which the statistic is computed from the residual after their
fit.
"""
NO_WEIGHTS = np.zeros((0, 0, 0))


@dataclass(frozen=True)
class Candidate:
    """One effect at one set of nonlinear parameters, with its score on the residual of a stack.

    Attributes:
        name: Name of the effect, or of a generic family.
        shape: Nonlinear parameters of the effect.
        coefficients: Least-squares coefficients, in the units of the term, shape (k,).
        gain: Sum of whitened squares that the effect explains.
        penalty: Expected sum of whitened squares that the effect explains by chance (Takeuchi);
            computed from single rows if the effect is active in too few blocks.
        statistic: Squared score over its variance by blocks after the fit; about chi-square with k
            degrees of freedom if nothing is missing.
        blocks: Score by block, shape (b, k).
        weights: Inner products of the orthonormal regressors by block, shape (b, k, k); empty for
            many regressors.
        share: Power of the effect's contribution over the noise power, in the rows of its
            equations.
    """

    name: str
    shape: Shape
    coefficients: Array
    gain: float
    penalty: float
    statistic: float
    blocks: Array
    weights: Array
    share: float

    @property
    def score(self) -> float:
        """Sum of whitened squares that the effect explains beyond those expected by chance."""
        return self.gain - 2.0 * self.penalty

    @property
    def tested(self) -> bool:
        """Whether the effect is active in enough blocks to be tested by flipping their signs."""
        return not len(self.weights) or active_blocks(self.weights) >= RULES.least_active

    @property
    def surprise(self) -> float:
        """-log of the probability of at least this statistic."""
        return log_surprise(self.statistic, len(self.coefficients))

    @property
    def preference(self) -> float:
        """Preference of the data for the model with the effect over the model without it, in
        standard errors of the gain by blocks; infinite without weights.
        """
        if not len(self.weights):
            return math.inf
        score = np.sum(self.blocks, axis=0)
        gain = 2.0 * self.blocks @ score - np.einsum("j,bjk,k->b", score, self.weights, score)
        spread = float(np.std(gain, ddof=1)) * math.sqrt(len(gain))
        return float(np.sum(gain)) / spread if spread > 0.0 else 0.0


def active_blocks(weights: Array) -> float:
    """Return the number of blocks in which regressors are active, from their inner products by
    block, shape (b, k, k): the inverse participation.
    """
    energy = np.einsum("bkk->b", weights) / weights.shape[1]
    return 1.0 / float(energy @ energy)


def log_surprise(statistic: Array | float, degrees: int) -> float:
    """Return -log of the probability that a chi-square exceeds ``statistic``."""
    with np.errstate(divide="ignore"):
        return -np.log(special.chdtrc(degrees, statistic))  # type: ignore[no-any-return]


def wald_statistic(score: Array, sums: Array) -> float:
    """Return the squared score over its variance by blocks."""
    variance = sums.T @ sums
    return float(score @ np.linalg.lstsq(variance, score, rcond=1e-10)[0])
