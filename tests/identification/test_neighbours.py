"""The loaded stage's search goes on from far from and near to the best end of its starts."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.estimate.likelihood import searches, stages
from identification.model.parameters import INERTIA, LOAD_RISE, MC, MU_2, OMEGA_SL, SIZE
from identification.recording import Array

RUGGED = {0.5: 0.0, 0.9: -10.0, 0.97: -40.0, 1.04: -20.0, 1.2: -5.0, 2.1: -15.0}
"""Stribeck speeds at which a search ends, and their deviances."""


@pytest.fixture
def problem(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a problem whose searches end at the nearest of the rugged ends."""

    def refine(p: Any, _tempering: Sequence[float], _step: float) -> Array:
        speed = p.start[OMEGA_SL]
        p.start[OMEGA_SL] = min(RUGGED, key=lambda end: abs(end - speed))
        return np.empty(0)

    monkeypatch.setattr(searches, "refine", refine)
    monkeypatch.setattr(searches, "_deviance", lambda p: RUGGED[p.start[OMEGA_SL]])
    monkeypatch.setattr(searches, "_resolved", lambda _p: True)
    monkeypatch.setattr(searches, "_missed", lambda *_: False)
    return SimpleNamespace(
        free=(OMEGA_SL,), motions=(), start=np.empty(0), breakaway_times=[], search_ends=[]
    )


@pytest.mark.parametrize("speed", [1.04, 2.1, 0.5])
def test_an_end_beside_the_likeliest_is_left(problem: Any, speed: float) -> None:
    vector = np.ones(SIZE)
    vector[OMEGA_SL] = speed
    _, deviance, end, _ = searches._neighbours(problem, (False, RUGGED[speed], vector, []))
    assert end[OMEGA_SL] == 0.97
    assert deviance == -40.0


def test_searches_stop_where_nothing_better_is_found(problem: Any) -> None:
    vector = np.ones(SIZE)
    vector[OMEGA_SL] = 0.97
    _, deviance, _, _ = searches._neighbours(problem, (False, -40.0, vector, []))
    assert deviance == -40.0
    assert len(problem.search_ends) == 2 + 2  # far and near once; the rise is not free


