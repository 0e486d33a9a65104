"""Combines prior values of parameters with their estimates from the recordings.

A prior p with standard deviation s is one more row (value - p)/s of the least squares. With the
covariance C of the estimate x, and the likelihood approximated to second order, the joint optimum
is x + C H' (H C H' + S)^-1 (p - H x), and its covariance is C - C H' (H C H' + S)^-1 H C. The
matrix H selects the parameters with a prior, and the diagonal of S contains the variances of the
priors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.model.parameters import STRIBECK_TERMS
from identification.numerics.spread import Spread
from identification.result import Prior

CONTRADICTS = 2.6
"""Difference between the prior and the estimate from the recordings, in standard deviations, above
which a warning is given; by chance one difference in a hundred is greater.
"""
_UNKNOWN = 1e8
"""Standard deviation that is assumed for a parameter that the recordings do not determine, relative
to the standard deviation of the prior.
"""


def with_priors(
    values: Mapping[str, float], spread: Spread, known: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], Spread, tuple[Prior, ...], tuple[str, ...]]:
    """Return values and covariance after combination with the priors, the effect of each prior, and
    warnings.

    Args:
        values: Estimates without priors, by name.
        spread: Covariance of the estimates.
        known: Prior value and standard deviation of each parameter with a prior, by name.
    """
    names = [n for n in known if n in spread.names]
    warnings = [
        f"the prior of {name} has no effect: the fit found no friction of this kind"
        for name in known
        if name not in names
    ]
    if not names:
        return dict(values), spread, (), tuple(warnings)
    at = [spread.names.index(n) for n in names]
    wanted, deviations = np.array([known[n] for n in names]).T
    covariance = _finite(spread.covariance, dict(zip(at, deviations, strict=True)))
    before = np.array([values[n] for n in spread.names])
    sum_ = covariance[np.ix_(at, at)] + np.diag(deviations**2)
    gain = np.linalg.solve(sum_, covariance[at]).T
    after = before + gain @ (wanted - before[at])
    # This form of the covariance keeps its precision if only a prior determines a parameter.
    rest = np.eye(len(before))
    rest[:, at] -= gain
    left = rest @ covariance @ rest.T + gain @ np.diag(deviations**2) @ gain.T
    found, clipped = _within(
        {**values, **dict(zip(spread.names, map(float, after), strict=True))}, spread.names
    )
    warnings += clipped
    used = []
    for k, n in zip(at, names, strict=True):
        value, deviation = known[n]
        alone = math.sqrt(covariance[k, k])
        apart = abs(value - values[n]) / math.hypot(alone, deviation)
        if apart > CONTRADICTS:
            warnings.append(
                f"the prior of {n}, {value:.4g} +- {deviation:.2g}, and the recordings, "
                f"{values[n]:.4g} +- {alone:.2g}, are {apart:.1f} standard deviations apart: the "
                "prior or the estimate from the recordings is wrong, and the stated value is "
                "between the two"
            )
        used.append(Prior(n, value, deviation, values[n], alone, found[n], math.sqrt(left[k, k])))
    # An infinite or undefined variance is kept if the parameter has no prior.
    kept = np.where(np.isfinite(spread.covariance), left, spread.covariance)
    kept[np.ix_(at, at)] = left[np.ix_(at, at)]
    return found, replace(spread, covariance=kept), tuple(used), tuple(warnings)


def _finite(covariance: np.ndarray, deviations: Mapping[int, float]) -> np.ndarray:
    """Return the covariance with a large variance of parameters that the recordings do not
    determine, and without correlation of these parameters with others.
    """
    made = np.array(covariance, dtype=np.float64)
    for k in np.flatnonzero(~np.isfinite(np.diag(covariance))):
        made[k, :] = made[:, k] = 0.0
        made[k, k] = (_UNKNOWN * deviations.get(int(k), 1.0)) ** 2
    return made


def _within(values: dict[str, float], names: Sequence[str]) -> tuple[dict[str, float], list[str]]:
    """Return the values, each moved to its limit if a prior led beyond the limit, and warnings
    about these values.
    """
    found = {n: max(v, 0.0) if n in names and n != "offset" else v for n, v in values.items()}
    for coulomb, static, _ in STRIBECK_TERMS:
        if static in names and found[static] < found.get(coulomb, 0.0):
            found[static] = found[coulomb]
    beyond = [n for n in names if found[n] != values[n]]
    words = (
        "{} is set to the limit of its range, because the combination with the priors is beyond "
        "this limit: the priors contradict the recordings"
    )
    return found, [words.format(n) for n in beyond]
