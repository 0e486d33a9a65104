"""How far a single stretch may carry an estimate.

Where a shaft all but stops, whether it goes on hangs on the least noise, and the filter, linear about its prediction,
is sure of what nobody can know. The stretches of a recording make much the same motion, so one that says far more than
the others was in such a place, and what it says is not to be believed to that precision (bounded influence: Hampel et
al., Robust Statistics, 1986, ch. 6).

The median one is that in which the middle of all samples lies: where friction falls steeply a recording may hold more
short slips than strokes, and beside a slip every stroke says far more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from identification.numerics.arrays import Array

_ROUNDING = 1e-12
"""Share of what is known of a parameter below which a stretch is taken to say nothing of it."""


def doubts(stretches: Array, lengths: NDArray[np.int64], recordings: NDArray[np.int64], most: float) -> Array:
    """Return by how much larger than it seems each stretch's noise is taken to be, shape (m,); 1 for most.

    Args:
        stretches: Information of each stretch, breakaway times eliminated, shape (m, p, p).
        lengths: Samples in each, shape (m,).
        recordings: The number of each stretch's recording, shape (m,).
        most: Median stretches of its recording that one is believed as at most.
    """
    told = np.einsum("mkk->mk", stretches)
    told = np.where(told > _ROUNDING * np.sum(told, axis=0), told, 0.0)
    out = np.ones(len(told))
    for k in np.unique(recordings):
        here = recordings == k
        out[here] = np.sqrt(np.maximum(_excess(told[here], lengths[here]) / most, 1.0))
    return out


def _excess(told: Array, lengths: NDArray[np.int64]) -> Array:
    """Return how many median ones each stretch is worth for the parameter of which it says most, (m, p) to (m,)."""
    order = np.argsort(told, axis=0)
    middle = np.argmax(2 * np.cumsum(lengths[order], axis=0) >= np.sum(lengths), axis=0)
    usual = np.take_along_axis(told, np.take_along_axis(order, middle[None], axis=0), axis=0)[0]
    return np.asarray(np.max(told / np.where(usual > 0.0, usual, np.inf), axis=1, initial=0.0))
