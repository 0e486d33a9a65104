"""Several units of one machine: what they share, how they differ, which unit is odd since when.

Each unit is identified by itself. Its estimates with their covariance take the place of its
recordings: to first order, generalised least squares of all estimates is one fit of all recordings.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize, special

from identification.numerics.arrays import Array, BoolArray
from identification.numerics.spread import CONFIDENCE, Spread, quantile

LEVEL = 0.01
"""Probability of an odd unit in a fleet without one, and of differing shared parameters."""
LEAST_UNITS, LEAST_JUDGED = 3, 5
"""Least number of units for a mean and a spread, and least number for the test of odd units."""
_FAR = 3.0  # deviation from the median up to which a unit counts as sound at first
_MIDDLE = float(special.ndtri(0.75))


@dataclass(frozen=True)
class Estimates:
    """What the recordings of a unit determine: values and their covariance; also of each of several
    sessions, by their start in the order of time.
    """

    values: Mapping[str, float]
    covariance: Spread
    sessions: Mapping[str, Estimates] = field(default_factory=dict)

    def part(self, names: Sequence[str]) -> tuple[list[str], Array, Array]:
        """Return those of the names that are known, with values and covariance."""
        known = [n for n in names if n in self.covariance.names and n in self.values]
        at = [self.covariance.names.index(n) for n in known]
        values = np.array([self.values[n] for n in known])
        return known, values, self.covariance.matrix[np.ix_(at, at)]


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
    """Mean and standard deviation of a parameter over the units, the latter beyond the uncertainty
    of the estimates; number of units that determine it; standard deviation of the mean.
    """

    mean: Value
    spread: Value
    units: int
    error: float


@dataclass(frozen=True)
class Odd:
    """A parameter of a unit that differs from the other units: the value, of the unit or of one of
    its sessions, that differs most; its difference from the others' mean over its standard
    deviation; the probability of such a unit in a fleet without an odd unit; and the first session
    from which the parameter stays odd, None if there is none.
    """

    unit: str
    parameter: str
    value: float
    ratio: float
    p_value: float
    since: str | None


@dataclass(frozen=True)
class Fleet:
    """Result for all units; odd units are left out of the values of the others."""

    shared: Mapping[str, Value]  # parameters that are the same in all units
    # Probability of the differences between the units' estimates of these parameters, if they are
    # the same; None if nothing can be compared.
    shared_p_value: float | None
    # Mean and spread of every parameter that enough units determine; the spread of a shared one is
    # that of the units' own estimates.
    populations: Mapping[str, Population]
    # Unit to its parameters. A unit that is not odd borrows from the others what its own recordings
    # do not determine well.
    units: Mapping[str, Mapping[str, Value]]
    odd: tuple[Odd, ...]  # what is odd, the least probable first


def fleet(units: Mapping[str, Estimates], shared: Sequence[str] = ()) -> Fleet:
    """Return what the estimates of several units say together.

    Args:
        units: Unit to its estimates.
        shared: Parameters that are the same in all units.
    """
    odd = odd_units(units)
    sound = {n: u for n, u in units.items() if n not in {o.unit for o in odd}}
    common, spread, p_value = _shared(sound, shared)
    given = {n: _given(u, common, spread) for n, u in sound.items()}
    populations = {}
    for name in dict.fromkeys(n for u in sound.values() for n in u.values):
        parts = [u.part([name])[1:] for u in (sound if name in common else given).values()]
        known = np.array([(y[0], c[0, 0]) for y, c in parts if len(y)])
        if len(known) >= LEAST_UNITS:
            populations[name] = population(*known.T)
    deviations = np.sqrt(np.diag(spread))
    wide = quantile(math.inf)
    same = {n: _value(v, d, wide) for (n, v), d in zip(common.items(), deviations, strict=True)}
    differ = {n: p for n, p in populations.items() if n not in common}
    found = {n: _unit(u, given.get(n, u), differ if n in sound else {}) for n, u in units.items()}
    for name in sound:
        own = units[name].values
        found[name] = {**{n: replace(v, own=own.get(n)) for n, v in same.items()}, **found[name]}
    return Fleet(same, p_value, populations, found, odd)


def population(values: Array, variances: Array) -> Population:
    """Return mean and spread of the values of k units with known variances, shapes (k,).

    The spread is that of Paule and Mandel, its interval that of the profile of Q, and the interval
    of the mean that of Hartung and Knapp.
    """
    freedom = len(values) - 1
    tail = 0.5 - 0.5 * CONFIDENCE
    wanted = (freedom, *(float(special.chdtri(freedom, p)) for p in (tail, 1.0 - tail)))
    spread, low, high = (math.sqrt(_between(values, variances, q)) for q in wanted)
    q, mean, weight = _q(values, variances, spread**2)
    error = math.sqrt(max(q / freedom, 1.0) / weight)
    middle = _value(mean, error, quantile(freedom))
    return Population(middle, Value(spread, low, high), len(values), error)


def odd_units(units: Mapping[str, Estimates], level: float = LEVEL) -> tuple[Odd, ...]:
    """Return the parameters of units that differ from the others, the least probable first.

    Each estimate, also of a session, is compared with mean and spread of the other units that are
    not odd, by Student's t; p-values are corrected for the number of comparisons (Holm). The
    search for the others begins with the units near the median, in median deviations.
    """
    names = dict.fromkeys(n for u in units.values() for n in u.values)
    known = {n: [k for k, u in units.items() if u.part([n])[0]] for n in names}
    judged = {n: own for n, own in known.items() if len(own) >= LEAST_JUDGED}
    count, tests = sum(map(len, judged.values())), []
    for name, own in judged.items():
        trials = [
            {
                start: (float(y[0]), float(c[0, 0]))
                for start, e in {"": units[k], **units[k].sessions}.items()
                for _, y, c in [e.part([name])]
                if len(y)
            }
            for k in own
        ]
        for unit, tried, found in zip(own, trials, _compared(trials, level / count), strict=True):
            most = min(found, key=lambda start: found[start][1])
            later = [(start, p) for start, (_, p) in found.items() if start]
            stays = [s for k, (s, _) in enumerate(later) if all(p < level for _, p in later[k:])]
            since = stays[0] if stays else None
            tests.append(Odd(unit, name, tried[most][0], found[most][0], _least(found), since))
    odd, least = [], 0.0
    for k, test in enumerate(sorted(tests, key=lambda o: o.p_value)):
        least = max(least, test.p_value * (count - k))
        if least >= level:
            break
        odd.append(replace(test, p_value=least))
    return tuple(odd)


Trials = Mapping[str, tuple[float, float]]


def _least(found: Trials) -> float:
    return min(min(p for _, p in found.values()) * len(found), 1.0)


def _compared(trials: Sequence[Trials], level: float) -> list[Trials]:
    """Return ratio and p-value of each value with its variance, by unit and session, against the
    values of the other units that are not odd; the first of each is that of the whole unit.
    """
    values, variances = np.array([t[""] for t in trials]).T
    sound = _near(values, variances)
    for _ in values:
        found: list[Trials] = []
        for k, tried in enumerate(trials):
            others = sound & (np.arange(len(values)) != k)
            y, v = values[others], variances[others]
            found.append({start: _against(*trial, y, v) for start, trial in tried.items()})
        again = np.array([_least(f) >= level for f in found])
        if np.sum(again) < LEAST_UNITS or np.array_equal(again, sound):
            break
        sound = again
    return found


def _near(values: Array, variances: Array) -> BoolArray:
    """Return which values are near the median, in units of the median deviation."""
    off = np.abs(values - np.median(values))

    def excess(between: float) -> float:
        return float(np.median(off / np.sqrt(variances + between)) - _MIDDLE)

    between = _root(excess, float(np.max(off)) ** 2 / _MIDDLE**2)
    ratio = off / np.sqrt(variances + between)
    return np.asarray(ratio <= max(_FAR, float(np.median(ratio))))


def _against(value: float, variance: float, values: Array, variances: Array) -> tuple[float, float]:
    between = _between(values, variances, len(values) - 1)
    _, mean, weight = _q(values, variances, between)
    ratio = (value - mean) / math.sqrt(variance + between + 1.0 / weight)
    # Unequal uncertainties leave the spread fewer degrees of freedom (Satterthwaite).
    equal = (variance + between) * weight / len(values)
    return ratio, float(2.0 * special.stdtr((len(values) - 1) * equal**2, -abs(ratio)))


def _q(values: Array, variances: Array, between: float) -> tuple[float, float, float]:
    """Return weighted square sum about the mean, the mean, and the sum of the weights."""
    w = 1.0 / (variances + between)
    total = float(np.sum(w))
    mean = float(w @ values) / total
    return float(w @ (values - mean) ** 2), mean, total


def _between(values: Array, variances: Array, wanted: float) -> float:
    """Return the variance between units at which Q is as wanted; zero if Q is less without any."""

    most = float(np.sum((values - np.mean(values)) ** 2)) / wanted
    return _root(lambda between: _q(values, variances, between)[0] - wanted, most)


def _root(excess: Callable[[float], float], most: float) -> float:
    """Return where a falling function is zero; zero if it is never positive."""
    return (
        float(optimize.brentq(excess, 0.0, most, xtol=1e-12 * most)) if excess(0.0) > 0.0 else 0.0
    )


def _shared(
    units: Mapping[str, Estimates], names: Sequence[str]
) -> tuple[dict[str, float], Array, float | None]:
    """Return the values that all units share, their covariance, and the differences' p-value."""
    names = [n for n in names if any(u.part([n])[0] for u in units.values())]
    weight, right, parts = np.zeros((len(names),) * 2), np.zeros(len(names)), []
    for unit in units.values():
        known, values, covariance = unit.part(names)
        at, inverse = [names.index(n) for n in known], np.linalg.inv(covariance)
        weight[np.ix_(at, at)] += inverse
        right[at] += inverse @ values
        parts.append((at, values, inverse))
    spread: Array = np.asarray(np.linalg.inv(weight), dtype=np.float64)
    found = spread @ right
    q = sum(float((y - found[at]) @ w @ (y - found[at])) for at, y, w in parts)
    freedom = sum(len(at) for at, _, _ in parts) - len(names)
    p_value = float(special.chdtrc(freedom, q)) if freedom else None
    common = dict(zip(names, map(float, found), strict=True))
    return common, np.asarray(spread * max(q / max(freedom, 1), 1.0)), p_value


