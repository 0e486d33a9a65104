"""Which searches follow a search that ends outside the catalogue, and which of them counts."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from identification.diagnosis import diagnose
from identification.diagnosis.held_out import DROPPED
from identification.diagnosis.result import Step, Verdict
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


@pytest.mark.parametrize(
    ("script", "options", "counted", "asked"),
    [
        *(
            ([(verdict, "a")], {}, ("abcd", False), ["abcd"])
            for verdict in (NAMED, Verdict.AMBIGUOUS, Verdict.NOTHING_MISSING)
        ),
        ([(OUTSIDE, "b"), (NAMED, "")], {}, ("acd", False), ["abcd", "acd"]),
        ([(OUTSIDE, "b"), (Verdict.NOTHING_MISSING, "")], {}, ("abcd", False), ["abcd", "acd"]),
        ([(OUTSIDE, n) for n in "abc"], {}, ("abcd", False), ["abcd", "bcd", "cd"]),
        ([(OUTSIDE, "")], {"final": NAMED}, ("abcd", True), ["abcd"]),
        ([(OUTSIDE, "")], {"final": NAMED, "nearly_all": False}, ("abcd", False), ["abcd"]),
        ([(OUTSIDE, "")], {"final": Verdict.NOTHING_MISSING}, ("abcd", False), ["abcd"]),
    ],
)
def test_dropped_effects_take_no_part_in_the_next_search_and_only_a_name_replaces_the_first(
    run: Any, script: Any, options: Any, counted: Any, asked: list[str]
) -> None:
    found, searches = run(script, **options)
    assert found == counted
    assert [names for names, thorough in searches if not thorough] == asked


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
