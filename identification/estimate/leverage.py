"""How far a single stretch may carry an estimate.

Where a shaft all but stops, whether it goes on hangs on the least noise, and the filter, linear about its prediction,
is sure of what nobody can know. The stretches of a recording make much the same motion, so one that says far more than
the others was in such a place, and what it says is not to be believed to that precision (bounded influence: Hampel et
al., Robust Statistics, 1986, ch. 6).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array

_ROUNDING = 1e-12
"""Share of what is known of a parameter below which a stretch is taken to say nothing of it."""


def bounded(stretches: Array, most: float) -> Array:
    """Return the sum of stretches' informations, none believed more than it takes to be ``most`` median ones.

    Args:
        stretches: Of each of one recording, shape (m, p, p).
        most: Median stretches.
    """
    told = np.einsum("mkk->mk", stretches)
    usual = np.median(told, axis=0)
    excess = np.max(told / np.where(usual > 0.0, usual, np.inf), axis=1)
    return np.asarray(np.tensordot(np.minimum(1.0, most / np.maximum(excess, most)), stretches, 1))


def widening(stretches: Array, recordings: NDArray[np.int64], most: float) -> Array:
    """Return how many times wider each deviation is where stretches' informations are so bounded, shape (p,).

    Args:
        stretches: Information of each stretch, breakaway times eliminated, shape (m, p, p).
        recordings: The number of each stretch's recording, shape (m,).
        most: Median stretches of its recording that one is believed as at most.
    """
    whole = np.sum(stretches, axis=0)
    scale = np.sqrt(np.diag(whole))
    scale[scale == 0.0] = 1.0
    alike = stretches / np.outer(scale, scale)
    alike[np.abs(alike) < _ROUNDING] = 0.0
    limited = np.sum([bounded(alike[recordings == k], most) for k in np.unique(recordings)], axis=0)
    before, after = (np.diag(np.linalg.pinv(n, hermitian=True)) for n in (np.sum(alike, axis=0), limited))
    return np.sqrt(np.maximum(after / np.where(before > 0.0, before, np.inf), 1.0))
