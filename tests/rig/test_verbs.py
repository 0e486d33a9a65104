"""What an operator can ask for: pause, go on, repeat, abort; typed at the prompt, or by signal."""

import io
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.clock import SimulatedClock
from rig.control.operator import AutomaticOperator, ConsoleOperator, Verb
from rig.runs.mcap.reader import read_run
from rig.runs.recover import recover
from rig.runs.run import load_run, read_record
from rig.runs.run_record import Ending
from rig.terminal.stop_button import StopButton


class Scripted(AutomaticOperator):
    """Answers boundaries and prompts from lists; None is the planned mass."""

    def __init__(
        self, boundaries: list[Verb] | None = None, prompts: list[Verb | None] | None = None
    ) -> None:
        super().__init__()
        self.boundaries = iter(boundaries or [])
        self.prompts: Iterator[Verb | None] = iter(prompts or [])
        self.asked: list[str] = []
        self.told: list[str] = []

    def confirm_weight(self, stage: str, weight_kg: float) -> float | Verb:
        self.asked.append(stage)
        return next(self.prompts, None) or weight_kg

    def paused(self, stage: str, stop: StopButton) -> Verb:
        verb = next(self.boundaries)
        stop.pausing = False
        return verb

    def tell(self, words: str) -> None:
        self.told.append(words)


def pausing(bench: Any, stop: StopButton, *cycles: int) -> None:
    for cycle in cycles:
        bench.faults["exchange", cycle] = stop.pause


def events(folder: Any) -> list[str]:
    return [e["event"] for e in read_run(folder.recording).events]


def test_a_pause_waits_for_the_stage_boundary(runner: Any, fake_bench: Any) -> None:
    bench, stop, operator = fake_bench(), StopButton(), Scripted([Verb.GO_ON])
    pausing(bench, stop, 700)
    folder, outcome = runner(bench, operator, stop)
    assert outcome.ending is Ending.DONE
    names = events(folder)
    assert names[names.index("stage end") :][:4] == ["stage end", "paused", "go on", "prompt"]


def test_abort_at_a_boundary(runner: Any, fake_bench: Any) -> None:
    bench, stop = fake_bench(), StopButton()
    pausing(bench, stop, 700)
    folder, outcome = runner(bench, Scripted([Verb.ABORT]), stop)
    assert outcome.ending is Ending.STOPPED
    assert "phase between stages: aborted by the operator" in outcome.message
    assert [s.state for s in folder.record.stages] == ["done", "planned"]
    assert bench.calls["enable"] == 1


@pytest.mark.parametrize("last", [False, True])
def test_a_repeated_stage_replaces_itself(runner: Any, fake_bench: Any, last: bool) -> None:
    bench, stop, operator = fake_bench(), StopButton(), Scripted([Verb.REPEAT])
    pausing(bench, stop, 2200 if last else 700)
    folder, outcome = runner(bench, operator, stop)
    assert outcome.ending is Ending.DONE
    assert operator.asked == (["empty", "heavy", "heavy"] if last else ["empty", "empty", "heavy"])
    # Asked for again each time: a reset never comes by itself.
    assert bench.calls["enable"] == 3
    dataset = load_run(folder.path)
    assert [r.name for r in dataset.recordings] == ["empty[1]", "empty[2]", "heavy"]
    kept = [s.kept for s in folder.record.segments]
    assert kept == ([True, True, False, True] if last else [False, False, True, True, True])


def test_repeat_at_the_prompt_goes_back_one_stage(runner: Any, fake_bench: Any) -> None:
    bench, operator = fake_bench(), Scripted(prompts=[None, Verb.REPEAT, None, None])
    folder, outcome = runner(bench, operator)
    assert outcome.ending is Ending.DONE
    assert operator.asked == ["empty", "heavy", "empty", "heavy"]
    assert [s.kept for s in folder.record.segments] == [False, False, True, True, True]
    assert bench.hung == [0.0, 0.0, 10.0]


def test_recovery_knows_which_attempt_counts(runner: Any, fake_bench: Any) -> None:
    bench, stop = fake_bench(), StopButton()
    pausing(bench, stop, 700)
    folder, _ = runner(bench, Scripted([Verb.REPEAT]), stop)
    before = folder.record.segments
    record = read_record(folder.path)
    record.state, record.segments = "running", []
    folder.record = record
    folder.save()
    after = recover(folder.path).record
    assert [(s.index, s.name, s.kept, s.stage_index) for s in after.segments] == [
        (s.index, s.name, s.kept, s.stage_index) for s in before
    ]
    assert [s.state for s in after.stages] == ["done", "done"]


def test_the_automatic_operator_waits_for_the_second_signal() -> None:
    clock, stop = SimulatedClock(), StopButton()
    clock.call_at(3_000_000_000, stop.pause)
    stop.pause()
    assert AutomaticOperator(clock=clock).paused("empty", stop) is Verb.GO_ON
    assert clock.now_ns() >= 3_000_000_000


def typed(monkeypatch: pytest.MonkeyPatch, text: str) -> ConsoleOperator:
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))
    return ConsoleOperator()


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("10,02 kg\n", 10.02),
        ("9.949\n10.05\n", 10.05),
        ("10.051\n10\n", 10.0),
        ("REPEAT\n", Verb.REPEAT),
        ("nan\n10\n", 10.0),
    ],
)
def test_answers_at_the_prompt(monkeypatch, text, answer):
    assert typed(monkeypatch, text).confirm_weight("heavy", 10.0) == answer


@pytest.mark.parametrize("text", ["abort\n", ""])
def test_giving_up_at_the_prompt(runner, fake_bench, monkeypatch, text):
    bench = fake_bench()
    _, outcome = runner(bench, typed(monkeypatch, text))
    assert outcome.ending is Ending.STOPPED
    assert bench.calls["enable"] == 0


@pytest.mark.parametrize(
    ("text", "verb"),
    [
        ("\n", Verb.GO_ON),
        ("go on\n", Verb.GO_ON),
        ("what\nrepeat\n", Verb.REPEAT),
        ("abort\n", Verb.ABORT),
        ("", Verb.ABORT),
    ],
)
def test_answers_to_a_pause(monkeypatch: pytest.MonkeyPatch, text: str, verb: Verb) -> None:
    stop = StopButton()
    stop.pause()
    assert typed(monkeypatch, text).paused("empty", stop) is verb
    assert not stop.pausing


@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_while_braking_takes_the_power_off_at_once(runner, fake_bench, presses):
    bench, stop = fake_bench(), StopButton()
    bench.faults["exchange", 700] = stop.press
    if presses == 2:
        bench.faults["exchange", 705] = stop.press
    folder, outcome = runner(bench, stop=stop)
    assert outcome.ending is Ending.STOPPED
    assert outcome.safe.verified
    assert bench.calls["quick_stop"] == 1
    # The fake brakes until the exchange numbered 750; the state is read every 5 ms, from the first
    # cycle of the braking on.
    assert folder.record.cycles == (705 if presses == 2 else 751)
