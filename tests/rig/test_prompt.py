"""Prompts: what was typed before the question does not answer it."""

import os
import select
import signal
import tty
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.clock import SimulatedClock
from rig.control.operator import ConsoleOperator, parse_mass_kg
from rig.terminal.prompt import InputEndedError, Prompt
from rig.terminal.screen import Screen
from rig.terminal.stop_button import STOP_SIGNALS, OperatorStopError, StopButton


class Pipe:
    def __init__(self) -> None:
        self.reading, self.writing = os.pipe()
        self.stream = os.fdopen(self.reading, "r", encoding="utf-8")

    def type(self, text: str) -> None:
        os.write(self.writing, text.encode())


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    made = Pipe()
    yield made
    made.stream.close()
    os.close(made.writing)


def silent() -> Screen:
    with open(os.devnull, "w", encoding="utf-8") as nothing:
        return Screen(SimulatedClock(), nothing, nothing)


def test_the_end_of_the_input_is_said(pipe: Pipe) -> None:
    prompt = Prompt(silent(), pipe.stream)
    pipe.type("last")
    os.close(pipe.writing)
    pipe.writing = os.open(os.devnull, os.O_WRONLY)
    assert prompt.ask("Mass: ") == "last"
    with pytest.raises(InputEndedError, match="the input has ended"):
        prompt.ask("Mass: ")


def test_what_was_typed_before_the_question_does_not_answer_it() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    os.write(master, b"30.6\n")
    select.select([slave], [], [])

    class Answering(Screen):
        def ask(self, words: str) -> None:
            os.write(master, b"10\n")

    with (
        open(os.devnull, "w", encoding="utf-8") as nothing,
        os.fdopen(slave, "r", encoding="utf-8") as stream,
    ):
        prompt = Prompt(Answering(SimulatedClock(), nothing, nothing), stream)
        assert prompt.ask("Mass: ") == "10"
    os.close(master)


def test_without_an_input_there_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(InputEndedError):
        Prompt(silent()).ask("Mass: ")


class Impatient(SimulatedClock):
    """A clock on which every look takes ten seconds."""

    def now_ns(self) -> int:
        self.sleep_until_ns(super().now_ns() + 10_000_000_000)
        return super().now_ns()


def test_patience_ends(pipe: Pipe, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(
        "rig.terminal.prompt.select.select", lambda r, w, x, s: waits.append(s) or ([], [], [])
    )
    prompt = Prompt(silent(), pipe.stream, patience_s=60.0, clock=Impatient())
    with pytest.raises(
        OperatorStopError, match="nobody answered the prompt within 60 s; continue with"
    ):
        prompt.ask("Mass: ")
    waited = [wait for wait in waits if wait]
    assert len(waited) == 5
    assert max(waited) <= 1.0


@pytest.mark.parametrize("name", sorted(STOP_SIGNALS))
def test_every_stop_signal_is_heard_at_the_prompt(pipe, monkeypatch, name):
    number = getattr(signal, name)

    def waiting(reading: Any, writing: Any, odd: Any, wait_s: float) -> Any:
        if wait_s:
            signal.raise_signal(number)
            raise AssertionError("the signal was not heard")
        return [], writing, []

    monkeypatch.setattr("rig.terminal.prompt.select.select", waiting)
    operator = ConsoleOperator(silent(), Prompt(silent(), pipe.stream))
    before = signal.getsignal(number)
    with (
        StopButton() as stop,
        pytest.raises(OperatorStopError, match="at the weight prompt"),
        stop.interruptible(),
    ):
        operator.confirm_weight("heavy", 10.0)
    assert stop.pressed
    assert signal.getsignal(number) is before


@pytest.mark.parametrize(
    ("text", "mass"),
    [
        ("30.6", 30.6),
        ("30,6", 30.6),
        ("30.6 kg", 30.6),
        ("30600 g", 30.6),
        ("-1", -1.0),
        ("", None),
        ("1e3", None),
        ("inf", None),
        ("30.6 lb", None),
        ("1.2.3", None),
    ],
)
def test_masses_as_they_are_typed(text: str, mass: float | None) -> None:
    assert parse_mass_kg(text) == pytest.approx(mass)


class Script:
    def __init__(self, *answers: str) -> None:
        self.answers = list(answers)
        self.asked: list[str] = []

    def ask(self, words: str) -> str:
        self.asked.append(words)
        return self.answers.pop(0)


class Told(ConsoleOperator):
    def __init__(self, *answers: str, tolerance: float = 0.005) -> None:
        super().__init__(silent(), Script(*answers), tolerance=tolerance)
        self.told: list[str] = []

    def tell(self, words: str, typed: str = "") -> None:
        self.told.append(words + typed)


def test_the_planned_mass_is_not_shown_before_an_answer() -> None:
    operator = Told("29", "30.6")
    assert operator.confirm_weight("heavy", 30.6) == 30.6
    before, after = operator.told[:1], operator.told[1:]
    assert not any("30.6" in words for words in before)
    assert "29 kg is not the planned 30.6 kg (tolerance 0.153 kg)" in after[0]
