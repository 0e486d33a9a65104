"""Variance inflation: gives segments with implausibly much information a lower weight (M13).

Where a joint almost stops, friction's falling branch amplifies noise, and the filter, linearised
about its prediction, is overconfident. The segments of a recording are similar motions, so a
segment with far more information than the others contains such a near stop (bounded influence:
Hampel et al., Robust Statistics, 1986, ch. 6).

The median is weighted by the number of samples, because a recording may have more short slips than
half cycles where friction falls steeply with speed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from identification.numerics.arrays import Array

_ROUNDING = 1e-12
"""Share of the information on a parameter below which a segment counts as having no information."""


def inflation_factors(
    segments: Array, lengths: NDArray[np.int64], recordings: NDArray[np.int64], most: float
) -> Array:
    """Return the factor on the standard deviations of each segment, shape (m,); 1 for most
    segments.

    Args:
        segments: Information of each segment on the parameters, breakaway times eliminated, shape
            (m, p, p).
        lengths: Number of samples of each segment, shape (m,).
        recordings: Number of each segment's recording, shape (m,).
        most: Greatest information of a segment without inflation, relative to the median of its
            recording's segments.
    """
    information = np.einsum("mkk->mk", segments)
    information = np.where(information > _ROUNDING * np.sum(information, axis=0), information, 0.0)
    out = np.ones(len(information))
    for k in np.unique(recordings):
        here = recordings == k
        out[here] = np.sqrt(np.maximum(_excess(information[here], lengths[here]) / most, 1.0))
    return out


def _excess(information: Array, lengths: NDArray[np.int64]) -> Array:
    """Return the ratio of each segment's information to that of the median segment, for the
    parameter where this ratio is greatest, shape (m,).

    Args:
        information: Information of each segment on each parameter, shape (m, p).
        lengths: Number of samples of each segment, shape (m,).
    """
    order = np.argsort(information, axis=0)
    middle = np.argmax(2 * np.cumsum(lengths[order], axis=0) >= np.sum(lengths), axis=0)
    usual = np.take_along_axis(
        information, np.take_along_axis(order, middle[None], axis=0), axis=0
    )[0]
    return np.asarray(
        np.max(information / np.where(usual > 0.0, usual, np.inf), axis=1, initial=0.0)
    )
