"""Several units of one machine: which parameters they share, how the others spread, which unit is
odd.

Each unit is identified by itself. Its estimates with their covariance take the place of its
recordings: to first order, generalised least squares of all estimates is one fit of all recordings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import optimize, special

from identification.numerics.arrays import Array, BoolArray
from identification.numerics.spread import CONFIDENCE, Spread, quantile

LEVEL = 0.01
"""Probability with which a fleet without an odd unit has one named, and below which shared
parameters count as different.
"""
LEAST_UNITS = 3  # least number of units with a mean and a spread
LEAST_JUDGED = 5  # least number of units of which one can be odd
_FAR = 3.0
_MIDDLE = float(special.ndtri(0.75))


@dataclass(frozen=True)
class Estimates:
    """What the recordings of one unit determine: values, and their covariance by name."""

    values: Mapping[str, float]
    covariance: Spread

    def part(self, names: Sequence[str]) -> tuple[list[str], Array, Array]:
        """Return those of the names that are known, with values and covariance."""
        known = [n for n in names if n in self.covariance.names and n in self.values]
        at = [self.covariance.names.index(n) for n in known]
        return (
            known,
            np.array([self.values[n] for n in known]),
            self.covariance.matrix[np.ix_(at, at)],
        )


@dataclass(frozen=True)
class Value:
    """A value with its 90 % interval; ``own`` is the unit's estimate without the others, None if
    its recordings do not determine the parameter.
    """

    value: float
    low: float
    high: float
    own: float | None = None


@dataclass(frozen=True)
class Population:
    """Mean and standard deviation of a parameter over the units, with 90 % intervals."""

    mean: Value
    spread: Value  # the standard deviation between units, beyond the uncertainty of the estimates
    units: int  # number of units whose recordings determine the parameter
    error: float  # standard deviation of the mean


@dataclass(frozen=True)
class Odd:
    """A parameter of a unit that differs from the other units."""

    unit: str
    parameter: str
    ratio: float  # difference from the mean of the others over its standard deviation
    p_value: float  # probability of one such unit in a fleet without an odd unit


@dataclass(frozen=True)
class Fleet:
    """Result for all units."""

    shared: Mapping[str, Value]  # parameters that are the same in all units
    # Probability of the differences between the units' estimates of these parameters, if they are
    # the same; None if nothing is shared.
    shared_p_value: float | None
    populations: Mapping[str, Population]  # parameters that differ between units
    # Unit to its parameters. A unit that is not odd borrows from the others what its own recordings
    # do not determine well.
    units: Mapping[str, Mapping[str, Value]]
    # What is odd, the least probable first; these units are left out of the others' values.
    odd: tuple[Odd, ...] = field(default=())


def fleet(units: Mapping[str, Estimates], shared: Sequence[str] = ()) -> Fleet:
    """Return what the estimates of several units say together.

    Args:
        units: Unit to its estimates.
        shared: Parameters that are the same in all units.
    """
    odd = odd_units(units)
    apart = {o.unit for o in odd}
    sound = {name: unit for name, unit in units.items() if name not in apart}
    common, spread, p_value = _shared(sound, shared)
    given = {n: _given(u, common, spread) if n in sound else u for n, u in units.items()}
    names = list(dict.fromkeys(n for u in units.values() for n in u.values if n not in common))
    populations = {}
    for name in names:
        parts = [u.part([name])[1:] for n, u in given.items() if n in sound]
        known = [(float(y[0]), float(c[0, 0])) for y, c in parts if len(y)]
        if len(known) >= LEAST_UNITS:
            populations[name] = population(*np.array(known).T)
    deviation = np.sqrt(np.diag(spread))
    return Fleet(
        {
            n: _value(v, d, quantile(math.inf))
            for (n, v), d in zip(common.items(), deviation, strict=True)
        },
        p_value,
        populations,
        {n: _unit(units[n], u, populations if n in sound else {}) for n, u in given.items()},
        odd,
    )


def population(values: Array, variances: Array) -> Population:
    """Return mean and spread of the values of k units with known variances, shapes (k,).

    The spread is that of Paule and Mandel, its interval that of the profile of Q, and the interval
    of the mean that of Hartung and Knapp.
    """
    freedom = len(values) - 1
    tail = 0.5 - 0.5 * CONFIDENCE
    between = _between(values, variances, freedom)
    ends = [
        _between(values, variances, float(special.chdtri(freedom, p))) for p in (tail, 1.0 - tail)
    ]
    q, mean, weight = _q(values, variances, between)
    error = math.sqrt(max(q / freedom, 1.0) / weight)
    spread, low, high = (math.sqrt(v) for v in (between, *ends))
    return Population(
        _value(mean, error, quantile(freedom)), Value(spread, low, high), len(values), error
    )


def odd_units(units: Mapping[str, Estimates], level: float = LEVEL) -> tuple[Odd, ...]:
    """Return the parameters of units that differ from the others, the least probable first.

    Each estimate is compared with mean and spread of the other units that are not odd, by Student's
    t; p-values are corrected for the number of comparisons (Holm). Which units are not odd is found
    from the median and the median deviation outwards.
    """
    tests: list[Odd] = []
    names = dict.fromkeys(n for u in units.values() for n in u.values)
    known = {n: [k for k, u in units.items() if u.part([n])[0]] for n in names}
    judged = {n: own for n, own in known.items() if len(own) >= LEAST_JUDGED}
    count = sum(map(len, judged.values()))
    for name, own in judged.items():
        parts = [units[k].part([name])[1:] for k in own]
        values, variances = np.array([(y[0], c[0, 0]) for y, c in parts]).T
        ratio, p = _apart(values, variances, level / count)
        tests += [
            Odd(*row)
            for row in zip(own, [name] * len(own), map(float, ratio), map(float, p), strict=True)
        ]
    found, least = [], 0.0
    for k, test in enumerate(sorted(tests, key=lambda o: o.p_value)):
        least = max(least, test.p_value * (count - k))
        if least >= level:
            break
        found.append(Odd(test.unit, test.parameter, test.ratio, least))
    return tuple(found)


def beside(value: float, variance: float, others: Population) -> float:
    """Return the probability that a value is as far from those of a population by chance."""
    scale = math.sqrt(variance + others.spread.value**2 + others.error**2)
    return _two_sided(abs(value - others.mean.value) / scale, others.units - 1)


def _two_sided(ratio: float, freedom: float) -> float:
    return float(2.0 * special.stdtr(freedom, -ratio))


def _apart(values: Array, variances: Array, level: float) -> tuple[Array, Array]:
    """Return ratio and p-value of each value against the others that are not odd, shapes (k,)."""
    sound = _near(values, variances)
    for _ in range(len(values)):
        found = [_against(values, variances, sound, k) for k in range(len(values))]
        ratio, p = np.array(found).T
        again = p >= level
        if np.sum(again) < LEAST_UNITS or np.array_equal(again, sound):
            break
        sound = again
    return ratio, p


def _near(values: Array, variances: Array) -> BoolArray:
    """Return which values are near the median, in units of the median deviation."""
    off = np.abs(values - np.median(values))

    def excess(between: float) -> float:
        return float(np.median(off / np.sqrt(variances + between)) - _MIDDLE)

    between, most = 0.0, float(np.max(off)) ** 2 / _MIDDLE**2
    if excess(0.0) > 0.0 and most > 0.0:
        between = optimize.brentq(excess, 0.0, most)
    ratio = off / np.sqrt(variances + between)
    return np.asarray(ratio <= max(_FAR, float(np.median(ratio))))


def _against(values: Array, variances: Array, sound: BoolArray, k: int) -> tuple[float, float]:
    others = sound.copy()
    others[k] = False
    y, v = values[others], variances[others]
    between = _between(y, v, len(y) - 1)
    _, mean, weight = _q(y, v, between)
    ratio = (values[k] - mean) / math.sqrt(variances[k] + between + 1.0 / weight)
    # The spread is known less well than a variance of as many equal values if others are less sure.
    equal = (variances[k] + between) * weight / len(y)
    return ratio, _two_sided(abs(ratio), (len(y) - 1) * equal**2)


def _q(values: Array, variances: Array, between: float) -> tuple[float, float, float]:
    """Return weighted square sum about the mean, the mean, and the sum of the weights."""
    w = 1.0 / (variances + between)
    total = float(np.sum(w))
    mean = float(w @ values) / total
    return float(w @ (values - mean) ** 2), mean, total


def _between(values: Array, variances: Array, wanted: float) -> float:
    """Return the variance between units at which Q is as wanted; zero if Q is less without any."""

    def excess(between: float) -> float:
        return _q(values, variances, between)[0] - wanted

    if excess(0.0) <= 0.0:
        return 0.0
    most = float(np.sum((values - np.mean(values)) ** 2)) / wanted
    return float(optimize.brentq(excess, 0.0, most, xtol=1e-12 * most, rtol=1e-9))


def _shared(
    units: Mapping[str, Estimates], names: Sequence[str]
) -> tuple[dict[str, float], Array, float | None]:
    """Return the values that all units share, their covariance, and how probable the differences
    are.
    """
    names = [n for n in names if any(u.part([n])[0] for u in units.values())]
    if not names:
        return {}, np.zeros((0, 0)), None
    weight: Array = np.zeros((len(names),) * 2)
    right: Array = np.zeros(len(names))
    parts = []
    for unit in units.values():
        known, values, covariance = unit.part(names)
        at = [names.index(n) for n in known]
        inverse = np.linalg.inv(covariance)
        weight[np.ix_(at, at)] += inverse
        right[at] += inverse @ values
        parts.append((at, values, inverse))
    spread = np.asarray(np.linalg.inv(weight), dtype=np.float64)
    found = spread @ right
    q = sum(float((y - found[at]) @ w @ (y - found[at])) for at, y, w in parts)
    freedom = sum(len(at) for at, _, _ in parts) - len(names)
    if freedom == 0:
        return dict(zip(names, map(float, found), strict=True)), spread, None
    p_value = float(special.chdtrc(freedom, q))
    return dict(zip(names, map(float, found), strict=True)), spread * max(q / freedom, 1.0), p_value


def _given(unit: Estimates, common: Mapping[str, float], spread: Array) -> Estimates:
    """Return the estimates of a unit at the shared values, with the uncertainty of these."""
    shared, values, covariance = unit.part(list(common))
    rest = [n for n in unit.covariance.names if n not in common and n in unit.values]
    both = unit.part([*shared, *rest])
    if not shared:
        return Estimates(
            dict(zip(rest, both[1], strict=True)), Spread(tuple(rest), both[2], math.inf)
        )
    k = len(shared)
    at = [list(common).index(n) for n in shared]
    gain = both[2][k:, :k] @ np.linalg.inv(covariance)
    moved = both[1][k:] + gain @ (np.array([common[n] for n in shared]) - values)
    left = both[2][k:, k:] - gain @ both[2][:k, k:] + gain @ spread[np.ix_(at, at)] @ gain.T
    return Estimates(
        dict(zip(rest, map(float, moved), strict=True)), Spread(tuple(rest), left, math.inf)
    )


def _unit(
    own: Estimates, given: Estimates, populations: Mapping[str, Population]
) -> dict[str, Value]:
    """Return the parameters of a unit: its estimates, drawn to the mean by their uncertainty and
    the spread over the units (empirical Bayes).
    """
    known, values, covariance = given.part(list(populations))
    names = [*known, *(n for n in populations if n not in known)]
    spreads = np.array([populations[n].spread.value ** 2 for n in names])
    means = np.array([populations[n].mean.value for n in names])
    errors = np.array([populations[n].error ** 2 for n in names])
    k = len(known)
    gain = np.diag(spreads)[:, :k] @ np.linalg.inv(covariance + np.diag(spreads[:k]))
    found = means + gain @ (values - means[:k])
    rest = np.eye(len(names))
    rest[:, :k] -= gain
    left = np.diag(rest @ np.diag(spreads)) + np.diag(rest @ np.diag(errors) @ rest.T)
    wide = [quantile(populations[n].units - 1) for n in names]
    drawn = zip(names, found, np.sqrt(np.maximum(left, 0.0)), wide, strict=True)
    out = {n: _value(float(v), float(d), t, own.values.get(n)) for n, v, d, t in drawn}
    alone, values, covariance = given.part([n for n in given.values if n not in out])
    for n, v, d in zip(alone, values, np.sqrt(np.diag(covariance)), strict=True):
        wide_own = quantile(own.covariance.freedom)
        out[n] = _value(float(v), float(d), wide_own, own.values.get(n))
    return out


def _value(value: float, deviation: float, wide: float, own: float | None = None) -> Value:
    return Value(value, value - wide * deviation, value + wide * deviation, own)
