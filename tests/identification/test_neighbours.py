"""The loaded stage's search goes on from far from and near to the best end of its starts."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate import searches
from identification.estimate.searches import End, LoadedFit, Solved
from identification.filter.likelihood import Point, Searched
from identification.filter.segments import Noise
from identification.model.parameters import INERTIA, LOAD_RISE, MC, OMEGA_SL, SIZE
from identification.recording import Model

RUGGED = {0.5: 0.0, 0.9: -10.0, 0.97: -40.0, 1.04: -20.0, 1.2: -5.0, 2.1: -15.0}
"""Stribeck speeds at which a search ends, and their deviances."""


def at(speed: float = 1.0, rise: float = 1.0, free: tuple[int, ...] = (OMEGA_SL,)) -> Point:
    """Return a point of an experiment without recordings."""
    vector = np.ones(SIZE)
    vector[OMEGA_SL], vector[LOAD_RISE] = speed, rise
    return Point.of([], vector, free, Model(), Noise(0.1))


def end(speed: float, deviance: float, rise: float = 1.0, unresolved: bool = False) -> End:
    return End(unresolved, deviance, at(speed, rise))


def moved(point: Point, speed: float) -> Searched:
    """Return the end of a search at another Stribeck speed."""
    vector = point.vector.copy()
    vector[OMEGA_SL] = speed
    return Searched(replace(point, vector=vector), 1)


def nearest(speed: float) -> float:
    return min(RUGGED, key=lambda other: abs(other - speed))


@pytest.fixture
def rugged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every search end at the nearest of the rugged ends."""

    def refine(point: Point, _tempering: Sequence[float], _step: float) -> Searched:
        return moved(point, nearest(point.vector[OMEGA_SL]))

    monkeypatch.setattr(searches, "refine", refine)
    monkeypatch.setattr(searches, "_deviance", lambda point: RUGGED[point.vector[OMEGA_SL]])
    monkeypatch.setattr(searches, "_resolved", lambda _point: True)
    monkeypatch.setattr(searches, "_missed", lambda _end: False)


@pytest.mark.usefixtures("rugged")
@pytest.mark.parametrize("speed", [1.04, 2.1, 0.5])
def test_an_end_beside_the_likeliest_is_left(speed: float) -> None:
    best = searches._neighbours(end(speed, RUGGED[speed]), [])
    assert best.point.vector[OMEGA_SL] == 0.97
    assert best.deviance == -40.0


def test_ends_in_other_basins_are_kept_the_likeliest_first() -> None:
    ends = (
        end(1.02, -38.0),  # the same basin
        end(2.0, -10.0),
        end(1.0, -30.0, -0.3),
        end(0.01, -35.0, unresolved=True),
        end(1.01, -29.0, -0.31),
        end(5.0, -5.0),
    )
    found = searches.basins(LoadedFit(at(1.0), 0.0, ends))
    places = [(p.vector[OMEGA_SL], p.vector[LOAD_RISE]) for p in found]
    assert places == [(1.0, 1.0), (1.0, -0.3), (2.0, 1.0)]


def begun_at(inertia: float = 1.0) -> Point:
    point = at()
    point.vector[INERTIA] = inertia
    return point


Solver = Callable[[Point, object], Solved | None]


def recorded(begun: list[float], chi2: Callable[[float], tuple[float, float] | None]) -> Solver:
    """Return a solver that keeps the inertia it begins from, and ends where ``chi2`` says: with
    what chi-square, at which inertia.
    """

    def solved(start: Point, _free: object) -> Solved | None:
        begun.append(float(start.vector[INERTIA]))
        found = chi2(begun[-1])
        return None if found is None else Solved(found[0], begun_at(found[1]))

    return solved


def test_an_inertia_far_from_the_equation_error_s_is_looked_for_last(monkeypatch):
    begun: list[float] = []

    def ended(inertia: float) -> tuple[float, float]:
        return 1.0 if 15.0 < inertia < 60.0 else 40.0, inertia

    monkeypatch.setattr(searches, "_solved_from", recorded(begun, ended))
    monkeypatch.setattr(searches, "breakaway_starts", lambda point, *_: [point] * 2)
    best, _ = searches.solve_unloaded(begun_at(), [MC], [INERTIA])
    assert best.chi2 == 1.0
    assert best.point.vector[INERTIA] == 30.0
    near = [1.0, 0.8, 0.6, 1.25, *([1.0, 0.8, 0.6] * 2), 1.0]
    assert begun == pytest.approx([*near, 3.0, 10.0, 30.0])
    # A known inertia is not looked for.
    begun.clear()
    assert searches.solve_unloaded(begun_at(), [MC], [])[0].chi2 == 40.0
    assert set(begun) == {1.0}


@pytest.mark.parametrize(("likeliest", "far"), [(1.0, []), (30.0, [30.0]), (0.3, [0.3])])
def test_where_physics_is_missing_two_starts_are_followed_by_a_likelier_one_only(
    monkeypatch: pytest.MonkeyPatch, likeliest: float, far: list[float]
) -> None:
    begun: list[float] = []
    monkeypatch.setattr(searches, "_solved_from", recorded(begun, lambda inertia: (40.0, inertia)))
    monkeypatch.setattr(searches, "breakaway_starts", lambda point, *_: [point] * 2)
    monkeypatch.setattr(
        searches, "_deviance", lambda point: abs(np.log(point.vector[INERTIA] / likeliest))
    )
    best, chi2s = searches.solve_unloaded(begun_at(), [MC], [INERTIA], lambda _point: True)
    assert begun == pytest.approx([1.0, 0.8, *far])
    assert (best.chi2, len(chi2s)) == (40.0, len(begun))


def test_ends_with_an_accepted_noise_are_followed_by_all_starts(monkeypatch):
    begun: list[float] = []
    monkeypatch.setattr(searches, "_solved_from", recorded(begun, lambda inertia: (40.0, inertia)))
    monkeypatch.setattr(searches, "breakaway_starts", lambda point, *_: [point] * 2)
    searches.solve_unloaded(begun_at(), [MC], [INERTIA])
    every = list(begun)
    begun.clear()
    searches.solve_unloaded(begun_at(), [MC], [INERTIA], lambda _point: False)
    assert begun == every
    assert len(every) > 10
