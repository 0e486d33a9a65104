"""Whether anything is missing from a fit, by its size and by sign flips of whole blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import stats

from identification.diagnosis.generic import families
from identification.diagnosis.joint import Joint
from identification.diagnosis.kept import EXCESS
from identification.diagnosis.stack import Candidate, Stack, surprise
from identification.diagnosis.terms.term import Context, Term
from identification.recording import Array

LEVEL = 0.01
"""Of the test that anything is missing, and that anything more is."""
LEAST_SHARE = 0.01
"""Power of a contribution over that of the noise, in the equations where it shows, below which it
does not matter.
"""
RARE = 6.0
RARE_BLOCKS = 0.01
"""Share of blocks in which a row beyond that may be chance: on simulated benches that hide nothing
there is none.
"""
EXCESS_OF_ONE = 2.0
"""Mean square of the torque's mismatch in one recording over the noise's, up to which nothing is
said of it. What is met in a few strokes of one recording has too few blocks for flips of their
signs.
"""
DRAWS = 999
FLAT = 1e-6
"""Determinant of a variance over its trace's square, below which its inverse is taken with care."""


def screened(stack: Stack, context: Context, terms: Sequence[Term]) -> Iterator[Candidate]:
    """Yield every effect at every trial shape that these recordings can show."""
    for term in terms:
        for shape in term.shapes(context):
            candidate = stack.term(term, shape)
            if candidate is not None:
                yield candidate


def generic(stack: Stack) -> Iterator[Candidate]:
    """Yield the families without a name, in every equation."""
    for equation in stack.equations:
        for name, columns in families(equation):
            candidate = stack.independent(f"{equation.name} over {name}", equation.name, columns)
            if candidate is not None:
                yield candidate


def chance(
    candidates: Sequence[Candidate],
    blocks: int,
    rng: np.random.Generator,
    least: float = LEAST_SHARE,
) -> float:
    """Return the p-value of the most surprising of all candidates that matter, by flipping signs of
    whole blocks.

    The same flips serve all candidates, so that what they share counts once and how many there are
    is allowed for. One that explains less than ``least`` of the noise is no finding however sure:
    it is left out of what is seen, and stays among what might have been.
    """
    if not candidates:
        return 1.0
    flips = rng.choice((-1.0, 1.0), size=(DRAWS, blocks))
    seen = max((c.surprise for c in candidates if c.share > least), default=-np.inf)
    if seen == -np.inf:
        return 1.0
    # A surprise grows with the statistic: of candidates with as many numbers that of the greatest
    # will do.
    greatest: dict[int, Array] = {}
    for candidate in candidates:
        degrees, drawn = candidate.blocks.shape[1], flipped(candidate, flips)
        greatest[degrees] = np.maximum(greatest.get(degrees, drawn), drawn)
    beyond = np.any(
        [surprise(drawn, degrees) >= seen for degrees, drawn in greatest.items()], axis=0
    )
    return float((1 + np.sum(beyond)) / (1 + DRAWS))


def flipped(candidate: Candidate, flips: Array) -> Array:
    """Return the statistic under flips of sign, shape (draws, b), computed as the one that was
    seen, shape (draws,).
    """
    sums, weights = candidate.blocks, candidate.weights
    if not len(weights):
        values, vectors = np.linalg.eigh(sums.T @ sums)
        keep = values > 1e-10 * max(float(values[-1]), 1e-300)
        return np.asarray(
            np.sum((flips @ sums @ (vectors[:, keep] / np.sqrt(values[keep]))) ** 2, axis=1)
        )
    score = flips @ sums
    # V = sum over blocks of (w a - G s)(w a - G s)', multiplied out so that flips meet blocks in
    # one product.
    blocks, degrees = sums.shape
    crossed = np.einsum("bj,bkl->bjkl", sums, weights).reshape(blocks, -1)
    mixed = ((flips @ crossed).reshape(-1, degrees**2, degrees) @ score[:, :, None]).reshape(
        -1, degrees, degrees
    )
    flat = weights.reshape(blocks, -1)
    square = (
        (flat.T @ flat)
        .reshape(degrees, degrees, degrees, degrees)
        .transpose(1, 3, 0, 2)
        .reshape(degrees**2, -1)
    )
    pairs = (score[:, :, None] * score[:, None, :]).reshape(-1, degrees**2)
    variance = (
        sums.T @ sums
        - mixed
        - np.swapaxes(mixed, 1, 2)
        + (pairs @ square).reshape(-1, degrees, degrees)
    )
    if degrees == 1:
        return np.asarray(score[:, 0] ** 2 / np.maximum(variance[:, 0, 0], 1e-300))
    if degrees == 2:
        return _over_two(score, variance)
    return np.asarray(
        np.einsum("dj,djk,dk->d", score, np.linalg.pinv(variance, hermitian=True), score)
    )


def _over_two(score: Array, variance: Array) -> Array:
    """Return scores of two numbers, shape (d, 2), over their variance, (d, 2, 2): most trial shapes
    are waves.
    """
    a, b, c = variance[:, 0, 0], variance[:, 0, 1], variance[:, 1, 1]
    x, y = score.T
    left = a * c - b * b
    flat = left <= FLAT * (a + c) ** 2
    out = (c * x * x - 2.0 * b * x * y + a * y * y) / np.where(flat, 1.0, left)
    for k in np.flatnonzero(flat):
        out[k] = score[k] @ np.linalg.pinv(variance[k], hermitian=True) @ score[k]
    return np.asarray(out)


def excess(joint: Joint, only: str = "") -> float:
    """Return the p-value of the mean square of the mismatch being no more than :data:`EXCESS` times
    the noise's.

    Over all equations, or in the one of the name ``only``.

    It needs no candidate: what looks like nothing in the catalogue, nor like anything smooth, is
    noticed by its size. Rows beyond :data:`RARE` times the noise count as that, so that a few of
    them are not taken for physics; and a row counts as half an observation, as neighbours share the
    filter. Where such rows come in block after block, as they do after every reversal on a joint
    that springs before it slips, it is how many blocks that counts.
    """
    chances = []
    for equation in joint.equations:
        if equation.name == "breakaway" or (only and equation.name != only):
            continue
        rows = joint.stack.part(equation.name)
        powers = np.minimum(np.abs(joint.residual[rows]), RARE) ** 2
        chances.append(_beyond(powers, EXCESS))
        chances.append(_recurring(joint.residual[rows], joint.stack.block[rows]))
        if equation.name == "torque":
            chances += [
                _beyond(powers[equation.owner == v.index], EXCESS_OF_ONE) for v in equation.views
            ]
    return min([1.0, *(len(chances) * chance for chance in chances)])


def _beyond(powers: Array, limit: float) -> float:
    """Return the chance of such a mean square, were the noise's ``limit``; 1 without rows."""
    half = 0.5 * len(powers)
    return float(stats.chi2.sf(half * float(np.mean(powers)) / limit, half)) if len(powers) else 1.0


def _recurring(residual: Array, block: np.ndarray) -> float:
    """Return the chance of so many blocks with a row beyond :data:`RARE`, were one in a hundred to
    have any.

    1 where all of it is no more than :data:`EXCESS` times the noise's power.
    """
    if not len(residual) or float(np.mean(residual**2)) <= EXCESS:
        return 1.0
    found = len(np.unique(block[np.abs(residual) > RARE]))
    return float(stats.binom.sf(found - 1, len(np.unique(block)), RARE_BLOCKS))
