"""The control socket of a run: which messages are accepted, commands between cycles, answers to
prompts, nothing that blocks.
"""

import dataclasses
import io
import os
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from drivers.clock import NS, SimulatedClock
from rig.common.sample import Phase
from rig.control.operator import AutomaticOperator, ConsoleOperator, Verb
from rig.control.phase_handlers import TRANSITIONS
from rig.runs.run_record import Ending
from rig.terminal.control_socket import (
    LONGEST_BYTES,
    LONGEST_TEXT,
    PREFIX,
    STALE_NS,
    SUFFIX,
    Command,
    ControlSocket,
    MessageError,
    Order,
    SocketFolderError,
    objection,
    order_of,
    require_own_folder,
    socket_folders,
)
from rig.terminal.prompt import Prompt
from rig.terminal.screen import Screen
from rig.terminal.stop_button import OperatorStopError, StopButton
from tests.rig.console.sockets import Peer, only_socket, short_folder


class Bound:
    """A control socket, its button, and a program that has attached to it."""

    def __init__(self, folder: Path) -> None:
        self.stop = StopButton()
        self.said: list[str] = []
        self.control = ControlSocket(self.stop, {"bench": "b"}, self.said.append, folder)
        self.peer = Peer(folder)
        self.peer.attach(only_socket(folder))
        self.peer.run = self.control.run

    def sent(self, message: dict[str, Any] | bytes) -> dict[str, Any]:
        """Send a message, let the run take it, and return its answer."""
        self.peer.put(message)
        self.control.take()
        return self.peer.get()


@pytest.fixture
def bound() -> Iterator[Bound]:
    with short_folder() as folder:
        made = Bound(folder)
        with made.control, made.peer:
            yield made


@pytest.fixture
def screen() -> Screen:
    return Screen(SimulatedClock(), io.StringIO(), io.StringIO())


def test_the_socket_is_of_this_user_only_and_goes_with_the_run() -> None:
    with short_folder() as folder:
        # That of a dead program is removed.
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as left:
            left.bind(str(folder / f"{PREFIX}1{SUFFIX}"))
        with ControlSocket(StopButton(), {}, print, folder):
            assert only_socket(folder).stat().st_mode & 0o777 == 0o600
        assert not list(folder.iterdir())


def test_a_replayed_stop_is_no_second_press(bound: Bound) -> None:
    order = bound.peer.order("stop")
    bound.peer.put(order)
    # It is taken when the button is read.
    assert not bound.stop.pressed
    with pytest.raises(OperatorStopError, match=r"STOP by a test"):
        bound.stop.check()
    assert bound.peer.get()["taken"]
    assert not bound.sent(order)["taken"]
    assert bound.stop.presses_now() == 1
    assert bound.sent(bound.peer.order("stop"))["taken"]
    assert bound.stop.presses == 2


def test_a_stop_is_taken_after_a_later_command_but_once(bound: Bound) -> None:
    early = bound.peer.order("stop")
    assert bound.sent(bound.peer.order("pause"))["taken"]
    assert bound.sent(early)["taken"]
    assert not bound.sent(early)["taken"]
    assert bound.stop.presses_now() == 1


def test_pause_is_asked_for_and_taken_back(bound: Bound) -> None:
    assert bound.sent(bound.peer.order("pause"))["taken"]
    assert bound.sent(bound.peer.order("pause"))["taken"]
    assert bound.stop.pausing
    assert bound.sent(bound.peer.order("no pause"))["taken"]
    assert not bound.stop.pausing
    assert bound.said == ["pause requested, by a test"] * 2 + ["pause cancelled, by a test"]


@pytest.mark.parametrize("data", [b"\x00", b"[]", b"{" + b" " * LONGEST_BYTES + b"}", b"{}"])
def test_what_is_no_command_changes_nothing(bound: Bound, data: bytes) -> None:
    assert not bound.sent(data)["taken"]
    assert not bound.stop.pressed
    assert not bound.stop.pausing


def test_the_state_is_told_and_the_end_to_who_asked_before(bound: Bound) -> None:
    bound.control.entered("empty", "excite")
    bound.control.tell("a message")
    status = bound.sent({"ask": "status"})["status"]
    assert (status["stage"], status["phase"]) == ("empty", "excite")
    assert status["told"] == [[1, "a message"]]
    assert bound.sent({"ask": "about"})["about"]["bench"] == "b"
    bound.control.ended("the drive is off", False)
    assert bound.peer.get()["status"]["ended"] == {"words": "the drive is off", "good": False}


