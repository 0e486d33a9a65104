"""Which run a page shows, and so which run its STOP is for; what is said of a command to a run that
hangs is true.
"""

from __future__ import annotations

import asyncio
import errno
import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pytest
from starlette.websockets import WebSocketDisconnect

import rig.console.hub as run_link
from drivers.clock import NS, SimulatedClock
from rig.console.app import Console
from rig.console.followed import SILENT_S
from rig.console.gate import Token
from rig.console.hub import TICK_S, Hub, Links, Page, Refusal, Unreachable
from rig.console.starting import Starter
from rig.terminal.control_socket import VERSION, Command, ControlSocket, socket_folders
from rig.terminal.stop_button import StopButton
from tests.rig.console.sockets import Peer, only_socket, short_folder

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.websockets import WebSocket


class Desk:
    """A hub that hears of runs as their sockets would tell it."""

    def __init__(self, root: Path) -> None:
        self.hub = Hub(Starter(("practical",), root))
        self.hub._links.close()
        # Programs of other tests are none of this one.
        self.hub._links.runs = list  # type: ignore[method-assign]
        self.page = self.hub.controls.open()
        self.console = Console(self.hub, Token(), frozenset())

    def begin(self, key: str, folder: str = "") -> None:
        about: dict[str, Any] = {
            "version": VERSION,
            "run": key,
            "folder": folder or f"/runs/{key}",
            "name": "run",
            "bench": "b",
            "real": False,
            "cycle_s": 0.001,
            "torque_per_ampere": 3.0,
            "gear_ratio": 100.0,
            "limits": [],
        }
        self.hub._heard(f"/{key}.sock", {"about": about})
        self.tell(key, ended=None)

    def tell(self, key: str, ended: object) -> None:
        status = {"phase": "excite", "ended": ended, "stopping": False}
        self.hub._heard(f"/{key}.sock", {"status": status})

    def reached(self, key: str, **about: object) -> None:
        """Hear of a program that is no run."""
        given = {"version": VERSION, "run": key, "name": "jog", "bench": "b", "real": True, **about}
        self.hub._heard(f"/{key}.sock", {"about": given})

    def press(self, page: Page | None = None, **more: object) -> dict[str, Any]:
        """Press STOP on a page, or without one."""
        return asyncio.run(self.console._command(page, {"command": "stop", **more}))

    def end(self, key: str) -> None:
        self.tell(key, {"words": "done", "good": True})

    def shown(self, page: Page | None = None) -> str | None:
        run = self.hub.run_of(page or self.page)
        return None if run is None else run.key


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def opened_again(desk: Desk, shown: object, own: object = False) -> Page:
    """Return the page of a browser that connects once more, with what it showed before."""

    class Socket:
        sent = 0

        async def accept(self) -> None:
            pass

        async def receive_json(self) -> dict[str, object]:
            self.sent += 1
            if self.sent > 1:
                await asyncio.sleep(60.0)
            return {"token": "wrong", "shown": shown, "own": own}

        async def send_text(self, _: str) -> None:
            raise WebSocketDisconnect

        async def close(self, *_: object) -> None:
            pass

    found: list[Page] = []
    opening = desk.hub.controls.open
    with pytest.MonkeyPatch.context() as context:
        context.setattr(desk.hub.controls, "open", lambda: found.append(opening()) or found[0])
        asyncio.run(desk.console._live(cast("WebSocket", Socket())))
    return found[0]


def test_a_run_that_begins_elsewhere_does_not_take_the_place_of_the_run(desk: Desk) -> None:
    assert desk.shown() is None
    desk.begin("mine")
    assert desk.shown() == "mine"
    desk.begin("other")
    assert desk.shown() == "mine"
    # A page that is opened now shows the newest, until its user chooses another.
    late = desk.hub.controls.open()
    assert desk.shown(late) == "other"
    late.run = "mine"
    desk.begin("third")
    assert desk.shown(late) == "mine"
    # A page that lost its contact keeps its run, unless that has ended.
    assert desk.shown(opened_again(desk, "mine")) == "mine"
    desk.end("mine")
    assert desk.shown() == "mine"
    for shown in (None, "unknown", 7, ["mine"], "mine"):
        assert desk.shown(opened_again(desk, shown)) == "third"
    desk.begin("next")
    assert desk.shown() == "next"


def test_a_run_that_was_started_from_the_page_is_shown(desk: Desk) -> None:
    desk.begin("other")
    assert desk.shown() == "other"
    desk.hub.follow_up(desk.page, Path("/runs/mine"))
    desk.begin("third")
    assert desk.shown() == "other"
    desk.begin("mine")
    # Also if it has ended before it was found.
    desk.end("mine")
    assert desk.shown() == "mine"
    # Another page, or a terminal, continues that run; then this page does, in the same folder.
    desk.begin("again", "/runs/mine")
    assert desk.shown() == "mine"
    desk.hub.follow_up(desk.page, Path("/runs/mine"))
    assert desk.shown() == "mine"
    desk.begin("mine once more", "/runs/mine")
    assert desk.shown() == "mine once more"


