"""The screen: nothing that a terminal or pipe does can hold it up, and what is shown is
readable.
"""

from __future__ import annotations

import fcntl
import io
import os
import struct
import termios
import time
import tty
from collections.abc import Iterator

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
        """Do what Ctrl-S does."""
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


@pytest.fixture
def screen(terminal: Terminal) -> Iterator[Screen]:
    made = Screen(SimulatedClock(), terminal.stream, terminal.stream)
    yield made
    made.close()


def test_a_stream_that_is_no_terminal_is_written_as_it_is() -> None:
    stream = io.StringIO()
    screen = Screen(SimulatedClock(), stream, stream)
    screen.silence()
    screen.ask("Mass: ")
    screen.listened()
    assert not screen.has_status
    screen.status("busy")
    screen.say("words")
    assert stream.getvalue().endswith("words\n")
    assert "busy" not in stream.getvalue()
    outlet = Outlet(None)
    outlet.put("words")
    assert (outlet.pending, outlet.trouble) == (False, None)


def test_what_the_encoding_lacks_is_escaped() -> None:
    reading, writing = os.pipe()
    with os.fdopen(writing, "w", encoding="ascii") as stream:
        screen = Screen(SimulatedClock(), stream, stream)
        screen.status("busy")
        screen.say("Jürgen ☃")
    assert os.read(reading, 100) == b"J\\xfcrgen \\u2603\n"
    os.close(reading)


def test_a_stopped_terminal_takes_no_time_and_gets_everything_later(
    terminal: Terminal, screen: Screen
) -> None:
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


def test_what_is_queued_is_bounded(terminal: Terminal, screen: Screen) -> None:
    terminal.stall()
    for _ in range(QUEUE_BYTES // 1000 + 100):
        screen.say("x" * 1000)
    assert len(screen._err._pending) <= QUEUE_BYTES


def test_draining_ends_after_its_patience_in_simulated_time(
    terminal: Terminal, screen: Screen
) -> None:
    clock = screen._clock
    terminal.stall()
    screen.say("never shown")
    assert not screen.drain()
    assert clock.now_ns() == round(DRAIN_S * 1e9)


def test_a_pipe_that_nobody_reads_takes_no_time() -> None:
    reading, writing = os.pipe()
    stream = os.fdopen(writing, "w", encoding="utf-8")
    screen = Screen(SimulatedClock(), stream, stream)
    began = time.monotonic()
    for _ in range(300):
        screen.say("x" * 1000)
    assert time.monotonic() - began < 1.0
    os.close(reading)
    screen.say("after the reader is gone")
    assert isinstance(screen._err.trouble, BrokenPipeError)
    screen.close()
    stream.close()


def test_a_full_device_is_noted_and_raises_nothing() -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        screen = Screen(SimulatedClock(), full, full)
        screen.say("lost", err=False)
        assert screen.trouble is not None
        assert screen.trouble.strerror == "No space left on device"
        screen.close()


def test_a_hung_up_terminal_raises_nothing() -> None:
    terminal = Terminal()
    screen = Screen(SimulatedClock(), terminal.stream, terminal.stream)
    os.close(terminal.master)
    screen.say("nobody is there")
    screen.status("or here")
    assert screen.drain()
    screen.close()
    terminal.stream.close()
    os.close(terminal.slave)


def test_the_status_line_fits_the_width_and_is_drawn_four_times_a_second(
    terminal: Terminal, screen: Screen
) -> None:
    clock = screen._clock
    terminal.resize(40)
    for number in range(100):
        screen.status(f"{number} " + "x" * 60)
        clock.sleep_until_ns(clock.now_ns() + 10_000_000)
    drawn = [line for line in terminal.shown().split("\r") if line]
    assert len(drawn) == 4
    assert all(len(line.replace("\x1b[J", "")) == 39 for line in drawn)


def test_a_status_line_that_a_narrower_window_broke_is_erased_whole(
    terminal: Terminal, screen: Screen
) -> None:
    screen.status("x" * 79)
    terminal.resize(40)
    screen.say("words")
    assert terminal.shown().endswith("\r\x1b[1A\x1b[Jwords\n")


def test_long_lines_break_between_words_and_tables_stay(terminal: Terminal, screen: Screen) -> None:
    terminal.resize(20)
    screen.say("the drive is de-energised now\na  table  that  is  wider")
    assert terminal.shown() == "the drive is\nde-energised now\na  table  that  is  wider\n"


def test_a_message_beside_another_program_begins_a_line_of_its_own(
    terminal: Terminal, screen: Screen
) -> None:
    screen.share()
    screen.say("guardian: off")
    screen.say("more")
    assert terminal.shown() == "\nguardian: off\n\nmore\n"
    stream = io.StringIO()
    piped = Screen(SimulatedClock(), io.StringIO(), stream)
    piped.share()
    piped.say("guardian: off")
    assert stream.getvalue() == "guardian: off\n"


def test_a_message_after_an_unanswered_prompt_begins_a_line_of_its_own(
    terminal: Terminal, screen: Screen
) -> None:
    screen.ask("Mass: ")
    screen.say("stopped")
    assert terminal.shown() == "Mass: \nstopped\n"
    screen.ask("Mass: ")
    screen.answered()
    screen.say("thank you")
    assert terminal.shown() == "Mass: thank you\n"


def test_the_status_line_is_left_out_while_the_terminal_takes_nothing(
    terminal: Terminal, screen: Screen
) -> None:
    clock = screen._clock
    terminal.stall()
    screen.say("a message")
    pending = len(screen._err._pending)
    clock.sleep_until_ns(10**9)
    screen.status("busy")
    assert len(screen._err._pending) == pending


def echoes(terminal: Terminal) -> bool:
    return bool(termios.tcgetattr(terminal.slave)[3] & termios.ECHO)


def test_keys_are_shown_at_a_prompt_and_after_the_end_and_not_between(
    terminal: Terminal, screen: Screen
) -> None:
    # A screen that was not silenced leaves the keys alone.
    other = Screen(SimulatedClock(), terminal.stream, terminal.stream)
    other.ask("")
    other.listened()
    other.close()
    assert not echoes(terminal)
    Outlet(terminal.stream).echo(True)
    screen.silence()
    assert not echoes(terminal)
    screen.ask("mass: ")
    assert echoes(terminal)
    screen.listened()
    assert not echoes(terminal)
    os.write(terminal.master, b"\x03typed")
    screen.say("stopped: by the operator")
    assert terminal.shown().endswith("mass: \nstopped: by the operator\n")
    screen.close()
    assert echoes(terminal)