def test_neither_a_flood_nor_a_frozen_receiver_blocks(bound: Bound) -> None:
    bound.peer.socket.setblocking(False)
    sent = 0
    with suppress(BlockingIOError):
        while sent < 100_000:
            bound.peer.put({"ask": "status"})
            sent += 1
    assert sent < 100_000
    began = time.monotonic()
    # The receiver reads none of the answers.
    for _ in range(sent):
        bound.control.take()
    assert time.monotonic() - began < 2.0
    bound.peer.socket.setblocking(True)
    bound.peer.put(bound.peer.order("stop"))
    bound.control.take()
    assert bound.stop.pressed


def test_few_messages_are_taken_between_two_cycles(bound: Bound) -> None:
    for _ in range(9):
        bound.peer.put({"ask": "status"})
    bound.peer.put(bound.peer.order("stop"))
    bound.control.take()
    assert not bound.stop.pressed
    bound.control.take()
    assert bound.stop.pressed


# The short sequence has no first pass; the button is read there in cycles too.
STOPPED_IN = {phase for phase, _ in TRANSITIONS} - {Phase.FIRST_PASS, Phase.WEIGH}


@pytest.mark.parametrize("phase", sorted(STOPPED_IN, key=lambda phase: phase.value))
def test_stop_in_every_phase(phase, bound, runner, fake_bench, monkeypatch):
    bench = fake_bench()
    devices = bench.devices

    def observed() -> Any:
        def observe(stage: str, entered: Phase) -> None:
            bound.control.entered(stage, entered.value)
            if entered is phase and not bound.stop.pressed:
                bound.peer.put(bound.peer.order("stop"))

        return dataclasses.replace(devices(), observer=observe)

    monkeypatch.setattr(bench, "devices", observed)
    _, outcome = runner(bench, AutomaticOperator(control=bound.control), bound.stop)
    assert outcome.ending is Ending.STOPPED
    assert outcome.safe.verified
    if phase in (Phase.APPROACH, Phase.SETTLE, Phase.EXCITE, Phase.HOLD):
        assert f"phase {phase.value}" in outcome.message
    assert bound.peer.get()["taken"]


def operator(bound: Bound, screen: Screen) -> ConsoleOperator:
    prompt = Prompt(screen, control=bound.control, only_there=True, patience_s=20.0)
    return ConsoleOperator(screen, prompt, control=bound.control)


class Answers:
    """Sends answers, each when the prompt that it is for has been opened."""

    def __init__(self, bound: Bound, *texts: str, stale: bool = False) -> None:
        self._texts = iter(texts)
        self._bound = bound
        self._stale = stale
        self.asked = bound.control.ask
        bound.control.ask = self.ask  # type: ignore[method-assign]

    def ask(self, words: str) -> None:
        self.asked(words)
        number = self._bound.control._prompts - self._stale
        text = next(self._texts, None)
        order = "stop" if text is None else "answer"
        self._bound.peer.put(self._bound.peer.order(order, prompt=number, text=text or ""))


def test_the_mass_is_typed_by_the_rules_of_the_terminal(bound: Bound, screen: Screen) -> None:
    Answers(bound, "20", "30600 g", "20", "repeat")
    asked = operator(bound, screen)
    assert asked.confirm_weight("heavy", 30.6) == pytest.approx(30.6)
    assert asked.confirm_weight("heavy", 30.6) is Verb.REPEAT
    bound.peer.put({"ask": "status"})
    bound.control.take()
    assert [bound.peer.get()["taken"] for _ in range(4)] == [True] * 4
    told = [words for _, words in bound.peer.get()["status"]["told"]]
    assert any("20 kg is not the planned 30.6 kg" in words for words in told)
    # A page with buttons is not told what to type.
    assert not [words for words in told if "`" in words]


def test_abort_and_stop_end_a_prompt(bound: Bound, screen: Screen) -> None:
    Answers(bound, "abort")
    with pytest.raises(OperatorStopError, match="aborted at the weight prompt"):
        operator(bound, screen).confirm_weight("heavy", 30.6)
    with pytest.raises(OperatorStopError, match="STOP by a test"):
        operator(bound, screen).confirm_weight("heavy", 30.6)


def test_an_answer_to_an_earlier_prompt_is_refused(bound: Bound, screen: Screen) -> None:
    Answers(bound, "30.6", stale=True)
    prompt = Prompt(screen, control=bound.control, only_there=True, patience_s=0.1)
    with pytest.raises(OperatorStopError, match="nobody answered"):
        ConsoleOperator(screen, prompt, control=bound.control).confirm_weight("heavy", 30.6)
    assert "no longer waits for this answer" in bound.peer.get()["words"]