def test_where_raised_noise_leads_out_of_the_basin_the_start_is_searched_at_its_own(
    problem: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    deviances = {**RUGGED, 0.98: -38.0, 5.0: -12.0}

    def refine(p: Any, tempering: Sequence[float], _step: float) -> Array:
        p.start = p.start.copy()
        out = tempering != (1.0,) or p.start[OMEGA_SL] > 3.0
        p.start[OMEGA_SL] = (
            5.0 if out else min(RUGGED, key=lambda end: abs(end - p.start[OMEGA_SL]))
        )
        return np.empty(0)

    monkeypatch.setattr(searches, "refine", refine)
    monkeypatch.setattr(searches, "_deviance", lambda p: deviances[p.start[OMEGA_SL]])
    vector = np.ones(SIZE)
    vector[OMEGA_SL] = 0.98
    grown = searches.refine_from(problem, [(vector, [])])
    assert problem.start[OMEGA_SL] == 0.97
    assert grown == -2.0


def test_where_no_end_explains_the_recordings_every_start_is_searched_over_wide_steps(
    problem: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    followed: list[tuple[float, float]] = []

    def refine(p: Any, tempering: Sequence[float], step: float) -> Array:
        speed = p.start[OMEGA_SL]
        if len(tempering) > 1:
            followed.append((float(speed), step))
        p.start = p.start.copy()
        p.start[OMEGA_SL] = 0.97 if step == searches._WIDE_STEP and speed == 7.0 else 5.0
        return np.empty(0)

    monkeypatch.setattr(searches, "refine", refine)
    monkeypatch.setattr(searches, "_missed", lambda _p, end: end[1] > -40.0)
    monkeypatch.setattr(searches, "_deviance", lambda p: RUGGED.get(p.start[OMEGA_SL], 100.0))
    starts = []
    for speed in (2.0, 3.0, 4.0, 6.0, 7.0, 8.0):
        vector = np.ones(SIZE)
        vector[OMEGA_SL] = speed
        starts.append((vector, []))
    searches.refine_from(problem, starts)
    assert problem.start[OMEGA_SL] == 0.97
    small = [(speed, searches.PARAMETER_STEP) for speed in (2.0, 3.0, 4.0)]
    assert followed == [
        *small,
        *((speed, searches._WIDE_STEP) for speed in (2.0, 3.0, 4.0, 6.0, 7.0)),
    ]


def test_ends_in_other_basins_are_kept_the_likeliest_first(problem: Any) -> None:
    def end(speed: float, rise: float = 1.0) -> Array:
        vector = np.ones(SIZE)
        vector[OMEGA_SL], vector[LOAD_RISE] = speed, rise
        return vector

    problem.start, problem.breakaway_times = end(1.0), []
    problem.search_ends = [
        (False, -38.0, end(1.02), []),  # the same basin
        (False, -10.0, end(2.0), []),
        (False, -30.0, end(1.0, -0.3), []),
        (True, -35.0, end(0.01), []),  # no sample resolves it
        (False, -29.0, end(1.01, -0.31), []),
        (False, -5.0, end(5.0), []),
    ]
    found = [(vector[OMEGA_SL], vector[LOAD_RISE]) for vector, _ in searches.basins(problem)]
    assert found == [(1.0, 1.0), (1.0, -0.3), (2.0, 1.0)]


def test_the_joint_fit_begins_in_the_basin_that_is_likeliest_with_all_free(
    problem: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it begins is the loaded stage's end itself, so that one which stays the likeliest
    changes nothing.
    """
    held: list[tuple[int, ...]] = []

    def refine(p: Any, _tempering: Sequence[float]) -> Array:
        held.append(p.free)
        p.start = p.start + 0.01
        return np.empty(0)

    monkeypatch.setattr(searches, "refine", refine)
    monkeypatch.setattr(searches, "_resolved", lambda p: p.start[OMEGA_SL] > 0.5)
    monkeypatch.setattr(searches, "_deviance", lambda p: -100.0 * p.start[MU_2])
    starts = []
    for speed, likely in (
        (2.0, 1.0),
        (3.0, 1.5),
        (0.1, 9.0),
    ):  # the last ends where nothing resolves its speed
        vector = np.ones(SIZE)
        vector[OMEGA_SL], vector[MU_2] = speed, likely
        starts.append((vector, [np.array([speed])]))
    problem.free = (MC, INERTIA, OMEGA_SL)
    searches.likeliest_together(problem, starts)
    assert problem.start is starts[1][0]
    assert problem.breakaway_times is starts[1][1]
    assert held == [(MC, OMEGA_SL)] * 3
    assert problem.free == (MC, INERTIA, OMEGA_SL)


@pytest.mark.parametrize(
    ("speed", "behind", "taken"), [(5.0, 3.0, 1), (5.0, 5.0, 0), (1.5, 3.0, 0)]
)
def test_of_ends_as_likely_one_of_a_far_slower_fall_is_taken(
    problem: Any, monkeypatch: pytest.MonkeyPatch, speed: float, behind: float, taken: int
) -> None:
    monkeypatch.setattr(searches, "refine", lambda _p, _tempering: np.empty(0))
    monkeypatch.setattr(searches, "_deviance", lambda p: p.start[MU_2])
    starts = []
    for fall, deviance in ((1.0, 0.0), (speed, behind)):
        vector = np.ones(SIZE)
        vector[OMEGA_SL], vector[MU_2] = fall, deviance
        starts.append((vector, [np.array([fall])]))
    searches.likeliest_together(problem, starts)
    assert problem.start is starts[taken][0]


def test_an_end_that_ran_off_is_less_likely_than_any(
    problem: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    problem.run = lambda *_: (np.array([np.nan]), np.ones(1))
    problem.start, problem.noise = np.ones(SIZE), None
    assert searches._deviance(problem) == np.inf


def test_where_no_start_is_solved_the_best_end_is_begun_from_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[tuple[float, float]] = []

    def solved(_p: Any, start: Array, _times: Any, share: float, _noise: Any, _free: Any) -> Any:
        begun.append((float(start[INERTIA]), share))
        if share == 0.8:
            return None
        end = start.copy()
        end[INERTIA] = 2.0 if share > 1.0 else 0.5 * (start[INERTIA] + 2.0)
        return abs(end[INERTIA] - 2.2) * 30.0, end, [], None

    monkeypatch.setattr(stages, "_solved_from", solved)
    monkeypatch.setattr(stages, "breakaway_starts", lambda *_: [])
    problem: Any = SimpleNamespace(free=(), start=np.ones(SIZE), breakaway_times=[], noise=None)
    # Nothing is solved: from the best end (6.0 off) again, which is no better, so once and no more.
    equations_chi2 = stages.solve_unloaded(problem, [MC], [INERTIA])
    assert equations_chi2 == pytest.approx(6.0)
    assert problem.start[INERTIA] == 2.0
    assert begun == [*((1.0, share) for share in (1.0, 0.8, 0.6, 1.25)), (2.0, 1.0)]
    # An inertia that is known is not searched.
    begun.clear()
    problem.start = np.ones(SIZE)
    stages.solve_unloaded(problem, [MC], [])
    assert len(begun) == 1


def test_an_inertia_far_from_the_equation_error_s_is_looked_for_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[float] = []

    def solved(_p: Any, start: Array, _times: Any, share: float, _noise: Any, _free: Any) -> Any:
        begun.append(float(start[INERTIA]) * share)
        return 1.0 if 15.0 < begun[-1] < 60.0 else 40.0, start, [], None

    monkeypatch.setattr(stages, "_solved_from", solved)
    monkeypatch.setattr(stages, "breakaway_starts", lambda p, *_: [(p.start.copy(), [])] * 2)
    problem: Any = SimpleNamespace(free=(), start=np.ones(SIZE), breakaway_times=[], noise=None)
    assert stages.solve_unloaded(problem, [MC], [INERTIA]) == 1.0
    assert problem.start[INERTIA] == 30.0
    near = [1.0, 0.8, 0.6, 1.25, *([1.0, 0.8, 0.6] * 2), 1.0]
    assert begun == pytest.approx([*near, 3.0, 10.0, 30.0])
    # A known inertia is not looked for.
    begun.clear()
    problem.start = np.ones(SIZE)
    assert stages.solve_unloaded(problem, [MC], []) == 40.0
    assert set(begun) == {1.0}
