"""Describes correlated parameters of an estimate as text.

The text lists each strongly correlated pair of parameters with the combination of the two that the
recordings determine, and the least determined combination of all parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from identification.numerics.arrays import Array
from identification.numerics.spread import Spread
from identification.result import Tradeoff

TRADE_OFF = 0.9
"""Least correlation, as a magnitude, at which two parameters count as a trade-off."""
_SHOWN = 0.3
"""A parameter is listed in a combination if its share is at least this part of the greatest share.
"""

_AT_SPEED = {("Mc", "sigma_2"), ("mu_c", "mu_2")}
"""Pairs (a, b) whose sum a + b omega is the friction at a speed omega well above the Stribeck speed
(eq. 9 and 13).
"""
_AT_LOAD = {("Mc", "mu_c"), ("Ms", "mu_s"), ("sigma_2", "mu_2")}
"""Pairs (a, b) whose sum a + b F_P L1 is the friction under a contact moment F_P L1 (eq. 15)."""


def tradeoffs(
    spread: Spread, values: Mapping[str, float], units: Mapping[str, str]
) -> tuple[Tradeoff, ...]:
    """Return the pairs with a correlation of :data:`TRADE_OFF` or more, the highest correlation
    first.

    Args:
        spread: Covariance of the fitted parameters.
        values: Value of each parameter by name.
        units: Unit of each parameter by name.
    """
    names, correlation = _correlation(spread, values)
    found = []
    for j, first in enumerate(names):
        for k in range(j + 1, len(names)):
            rho = float(correlation[j, k])
            if abs(rho) >= TRADE_OFF:
                second = names[k]
                pinned = _pinned(first, second, spread, values, units)
                words = f"{first} and {second} are correlated (correlation {rho:+.3f}): {pinned}"
                found.append(Tradeoff((first, second), rho, words))
    return tuple(sorted(found, key=lambda pair: -abs(pair.correlation)))


def least_pinned(spread: Spread, values: Mapping[str, float]) -> str:
    """Return a text with the least determined combination of relative changes of the parameters;
    empty if no parameter was fitted.

    The least determined combination is the eigenvector of the relative covariance with the greatest
    eigenvalue.
    """
    names, correlation = _correlation(spread, values)
    if not names:
        return ""
    relative = _relative(spread, values, names)
    shares, vectors = np.linalg.eigh(correlation * np.outer(relative, relative))
    vector = vectors[:, -1] / vectors[np.argmax(np.abs(vectors[:, -1])), -1]
    shown = [(names[k], vector[k]) for k in np.argsort(-np.abs(vector)) if abs(vector[k]) >= _SHOWN]
    changes = [f"{name} by {share:+.2g} %" for name, share in shown]
    where = (
        f"{shown[0][0]} alone" if len(shown) == 1 else "a joint change of " + " and ".join(changes)
    )
    upper = np.triu(np.abs(correlation), 1)
    line = (
        f"least determined is {where}: relative standard deviation "
        f"{100.0 * math.sqrt(max(shares[-1], 0.0)):.2g} %"
    )
    if len(names) > 1:
        j, k = np.unravel_index(int(np.argmax(upper)), upper.shape)
        line += (
            f"; the greatest correlation is {correlation[j, k]:+.2f}, of {names[j]} and {names[k]}"
        )
    return line


def _correlation(spread: Spread, values: Mapping[str, float]) -> tuple[list[str], Array]:
    """Return the names whose variance is finite and above 0, and their correlations."""
    variance = np.diag(spread.covariance)
    kept = [
        k for k, n in enumerate(spread.names) if 0.0 < variance[k] < math.inf and values[n] != 0.0
    ]
    deviation = np.sqrt(variance[kept])
    return [spread.names[k] for k in kept], spread.covariance[np.ix_(kept, kept)] / np.outer(
        deviation, deviation
    )


def _relative(spread: Spread, values: Mapping[str, float], names: list[str]) -> Array:
    variance = dict(zip(spread.names, np.diag(spread.covariance), strict=True))
    return np.array([math.sqrt(variance[n]) / abs(values[n]) for n in names])


def _pinned(
    a: str, b: str, spread: Spread, values: Mapping[str, float], units: Mapping[str, str]
) -> str:
    """Return a text with the combination of two parameters that has the least variance."""
    j, k = spread.names.index(a), spread.names.index(b)
    c = spread.covariance
    weight = -float(c[j, k] / c[k, k])
    if weight > 0.0 and ((a, b) in _AT_SPEED or (a, b) in _AT_LOAD):
        total = values[a] + weight * values[b]
        half = spread.half_width_along({a: 1.0, b: weight})
        unit = "" if units[a] == "1" else f" {units[a]}"
        scale = "rad/s" if units["omega_sf"].endswith("rad/s") else "m/s"
        at = (
            f"{weight:.3g} {scale}"
            if (a, b) in _AT_SPEED
            else f"a contact moment of {weight:.3g} {units['Mc']}"
        )
        return (
            f"only their sum at {at} is determined, {a} + {weight:.3g} {b} = {total:.5g} +- "
            f"{half:.2g}{unit}"
        )
    power = -float(c[j, k] / c[k, k] * values[b] / values[a])
    half = 100.0 * spread.half_width_along({a: 1.0 / values[a], b: power / values[b]})
    kind, shown = (
        ("product", f"{a} {b}^{power:.2g}") if power > 0.0 else ("ratio", f"{a} / {b}^{-power:.2g}")
    )
    return f"only the {kind} {shown} is determined, to {half:.2g} %"
