"""Commands to a run that hangs: what the console states about a command is true."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import rig.console.hub as run_link
from drivers.clock import NS, SimulatedClock
from rig.console.hub import Links, Unreachable
from rig.terminal.control_socket import Command, ControlSocket, socket_folders
from rig.terminal.stop_button import StopButton

from .sockets import Peer, only_socket, short_folder


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
        with Peer(line.folder) as peer:
            peer.attach(Path(line.path))
            peer.run = line.run.run
            peer.put(peer.order("pause", number=line.clock.now_ns() - 1))

    line.steps = [pause, line.nothing, line.take_all]
    assert line.stop_it()["taken"]
    assert line.stop.presses == 1
    assert line.stop.pausing


def test_a_stop_whose_answer_is_lost_is_one_press(line: Line) -> None:
    line.steps = [line.lose_answers, line.take_all]
    assert line.stop_it()["taken"]
    assert line.tries == 2
    assert line.stop.presses == 1


def test_a_stop_after_a_later_command_of_another_program_gets_a_new_number(line: Line) -> None:
    with Peer(line.folder) as peer:
        peer.attach(Path(line.path))
        peer.run = line.run.run
        # The other program was faster: its later command waits before STOP.
        peer.put(peer.order("pause", number=line.clock.now_ns() + NS // 10))

    line.steps = [line.take_all, line.take_all]
    assert line.stop_it()["taken"]
    assert line.tries == 2
    assert line.stop.presses == 1
    assert line.stop.pausing


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.ENOMEM, errno.EAGAIN])
def test_a_message_that_cannot_be_sent_now_does_not_end_a_run(
    line: Line, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
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
