"""Variance inflation (M13): reduces the weight of segments with implausibly much information.

If a joint almost stops, noise is amplified on the falling branch of friction, and the filter,
linearised about its prediction, is overconfident. The segments of a recording are similar motions;
therefore a segment with far more information than the others is taken to contain an instant at
which the joint almost stopped (bounded influence: Hampel et al., Robust Statistics, 1986, ch. 6).

The median information of the segments is weighted by their number of samples, because at speeds
where friction falls steeply a recording may have more short slips than half cycles.
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
    """Return the factor on the standard deviations of each segment's residuals, shape (m,); for
    most segments the factor is 1.

    Args:
        segments: Information of each segment on the parameters, breakaway times eliminated, shape
            (m, p, p).
        lengths: Number of samples of each segment, shape (m,).
        recordings: Number of each segment's recording, shape (m,).
        most: Greatest information of a segment without inflation, relative to the median of the
            segments of its recording.
    """
    information = np.einsum("mkk->mk", segments)
    information = np.where(information > _ROUNDING * np.sum(information, axis=0), information, 0.0)
    out = np.ones(len(information))
    for k in np.unique(recordings):
        here = recordings == k
        out[here] = np.sqrt(np.maximum(_excess(information[here], lengths[here]) / most, 1.0))
    return out


def _excess(information: Array, lengths: NDArray[np.int64]) -> Array:
    """Return the ratio of each segment's information to the information of the median segment, for
    the parameter with the greatest ratio, shape (m,).

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