def take_controls(desk: Desk, key: str) -> None:
    desk.begin(key)
    desk.hub.controls.admit(desk.page)
    assert desk.shown() == key


def start_it(desk: Desk, key: str) -> None:
    desk.hub.follow_up(desk.page, Path(f"/runs/{key}"))
    desk.begin(key)


def stop_it(desk: Desk, key: str) -> None:
    desk.begin(key)
    # The run does not answer, as its end is not verified.
    with pytest.raises(Refusal):
        desk.press(desk.page, run=key)


@pytest.mark.parametrize("own", [take_controls, start_it, stop_it])
def test_a_page_keeps_the_end_of_its_own_run(desk: Desk, own: Callable[[Desk, str], None]) -> None:
    own(desk, "mine")
    desk.begin("other")
    desk.end("mine")
    assert desk.shown() == "mine"
    # Not even the many runs after it take the run from the page, and a lost contact does not.
    for number in range(9):
        desk.begin(f"more-{number}")
        desk.end(f"more-{number}")
    desk.hub._look(0.0)
    assert desk.shown() == "mine"
    assert "more-1" not in desk.hub.runs
    assert desk.shown(opened_again(desk, "mine", own=True)) == "mine"
    # Only the user replaces the run, also while the page waits for a run that it has started.
    desk.page.run = "other"
    desk.hub.follow_up(desk.page, Path("/runs/next"))
    desk.begin("later")
    assert desk.shown() == "other"
    desk.begin("next")
    assert desk.shown() == "next"


class Sent:
    """What is sent to the programs in progress; some of them do not answer."""

    def __init__(self, desk: Desk, monkeypatch: pytest.MonkeyPatch, *mute: str) -> None:
        self.stopped: list[str] = []
        self.mute = mute
        self.begins: list[str] = []
        self.desk = desk
        links = desk.hub._links
        monkeypatch.setattr(links, "runs", lambda: [f"/{key}.sock" for key in self.begins])
        monkeypatch.setattr(links, "ask", self.ask)
        monkeypatch.setattr(links, "command", self.command)

    def ask(self, path: str, what: str) -> None:
        if what == "about":
            self.desk.reached(path[1:-5])

    async def command(self, path: str, run: str, command: Command, *_: object) -> dict[str, object]:
        assert command is Command.STOP
        self.stopped.append(run)
        if run in self.mute:
            raise Unreachable("no answer")
        return {"taken": True, "words": ""}


