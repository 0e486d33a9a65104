"""The screen: nothing that a terminal or pipe does can hold it up."""

import fcntl
import io
import os
import struct
import termios
import time
import tty
from collections.abc import Iterator
from typing import Any

import pytest

from drivers.clock import SimulatedClock
from rig.terminal.screen import DRAIN_S, QUEUE_BYTES, Outlet, Screen


class Terminal:
    """A pseudo-terminal of so many columns; ``shown`` is what has come out of it."""

    def __init__(self, columns: int = 80) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.resize(columns)
        os.set_blocking(self.master, False)
        self.stream = os.fdopen(self.slave, "w", encoding="utf-8", closefd=False)

    def resize(self, columns: int) -> None:
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))

    def shown(self) -> str:
        data = b""
        while True:
            try:
                data += os.read(self.master, 65536)
            except BlockingIOError:
                return data.decode()

    def stall(self) -> None:
        termios.tcflow(self.slave, termios.TCOOFF)

    def go_on(self) -> None:
        termios.tcflow(self.slave, termios.TCOON)

    def close(self) -> None:
        self.stream.close()
        os.close(self.slave)
        os.close(self.master)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    made.close()


@pytest.fixture(autouse=True)
def capable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")


def on(terminal: Terminal, clock: Any = None) -> Screen:
    return Screen(clock or SimulatedClock(), terminal.stream, terminal.stream)


def test_a_stopped_terminal_takes_no_time_and_gets_everything_later(terminal: Terminal) -> None:
    screen = on(terminal)
    terminal.stall()
    began = time.monotonic()
    for number in range(2000):
        screen.say(f"line {number}")
    assert time.monotonic() - began < 1.0
    assert screen._err.pending
    shown = ""
    terminal.go_on()
    while screen._err.pending:
        screen.pump()
        shown += terminal.shown()
    assert shown.splitlines() == [f"line {number}" for number in range(2000)]
    screen.close()


def test_what_is_queued_is_bounded(terminal: Terminal) -> None:
    screen = on(terminal)
    terminal.stall()
    for _ in range(QUEUE_BYTES // 1000 + 100):
        screen.say("x" * 1000)
    assert len(screen._err._pending) <= QUEUE_BYTES
    screen.close()


def test_draining_ends_after_its_patience_in_simulated_time(terminal: Terminal) -> None:
    clock = SimulatedClock()
    screen = on(terminal, clock)
    terminal.stall()
    screen.say("never shown")
    assert not screen.drain()
    assert clock.now_ns() == round(DRAIN_S * 1e9)
    screen.close()


def test_a_full_device_is_noted_and_raises_nothing() -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        screen = Screen(SimulatedClock(), full, full)
        screen.say("lost", err=False)
        assert screen.trouble.strerror == "No space left on device"
        screen.close()


def test_a_hung_up_terminal_raises_nothing() -> None:
    terminal = Terminal()
    screen = on(terminal)
    os.close(terminal.master)
    screen.say("nobody is there")
    screen.status("or here")
    assert screen.drain()
    screen.close()
    terminal.stream.close()
    os.close(terminal.slave)


def test_what_the_encoding_lacks_is_escaped() -> None:
    reading, writing = os.pipe()
    with os.fdopen(writing, "w", encoding="ascii") as stream:
        Screen(SimulatedClock(), stream, stream).say("Jürgen ☃")
    assert os.read(reading, 100) == b"J\\xfcrgen \\u2603\n"
    os.close(reading)


def test_the_status_line_fits_the_width_and_is_drawn_four_times_a_second(terminal):
    clock = SimulatedClock()
    terminal.resize(40)
    screen = on(terminal, clock)
    for number in range(100):
        screen.status(f"{number} " + "x" * 60)
        clock.sleep_until_ns(clock.now_ns() + 10_000_000)
    drawn = [line for line in terminal.shown().split("\r") if line]
    assert len(drawn) == 4
    assert all(len(line.replace("\x1b[J", "")) == 39 for line in drawn)
    screen.close()


def test_a_message_beside_another_program_begins_a_line_of_its_own(terminal: Terminal) -> None:
    screen = on(terminal)
    screen.share()
    for words in ("x", "y"):
        screen.say(words)
    assert terminal.shown() == "\nx\n\ny\n"
    screen.close()
    stream = io.StringIO()
    piped = Screen(SimulatedClock(), io.StringIO(), stream)
    piped.share()
    piped.say("x")
    assert stream.getvalue() == "x\n"


def test_a_message_takes_the_place_of_the_status_line(terminal: Terminal) -> None:
    screen = on(terminal)
    screen.status("busy")
    screen.say("words")
    assert terminal.shown() == "\rbusy\r\x1b[Jwords\n"
    screen.close()


def echoes(terminal: Terminal) -> bool:
    return bool(termios.tcgetattr(terminal.slave)[3] & termios.ECHO)


def test_keys_are_shown_at_a_prompt_and_after_the_end_and_not_between(terminal: Terminal) -> None:
    Outlet(terminal.stream).echo(True)
    screen = on(terminal)
    screen.silence()
    assert not echoes(terminal)
    screen.ask("mass: ")
    assert echoes(terminal)
    screen.listened()
    assert not echoes(terminal)
    os.write(terminal.master, b"\x03typed")
    screen.say("stopped: by the operator")
    assert terminal.shown() == "mass: \nstopped: by the operator\n"
    screen.close()
    assert echoes(terminal)
