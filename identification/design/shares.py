"""Computes the optimal shares of the time among many excitations, which minimise the variance of
one parameter.

The information of an experiment is the sum of that of its excitations, and proportional to time;
therefore the variance of a parameter is convex in the shares of time. The multiplicative algorithm
(Silvey, Titterington and Torsney, Communications in Statistics A 7 (1978) 1379) needs no step
length, and converges to a few excitations with nonzero shares.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.design.intervals import NAMES, Information, weights_of_scores
from identification.numerics.arrays import Array

_ROUNDS, _TURNS = 500, 2
_OTHERS = 0.04
"""Weight of the relative variances of the other parameters in the criterion, relative to the weight
of the target parameter's variance; with this weight no parameter stays undetermined.
"""
_FLOOR = 1e-12


def best_shares(
    rates: Sequence[Information], target: str, loaded: bool, least: Array | None = None
) -> Array:
    """Return each excitation's share of the time, shape (n,); the shares sum to 1.

    Args:
        rates: Information of each excitation per second.
        target: The parameter whose variance is minimised.
        loaded: Whether the four load parameters are unknown as well.
        least: Least share of each excitation, shape (n,), of sum 1 at most, or None for zero.
    """
    count = len(NAMES) if loaded else NAMES.index("mu_c")
    normals = np.array([rate.normal[:count, :count] for rate in rates])
    scale = np.sqrt(np.maximum(np.einsum("ikk->k", normals), 1e-300))
    normals = (normals / np.outer(scale, scale)).reshape(len(rates), -1)
    worth = np.where(np.array(NAMES[:count]) == target, 1.0, _OTHERS) / scale**2
    floor = _FLOOR * np.eye(count)
    least = np.zeros(len(rates)) if least is None else least
    left = 1.0 - float(np.sum(least))
    shares = np.full(len(rates), 1.0 / len(rates))
    for _ in range(_ROUNDS):
        spread = np.linalg.inv(((least + left * shares) @ normals).reshape(count, count) + floor)
        gradient = normals @ ((spread * worth) @ spread).ravel()
        shares = shares * np.sqrt(np.maximum(gradient, 0.0))
        shares /= np.sum(shares)
    return np.asarray(least + left * shares)


def shared(
    informations: Sequence[Information], target: str, loaded: bool, least: Array | None = None
) -> tuple[Array, list[Information]]:
    """Return the optimal shares of excitations, shape (n,), and the effective information of each
    excitation on the target at these shares.

    The effective information depends on the weights of the scores in the estimate of the target
    parameter (:func:`identification.design.intervals.weights_of_scores`), and the weights depend on
    the shares; therefore weights and shares are computed in turn.
    """
    counts = list(informations)
    for _ in range(_TURNS):
        shares = best_shares(counts, target, loaded, least)
        total = [i.times(float(share)) for i, share in zip(counts, shares, strict=True)]
        weights = weights_of_scores(total, target, loaded)
        counts = [i.effective(weights) for i in informations]
    return best_shares(counts, target, loaded, least), counts