def test_stop_is_for_whatever_moves(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    start_it(desk, "mine")
    desk.end("mine")
    desk.begin("other")
    desk.reached("jog")
    sent = Sent(desk, monkeypatch)
    # The page shows the end of its own run.
    assert desk.shown() == "mine"
    # The last of them began just now.
    sent.begins = ["new"]
    assert desk.press(desk.page)["stopped"] == sent.stopped == ["other", "jog", "new"]
    # The page then shows the end of what was stopped.
    assert desk.shown() == "other"
    # A jog is no run: it is not shown, and its end is its socket's.
    assert "jog" not in desk.hub.runs
    sent.begins = []
    for each in desk.hub.others.values():
        each.gone = True
    desk.end("other")
    assert desk.press()["stopped"] == []


def test_a_stop_names_what_did_not_confirm_it(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.begin("one")
    desk.begin("two")
    sent = Sent(desk, monkeypatch, "one")
    with pytest.raises(Refusal) as refused:
        desk.press()
    assert refused.value.details == {"unconfirmed": ["one"]}
    assert sent.stopped == ["one", "two"]


def test_a_program_that_has_not_answered_yet_leaves_a_stop_unconfirmed(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that connects to its bench is known only when it answers."""
    monkeypatch.setattr(desk.hub._links, "runs", lambda: ["/late.sock"])
    monkeypatch.setattr(desk.hub._links, "ask", lambda *_: None)
    with pytest.raises(Refusal, match="1 more"):
        desk.press(desk.page)
    desk.reached("late", bench="b")
    sent = Sent(desk, monkeypatch)
    assert desk.press(desk.page)["stopped"] == sent.stopped == ["late"]


def test_programs_on_other_benches_are_not_stopped(desk, monkeypatch):
    desk.hub._only = frozenset({"mine"})
    desk.reached("other", bench="b")
    desk.reached("jog", bench="mine")
    Sent(desk, monkeypatch)
    assert desk.press()["stopped"] == ["jog"]


def test_questions_to_a_run_that_hangs_leave_room_for_stop_in_its_queue(desk, monkeypatch):
    asked: list[tuple[float, str]] = []
    now_s = 0.0
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    monkeypatch.setattr(desk.hub._links, "runs", lambda: ["/mine.sock", "/new.sock"])
    monkeypatch.setattr(desk.hub._links, "ask", lambda path, what: asked.append((now_s, path)))
    desk.begin("mine")
    for tick in range(600):
        now_s = tick * TICK_S
        desk.hub._tick()
    for path in ("/mine.sock", "/new.sock"):
        assert 5 < len([each for each in asked if each[1] == path]) < 9
    # A run that answers is asked at each tick.
    desk.tell("mine", ended=None)
    del asked[:]
    for _ in range(5):
        now_s += TICK_S
        desk.hub._tick()
        desk.tell("mine", ended=None)
    assert len([each for each in asked if each[1] == "/mine.sock"]) == 5
    # One answer that is lost does not make the run silent.
    del asked[:]
    for _ in range(11):
        now_s += TICK_S
        desk.hub._tick()
    assert asked[1][0] - asked[0][0] < SILENT_S


class Line:
    """A run, and a console that sends commands to this run.

    Attributes:
        steps: What happens while the console waits for an answer, one step for each time it sends
            the command.
    """

    def __init__(self) -> None:
        self.stop = StopButton()
        self.clock = SimulatedClock(NS)
        self.run = ControlSocket(self.stop, {}, lambda words: None, clock=self.clock)
        self.folder = socket_folders()[0]
        self.path = str(only_socket(self.folder))
        self.links = Links(lambda path, message: None, self.clock)
        self.steps: list[Callable[[], object]] = []
        self.tries = 0

    def fill(self) -> None:
        """Fill the queue of the run."""
        with Peer(self.folder) as peer, suppress(BlockingIOError):
            peer.socket.setblocking(False)
            peer.attach(Path(self.path))
            while True:
                peer.put({"ask": "status"})

    def pause(self, later_ns: int) -> None:
        """Have another program send a command that is so much later."""
        with Peer(self.folder) as peer:
            peer.attach(Path(self.path))
            peer.run = self.run.run
            peer.put(peer.order("pause", number=self.clock.now_ns() + later_ns))

    def take_all(self) -> None:
        """Let the run take all messages of its queue."""
        while self.run._ready.poll(0):
            self.run.take()

    def lose_answers(self) -> None:
        """Let the run take all messages; its answers are lost."""
        self.take_all()
        self.links._heard = lambda path, message: None
        waiting, self.links._waiting = self.links._waiting, {}
        self.links._read()
        self.links._waiting = waiting

    def nothing(self) -> None:
        """Let the run hang."""

    async def wait(self, future: asyncio.Future[Any], seconds: float) -> Any:
        """Stand in for the wait for an answer, in simulated time."""
        self.tries += 1
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * NS))
        if self.steps:
            self.steps.pop(0)()
        self.links._read()
        if not future.done():
            raise TimeoutError
        return future.result()

    def stop_it(self) -> dict[str, Any]:
        return asyncio.run(self.links.command(self.path, self.run.run, Command.STOP, "a page"))


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[Line]:
    with short_folder() as runtime:
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
        made = Line()
        monkeypatch.setattr(run_link.asyncio, "wait_for", made.wait)
        with made.run:
            yield made
        made.links.close()


def test_a_stop_that_waits_in_the_queue_is_executed_later(line: Line) -> None:
    with pytest.raises(Unreachable, match="will execute the command when it responds again"):
        line.stop_it()
    line.take_all()
    assert line.stop.presses == 1


def test_a_stop_that_never_got_into_the_queue_is_not_announced(line: Line) -> None:
    line.fill()
    with pytest.raises(Unreachable, match="will NOT execute it later"):
        line.stop_it()
    assert line.tries == run_link.ATTEMPTS
    line.take_all()
    assert not line.stop.pressed


def test_a_stop_is_confirmed_only_if_the_run_took_it(line: Line) -> None:
    """The queue is full at first, and the command of another program gets in before STOP."""
    line.fill()

    def pause() -> None:
        line.take_all()
        line.pause(-1)

    line.steps = [pause, line.nothing, line.take_all]
    assert line.stop_it()["taken"]
    assert line.stop.presses == 1
    assert line.stop.pausing


def test_a_stop_whose_answer_is_lost_is_one_press(line: Line) -> None:
    line.steps = [line.lose_answers, line.take_all]
    assert line.stop_it()["taken"]
    assert line.tries == 2
    assert line.stop.presses == 1


def test_a_stop_after_a_later_command_of_another_program_is_taken_at_once(line: Line) -> None:
    line.pause(NS // 10)
    line.steps = [line.take_all]
    assert line.stop_it()["taken"]
    assert line.tries == 1
    assert line.stop.presses == 1
    assert line.stop.pausing


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN])
def test_a_message_that_cannot_be_sent_now_does_not_end_a_run(line, monkeypatch, number):
    sending = line.links._socket

    class Short:
        def sendto(self, data: bytes, path: str) -> None:
            if not line.tries:
                raise OSError(number, os.strerror(number))
            sending.sendto(data, path)

        def recvfrom(self, size: int) -> Any:
            return sending.recvfrom(size)

    with monkeypatch.context() as context:
        context.setattr(line.links, "_socket", Short())
        line.links.ask(line.path, "status")
        line.steps = [line.nothing, line.take_all]
        assert line.stop_it()["taken"]
    assert line.stop.presses == 1


@pytest.mark.parametrize("left", [True, False])
def test_a_run_whose_program_has_ended_is_gone(line: Line, left: bool) -> None:
    line.run._socket.close()
    if not left:
        Path(line.path).unlink()
    with pytest.raises(Unreachable, match="the program of the run has ended"):
        line.links.ask(line.path, "status")
