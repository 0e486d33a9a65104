"""The loaded stage's search goes on from far from and near to the best end of its starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate import searches
from identification.estimate.searches import End, LoadedFit, Solved
from identification.filter.likelihood import Point, Searched
from identification.filter.segments import Noise
from identification.model.parameters import INERTIA, LOAD_RISE, MC, MU_2, OMEGA_SL, SIZE
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


@pytest.mark.usefixtures("rugged")
def test_where_raised_noise_leads_out_of_the_basin_the_start_is_searched_at_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    deviances = {**RUGGED, 0.98: -38.0, 5.0: -12.0}

    def refine(point: Point, tempering: Sequence[float], _step: float) -> Searched:
        speed = point.vector[OMEGA_SL]
        return moved(point, 5.0 if tempering != (1.0,) or speed > 3.0 else nearest(speed))

    monkeypatch.setattr(searches, "refine", refine)
    monkeypatch.setattr(searches, "_deviance", lambda point: deviances[point.vector[OMEGA_SL]])
    found = searches.refine_from(at(), [at(0.98)])
    assert found.point.vector[OMEGA_SL] == 0.97
    assert found.drop == -2.0


@pytest.mark.usefixtures("rugged")
def test_where_no_end_explains_the_recordings_every_start_is_searched_over_wide_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    followed: list[tuple[float, float]] = []

    def refine(point: Point, tempering: Sequence[float], step: float) -> Searched:
        speed = point.vector[OMEGA_SL]
        if len(tempering) > 1:
            followed.append((float(speed), step))
        return moved(point, 0.97 if step == searches._WIDE_STEP and speed == 7.0 else 5.0)

    monkeypatch.setattr(searches, "refine", refine)
    monkeypatch.setattr(searches, "_missed", lambda end: end.deviance > -40.0)
    monkeypatch.setattr(searches, "_deviance", lambda p: RUGGED.get(p.vector[OMEGA_SL], 100.0))
    found = searches.refine_from(at(), [at(speed) for speed in (2.0, 3.0, 4.0, 6.0, 7.0, 8.0)])
    assert found.point.vector[OMEGA_SL] == 0.97
    small = [(speed, searches.PARAMETER_STEP) for speed in (2.0, 3.0, 4.0)]
    assert followed == [
        *small,
        *((speed, searches._WIDE_STEP) for speed in (2.0, 3.0, 4.0, 6.0, 7.0)),
    ]


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


def likely(speed: float, value: float, free: tuple[int, ...] = (OMEGA_SL,)) -> Point:
    """Return a point whose place ``MU_2`` tells the patched deviance."""
    point = at(speed, free=free)
    point.vector[MU_2] = value
    return point


def test_the_joint_fit_begins_in_the_basin_that_is_likeliest_with_all_free(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where it begins is the loaded stage's end itself, so that one which stays the likeliest
    changes nothing.
    """
    held: list[tuple[tuple[int, ...], float]] = []

    def search(point: Point, reach: float) -> Searched:
        held.append((point.free, reach))
        return Searched(replace(point, vector=point.vector + 0.01), 4)

    monkeypatch.setattr(searches, "_likelihood", search)
    monkeypatch.setattr(searches, "_cost", lambda p: -50.0 * round(p.vector[MU_2] - 0.01, 6))
    monkeypatch.setattr(searches, "_resolved", lambda p: p.vector[OMEGA_SL] > 0.5)
    monkeypatch.setattr(searches, "_deviance", lambda p: -100.0 * p.vector[MU_2])
    free = (MC, INERTIA, OMEGA_SL)
    # The last ends where nothing resolves its speed.
    starts = [likely(s, v, free) for s, v in ((2.0, 1.0), (3.0, 1.5), (0.1, 9.0))]
    found = searches.likeliest_together(starts)
    assert found.point is starts[1]
    assert found.iterations == 3 * 4
    # Each search should reach the least cost of those before it.
    assert held == [((MC, OMEGA_SL), reach) for reach in (np.inf, -50.0, -75.0)]


@pytest.mark.parametrize(
    ("speed", "behind", "taken"), [(5.0, 3.0, 1), (5.0, 5.0, 0), (1.5, 3.0, 0)]
)
def test_of_ends_as_likely_one_of_a_far_slower_fall_is_taken(
    monkeypatch: pytest.MonkeyPatch, speed: float, behind: float, taken: int
) -> None:
    monkeypatch.setattr(searches, "_likelihood", lambda point, reach: Searched(point, 1))
    monkeypatch.setattr(searches, "_cost", lambda _point: 0.0)
    monkeypatch.setattr(searches, "_resolved", lambda _point: True)
    monkeypatch.setattr(searches, "_deviance", lambda point: point.vector[MU_2])
    starts = [likely(fall, deviance) for fall, deviance in ((1.0, 0.0), (speed, behind))]
    assert searches.likeliest_together(starts).point is starts[taken]


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


def test_where_no_start_is_solved_the_best_end_is_begun_from_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[float] = []

    def ended(inertia: float) -> tuple[float, float] | None:
        if inertia == 0.8:
            return None
        there = 2.0 if inertia > 1.0 else 0.5 * (inertia + 2.0)
        return abs(there - 2.2) * 30.0, there

    monkeypatch.setattr(searches, "_solved_from", recorded(begun, ended))
    monkeypatch.setattr(searches, "breakaway_starts", lambda *_: [])
    # Nothing is solved: from the best end (6.0 off) again, which is no better, so once and no more.
    best, chi2s = searches.solve_unloaded(begun_at(), [MC], [INERTIA])
    assert best.chi2 == pytest.approx(6.0)
    assert best.point.vector[INERTIA] == 2.0
    assert begun == [1.0, 0.8, 0.6, 1.25, 2.0]
    assert len(chi2s) == 4
    # An inertia that is known is not searched.
    begun.clear()
    searches.solve_unloaded(begun_at(), [MC], [])
    assert begun == [1.0]


def test_an_inertia_far_from_the_equation_error_s_is_looked_for_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