def _given(unit: Estimates, common: Mapping[str, float], spread: Array) -> Estimates:
    """Return the estimates of a unit at the shared values, with the uncertainty of these."""
    shared, values, covariance = unit.part(list(common))
    names, every, whole = unit.part([*shared, *(n for n in unit.values if n not in common)])
    k, at = len(shared), [list(common).index(n) for n in shared]
    gain = whole[k:, :k] @ np.linalg.inv(covariance)
    moved = every[k:] + gain @ (np.array([common[n] for n in shared]) - values)
    left = whole[k:, k:] - gain @ whole[:k, k:] + gain @ spread[np.ix_(at, at)] @ gain.T
    freedom = unit.covariance.freedom
    found = dict(zip(names[k:], map(float, moved), strict=True))
    return Estimates(found, Spread(tuple(names[k:]), left, freedom))


def _unit(
    own: Estimates, given: Estimates, populations: Mapping[str, Population]
) -> dict[str, Value]:
    """Return the parameters of a unit: its estimates, drawn to the mean by their uncertainty and
    the spread over the units (empirical Bayes); those without a spread as they are.
    """
    known, values, covariance = given.part(list(populations))
    names, k = [*known, *(n for n in populations if n not in known)], len(known)
    each = [populations[n] for n in names]
    spread = np.diag([p.spread.value**2 for p in each])
    means = np.array([p.mean.value for p in each])
    gain = spread[:, :k] @ np.linalg.inv(covariance + spread[:k, :k])
    rest = np.eye(len(names)) - np.pad(gain, ((0, 0), (0, len(names) - k)))
    left = rest @ spread + rest @ np.diag([p.error**2 for p in each]) @ rest.T
    drawn = zip(
        (*names, *(alone := given.part([n for n in given.values if n not in populations]))[0]),
        (*(means + gain @ (values - means[:k])), *alone[1]),
        (*np.diag(left), *np.diag(alone[2])),
        (*(p.units - 1 for p in each), *[given.covariance.freedom] * len(alone[0])),
        strict=True,
    )
    return {
        n: _value(v, math.sqrt(max(d, 0.0)), quantile(f), own.values.get(n)) for n, v, d, f in drawn
    }


def _value(value: float, deviation: float, wide: float, own: float | None = None) -> Value:
    half = float(wide * deviation)
    return Value(float(value), float(value) - half, float(value) + half, own)