@pytest.mark.parametrize("verb", list(Verb))
@pytest.mark.parametrize("prompts", [True, False])
def test_verbs_of_a_pause(bound: Bound, screen: Screen, verb: Verb, prompts: bool) -> None:
    """Also of a run without prompts, which names the signal to a terminal as well."""
    told: list[str] = []
    shown: list[str] = []
    bound.control.tell = told.append  # type: ignore[method-assign]
    screen.say = lambda words, err=True: shown.append(words)  # type: ignore[method-assign]
    bound.stop.pause()
    Answers(bound, "nonsense", verb.value)
    automatic = AutomaticOperator(screen=screen, control=bound.control)
    asked = operator(bound, screen) if prompts else automatic
    assert asked.paused("empty", bound.stop) is verb
    assert not bound.stop.pausing
    assert not [words for words in told if "`" in words]
    if not prompts:
        assert "SIGUSR1" in shown[0]


def test_a_run_at_a_terminal_is_answered_in_either_place(bound: Bound, screen: Screen) -> None:
    reading, writing = os.pipe()
    with os.fdopen(reading) as stream:
        prompt = Prompt(screen, stream, control=bound.control, patience_s=20.0)
        asked = ConsoleOperator(screen, prompt, control=bound.control)
        os.write(writing, b"30.6\n")
        assert asked.confirm_weight("heavy", 30.6) == 30.6
        Answers(bound, "30.5")
        assert asked.confirm_weight("heavy", 30.6) == 30.5
        os.close(writing)
        # Without a person at either end the run does not wait for ever.
        bound.control.ask = lambda words: None  # type: ignore[method-assign]
        with pytest.raises(OperatorStopError, match="the input has ended"):
            asked.confirm_weight("heavy", 1.0)


NOW = 1000 * NS
FIELDS: dict[str, Any] = {"command": "answer", "run": "r", "number": 5, "who": "w", "text": "0"}


def order(**changed: Any) -> Order:
    return Order(**{"command": Command.PAUSE, "run": "r", "number": NOW, "who": "w", **changed})


@pytest.mark.parametrize(
    ("changed", "last", "words"),
    [
        ({}, 0, None),
        ({"run": "another"}, 0, "another run"),
        ({}, NOW, "already received"),
        ({}, NOW - 1, None),
        ({"number": NOW + 1}, 0, "future"),
        ({"number": NOW - STALE_NS}, 0, None),
        ({"number": NOW - STALE_NS - 1}, 0, "5.0 s old"),
        ({"number": NOW - 100 * NS, "command": Command.STOP}, 0, None),
        ({"number": NOW, "command": Command.STOP}, NOW, "already received"),
        ({"run": "another", "command": Command.STOP}, 0, "another run"),
    ],
)
def test_what_is_refused(changed: dict[str, Any], last: int, words: str | None) -> None:
    found = objection(order(**changed), "r", last, NOW, {last})
    assert found is None if words is None else found is not None and words in found


@pytest.mark.parametrize(
    "changed",
    [
        {"command": "jump"},
        {"number": "5"},
        {"number": True},
        {"run": 1},
        {"text": None},
        {"text": "0" * (LONGEST_TEXT + 1)},
        {"who": "w" * (LONGEST_TEXT + 1)},
        {"more": 1},
        {"prompt": 1.5},
    ],
)
def test_commands_with_wrong_fields(changed: dict[str, Any]) -> None:
    with pytest.raises(MessageError):
        order_of({**FIELDS, **changed})


def test_the_folder_is_closed_to_others(tmp_path: Path) -> None:
    folder = tmp_path / "sockets"
    for _ in range(2):
        require_own_folder(folder)
        assert folder.stat().st_mode & 0o777 == 0o700
    (tmp_path / "link").symlink_to(folder)
    folder.chmod(0o750)
    with pytest.raises(SocketFolderError, match="chmod 700"):
        require_own_folder(folder)
    folder.chmod(0o700)
    with pytest.raises(SocketFolderError):
        require_own_folder(tmp_path / "link")


def test_the_folder_follows_the_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    without = Path(f"/tmp/loadrig-{os.geteuid()}")
    assert socket_folders() == [tmp_path / "loadrig", without]
    for missing in ("nowhere", str(tmp_path / "nowhere"), ""):
        monkeypatch.setenv("XDG_RUNTIME_DIR", missing)
        assert socket_folders() == [without]
