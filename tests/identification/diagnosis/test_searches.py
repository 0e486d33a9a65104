"""Which searches follow a search that ends outside the catalogue, and which of them counts."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.diagnosis import diagnose
from identification.diagnosis.held_out import DROPPED
from identification.diagnosis.result import Step, Verdict
from identification.diagnosis.rules import RULES
from identification.effects import EFFECTS, MOTION
from identification.recording import RecordingError

OUTSIDE, NAMED = Verdict.OUTSIDE_CATALOGUE, Verdict.NAMED


def term(name: str) -> Any:
    return SimpleNamespace(name=name)


EVERY = [term(name) for name in "abcd"]


class Scripted:
    """Searches with given verdicts and dropped effects; keeps the effects each was given."""

    def __init__(self, script: Sequence[tuple[Verdict, str]], final: Verdict) -> None:
        self.script, self.final = list(script), final
        self.asked: list[tuple[str, bool]] = []

    def __call__(self, _task: object, terms: Sequence[Any], thorough: bool = False) -> Any:
        names = "".join(t.name for t in terms)
        self.asked.append((names, thorough))
        verdict, dropped = (self.final, "") if thorough else self.script.pop(0)
        steps = [Step(DROPPED, name, 1.0, 0.0, "") for name in dropped]
        found = SimpleNamespace(steps=steps, tag=(names, thorough))
        made = SimpleNamespace(found=found, judged=SimpleNamespace(verdict=verdict))
        made._replace = lambda judged: SimpleNamespace(found=found, verdict=judged)
        return made


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Any:
    def searched(
        script: Sequence[tuple[Verdict, str]], final: Verdict = OUTSIDE, nearly_all: bool = True
    ) -> tuple[Any, list[tuple[str, bool]]]:
        scripted = Scripted(script, final)
        monkeypatch.setattr(diagnose, "_outcome", scripted)
        monkeypatch.setattr(diagnose, "explains_nearly_all", lambda _found: nearly_all)
        monkeypatch.setattr(diagnose, "without_unlogged", lambda judged, _found: judged)
        task: Any = None
        counted: Any = diagnose._searches(task, EVERY)
        return counted.found.tag, scripted.asked

    return searched


@pytest.mark.parametrize("verdict", [NAMED, Verdict.AMBIGUOUS, Verdict.NOTHING_MISSING])
def test_another_verdict_ends_the_searches(run: Any, verdict: Verdict) -> None:
    assert run([(verdict, "a")]) == (("abcd", False), [("abcd", False)])


def test_dropped_effects_take_no_part_in_the_next_search(run: Any) -> None:
    counted, asked = run([(OUTSIDE, "b"), (NAMED, "")])
    assert asked == [("abcd", False), ("acd", False)]
    assert counted == ("acd", False)


def test_the_number_of_further_searches_is_limited(run: Any) -> None:
    drops = [(OUTSIDE, name) for name in "abcd"]
    counted, asked = run(drops[: 1 + RULES.further_searches])
    plain = [names for names, thorough in asked if not thorough]
    assert plain == ["abcd", "bcd", "cd"][: 1 + RULES.further_searches]
    assert counted == ("abcd", False)


def test_without_a_dropped_effect_effects_without_a_score_are_fitted(run: Any) -> None:
    counted, asked = run([(OUTSIDE, "")], final=NAMED)
    assert asked == [("abcd", False), ("abcd", True)]
    assert counted == ("abcd", True)


def test_effects_without_a_score_must_explain_nearly_all(run: Any) -> None:
    assert run([(OUTSIDE, "")], final=NAMED, nearly_all=False)[0] == ("abcd", False)


def test_a_search_that_ends_with_nothing_missing_does_not_count_after_one_outside(run: Any) -> None:
    assert run([(OUTSIDE, "b"), (Verdict.NOTHING_MISSING, "")])[0] == ("abcd", False)
    assert run([(OUTSIDE, "")], final=Verdict.NOTHING_MISSING)[0] == ("abcd", False)


@pytest.mark.parametrize("moves", [True, False])
def test_a_valve_that_hardly_moves_is_judged_by_the_motor(
    monkeypatch: pytest.MonkeyPatch, moves: bool
) -> None:
    """A gap is found; the valve's own motion may then be too little for a fit."""
    sides: list[tuple[str, bool]] = []
    gap = SimpleNamespace(term=EFFECTS["backlash"])

    def search(start: Any, _terms: Any, *rest: Any) -> Any:
        sides.append((start.views, rest[-1].until_flexible))
        return SimpleNamespace(final=SimpleNamespace(effects=[gap]), side=start.views)

    def fit(*_: Any) -> Any:
        if not moves:
            raise RecordingError("no sample is in steady motion")
        return SimpleNamespace(views="valve")

    for name, replaced in (("search", search), ("fit_from_estimate", fit)):
        monkeypatch.setattr(diagnose, name, replaced)
    monkeypatch.setattr(diagnose, "views", lambda *_: "valve")
    dataset = SimpleNamespace(part=lambda _role: [], model=SimpleNamespace(fixed=()), recordings=())
    first = SimpleNamespace(nominal=None, views="motor", unit="N m")
    task: Any = SimpleNamespace(dataset=dataset, first=first, rng=None, bandwidth=25.0)
    task.report = lambda *_: None
    here, found, flexible = diagnose._search_sides(task, MOTION, False)
    side = "valve" if moves else "motor"
    assert (here, found.side, flexible) == (side, side, moves)
    assert sides == [("motor", True), (side, False)]


@pytest.mark.parametrize(
    ("name", "twist", "stated"),
    [("backlash", 0.0, True), ("backlash", 0.1, False), ("cogging", 0.0, False)],
)
def test_friction_fitted_to_the_motor_behind_a_still_valve_is_stated(
    name: str, twist: float, stated: bool
) -> None:
    final = SimpleNamespace(effects=[SimpleNamespace(term=EFFECTS[name])])
    found: Any = SimpleNamespace(final=final)
    views: Any = [SimpleNamespace(twist=np.full(3, twist))]
    texts = diagnose._still_valve(found, views)
    assert [t.startswith("the valve moves too little") for t in texts] == [True] * stated
