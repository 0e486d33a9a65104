"""Several units: coverage of means, spreads and values, odd units, shared parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.fleet import Estimates, Value, fleet, odd_units, population
from identification.numerics.spread import Spread

NAMES = ("J", "Mc", "sigma_2")
MEAN, SPREAD = np.array([0.2, 7.0, 5.0]), np.array([0.0, 0.6, 0.5])
ERROR = np.array([0.01, 0.2, 0.25])
"""Standard deviation of a unit's estimates, about which the units scatter."""


def drawn(
    seed: int, count: int = 20, unsure: float = 1.0
) -> tuple[dict[str, Estimates], dict[str, dict[str, float]]]:
    """Estimates of a fleet with correlated errors, and the truth; the first unit is less sure."""
    rng = np.random.default_rng(seed)
    units, truth = {}, {}
    for k in range(count):
        mixed = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
        scale = np.diag(ERROR * np.exp(0.4 * rng.normal(size=3)) * (unsure if k == 0 else 1.0))
        covariance = scale @ mixed @ mixed.T @ scale
        true = MEAN + SPREAD * rng.normal(size=3)
        found = rng.multivariate_normal(true, covariance)
        spread = Spread(NAMES, covariance, math.inf)
        units[f"u{k}"] = Estimates(dict(zip(NAMES, map(float, found), strict=True)), spread)
        truth[f"u{k}"] = dict(zip(NAMES, map(float, true), strict=True))
    return units, truth


def shifted(unit: Estimates, by: float) -> Estimates:
    return replace(unit, values={**unit.values, "Mc": unit.values["Mc"] + by})


def coverage(seeds: Iterable[int]) -> tuple[dict[str, float], float]:
    """Return shares of intervals that hold the truth, and the mean by which the square error of the
    first unit, which is unsure, falls by what it borrows.
    """
    held: dict[str, list[bool]] = {}
    better = []

    def note(name: str, value: Value, true: float) -> None:
        held.setdefault(name, []).append(value.low <= true <= value.high)

    for seed in seeds:
        units, truth = drawn(seed, unsure=6.0)
        found = fleet(units, ["J"])
        note("shared", found.shared["J"], MEAN[0])
        for name, mean, spread in zip(NAMES[1:], MEAN[1:], SPREAD[1:], strict=True):
            note("mean", found.populations[name].mean, mean)
            note("spread", found.populations[name].spread, spread)
            for unit, own in found.units.items():
                note("unsure" if unit == "u0" else "value", own[name], truth[unit][name])
            unsure, true = found.units["u0"][name], truth["u0"][name]
            assert unsure.own is not None
            better.append((unsure.own - true) ** 2 - (unsure.value - true) ** 2)
    return {name: float(np.mean(inside)) for name, inside in held.items()}, float(np.mean(better))


def alarms(seeds: Iterable[int]) -> tuple[int, int, int]:
    """Return in how many sound fleets a unit is odd; how many of three wrong units are found, and
    in how many of their fleets another is odd too.
    """
    bad, sound, found, others = {"u3", "u8", "u15"}, 0, 0, 0
    for seed in seeds:
        units, _ = drawn(seed)
        moved = {n: shifted(u, 5.2) if n in bad else u for n, u in units.items()}
        odd = {o.unit for o in odd_units(moved)}
        sound += bool(odd_units(units))
        found += len(odd & bad)
        others += bool(odd - bad)
    return sound, found, others


def test_means_spreads_and_values_are_in_their_intervals_as_often_as_stated() -> None:
    shares, better = coverage(range(60))
    assert all(0.83 <= share <= 0.97 for share in shares.values()), shares
    assert better > 0.0


def test_three_wrong_units_are_found_and_sound_fleets_raise_few_alarms() -> None:
    sound, found, others = alarms(range(1000, 1030))
    assert max(sound, others) <= 2
    assert found >= 0.9 * 90


@pytest.mark.proof
def test_a_thousand_fleets() -> None:
    shares, _ = coverage(range(2000, 3000))
    assert all(0.85 <= share <= 0.95 for share in shares.values()), shares
    sound, found, others = alarms(range(3000, 4000))
    print(shares, sound, found, others)
    assert max(sound, others) <= 20, (sound, others)
    assert found >= 0.9 * 3000, found


def test_a_unit_is_odd_since_the_session_from_which_it_stays_so() -> None:
    units, _ = drawn(3)
    steady = replace(units["u1"], sessions={})
    parts = {f"day {k}": shifted(steady, 0.0 if k < 2 else 8.0) for k in range(4)}
    units["u1"] = replace(shifted(steady, 4.0), sessions=parts)
    (odd,) = odd_units(units)
    assert (odd.unit, odd.parameter, odd.since) == ("u1", "Mc", "day 2")


def test_shared_parameters_that_differ_are_said_to_and_widened() -> None:
    units, _ = drawn(5)
    same, other = fleet(units, ["J"]), fleet(units, ["Mc"])
    assert same.shared_p_value is not None
    assert other.shared_p_value is not None
    assert same.shared_p_value > 0.01 > other.shared_p_value
    assert "J" not in {n for own in fleet(units).units.values() for n in own} - {*NAMES}
    assert fleet(units).shared_p_value is None
    # One fit: a unit that shares J knows its own friction at least as well.
    apart, joint = fleet({"u0": units["u0"]}), fleet({n: units[n] for n in ("u0", "u1")}, ["J"])
    width = [f.units["u0"]["Mc"].high - f.units["u0"]["Mc"].low for f in (apart, joint)]
    assert width[1] <= width[0]


def test_generalised_least_squares_of_estimates_is_the_fit_of_all_rows() -> None:
    rng = np.random.default_rng(0)
    rows = [np.column_stack([rng.normal(size=40), np.ones(40)]) for _ in range(2)]
    data = [a @ [2.0, k] + 0.1 * rng.normal(size=40) for k, a in enumerate(rows)]
    units = {}
    for k, (a, y) in enumerate(zip(rows, data, strict=True)):
        covariance = 0.01 * np.linalg.inv(a.T @ a)
        values = np.linalg.lstsq(a, y)[0]
        names = ("slope", "offset")
        given = dict(zip(names, map(float, values), strict=True))
        units[str(k)] = Estimates(given, Spread(names, covariance, math.inf))
    whole = np.zeros((80, 3))
    whole[:40, [0, 1]], whole[40:, [0, 2]] = rows
    expected = np.linalg.lstsq(whole, np.concatenate(data))[0]
    found = fleet(units, ["slope"])
    assert found.shared["slope"].value == pytest.approx(expected[0])
    assert [found.units[k]["offset"].value for k in "01"] == pytest.approx(expected[1:])


def test_a_unit_borrows_what_it_does_not_determine() -> None:
    units, _ = drawn(7)
    poor = units["u0"]
    units["u0"] = Estimates(
        {n: v for n, v in poor.values.items() if n != "Mc"}, poor.covariance.only(["J", "sigma_2"])
    )
    found = fleet(units)
    value, mean = found.units["u0"]["Mc"], found.populations["Mc"].mean
    assert value.own is None
    assert value.value == pytest.approx(mean.value)
    assert value.high - value.low > mean.high - mean.low


def test_a_population_without_a_spread_has_none() -> None:
    found = population(np.array([1.0, 1.0, 1.0]), np.full(3, 0.01))
    assert (found.spread.value, found.spread.low) == (0.0, 0.0)
