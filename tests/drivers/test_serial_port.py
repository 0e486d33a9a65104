"""Real serial lines that go wrong: hung up, stalled, held by another program."""

import os
import select
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from unittest.mock import patch

import pytest

from drivers import serial_port
from drivers.serial_port import WRITE_LIMIT_S, InheritedPort, PySerialPort

from .library_errors import ERRORS, name
from .pty_line import Pty, pty_line

SLACK_S = 1.0
"""A busy machine lets a process wait; without a limit all of this would last for ever."""
MORE_THAN_A_LINE_HOLDS = 1 << 20


@dataclass
class Line:
    port: PySerialPort | InheritedPort
    far: Pty


def opened(path: str) -> PySerialPort:
    return PySerialPort(path, 115_200)


def inherited(path: str) -> InheritedPort:
    return InheritedPort(os.open(path, os.O_RDWR | os.O_NOCTTY))


@pytest.fixture(params=[opened, inherited], ids=["PySerialPort", "InheritedPort"])
def line(request: pytest.FixtureRequest) -> Iterator[Line]:
    with pty_line() as far:
        made = Line(request.param(far.path), far)
        yield made
        made.port.close()


def took_s(action: Callable[[], object]) -> float:
    began = time.monotonic()
    action()
    return time.monotonic() - began


USES: tuple[Callable[[Line], object], ...] = (
    lambda line: line.port.write(b"\x90\x02"),
    lambda line: line.port.read(0.0),
    lambda line: line.port.read(5.0),
    lambda line: line.port.discard(),
)


@pytest.mark.parametrize("use", USES, ids=["write", "look", "read", "discard"])
def test_a_line_that_is_hung_up_is_an_error_at_once(line, use):
    line.far.hang_up()
    for _ in range(3):
        began = time.monotonic()
        with pytest.raises(OSError, match=r"unplugged|Input/output error"):
            use(line)
        assert time.monotonic() - began < SLACK_S


def test_a_line_hung_up_while_it_is_read_ends_the_wait(line: Line) -> None:
    def select_then_hang_up(*args: object) -> object:
        line.far.hang_up()
        return select.select(*args)  # type: ignore[call-overload]

    stand_in = SimpleNamespace(select=select_then_hang_up)
    began = time.monotonic()
    with patch.object(serial_port, "select", stand_in), pytest.raises(OSError, match="unplugged"):
        line.port.read(5.0)
    assert time.monotonic() - began < SLACK_S


def test_a_line_that_takes_nothing_is_an_error_within_the_limit(line: Line) -> None:
    began = time.monotonic()
    with pytest.raises(TimeoutError, match=r"the line accepted \d+ of 1048576 bytes within 0\.1 s"):
        line.port.write(bytes(MORE_THAN_A_LINE_HOLDS))
    assert WRITE_LIMIT_S <= time.monotonic() - began < WRITE_LIMIT_S + SLACK_S
    assert took_s(line.port.close) < SLACK_S


def test_a_line_that_takes_bytes_slowly_is_given_the_whole_limit(line: Line) -> None:
    """The far end makes room while the write waits."""
    taken = b""

    def wait(*args: object) -> object:
        nonlocal taken
        while select.select([line.far.ours], [], [], 0)[0]:
            taken += os.read(line.far.ours, 4096)
        return select.select(*args)  # type: ignore[call-overload]

    data = bytes(range(256)) * (MORE_THAN_A_LINE_HOLDS >> 10)
    with patch.object(serial_port, "select", SimpleNamespace(select=wait)):
        line.port.write(data)
    while select.select([line.far.ours], [], [], 0.02)[0]:
        taken += os.read(line.far.ours, 4096)
    assert taken == data


def test_what_a_stalled_line_has_not_taken_is_not_sent_later(line: Line) -> None:
    """An old request must not reach a drive when the line moves again."""
    termios = serial_port.termios
    line.far.stall()
    with (
        patch.object(termios, "tcflush") as flush,
        pytest.raises(TimeoutError, match="accepted 0 of 3 bytes"),
    ):
        line.port.write(b"old")
    flush.assert_called_once_with(line.port.fileno(), termios.TCOFLUSH)


def test_closing_a_line_that_does_not_drain_drops_what_is_left(line: Line) -> None:
    """The kernel itself would wait 30 s for it."""
    termios = serial_port.termios
    pending = SimpleNamespace(ioctl=lambda *_: (7).to_bytes(4, "little"))
    with patch.object(serial_port, "fcntl", pending), patch.object(termios, "tcflush") as flush:
        assert WRITE_LIMIT_S <= took_s(line.port.close) < WRITE_LIMIT_S + SLACK_S
    assert flush.call_args.args[1] == termios.TCOFLUSH


def test_closing_waits_for_what_is_on_its_way(line: Line) -> None:
    left = iter([20, 10, 0])
    draining = SimpleNamespace(ioctl=lambda *_: next(left).to_bytes(4, "little"))
    with (
        patch.object(serial_port, "fcntl", draining),
        patch.object(serial_port.termios, "tcflush") as flush,
    ):
        line.port.close()
    assert next(left, None) is None
    flush.assert_not_called()


def test_a_port_has_one_program() -> None:
    with pty_line() as far:
        first = opened(far.path)
        with pytest.raises(OSError, match=f"{far.path} is used by another program"):
            opened(far.path)
        first.close()
        opened(far.path).close()


def test_ports_that_are_none() -> None:
    with pytest.raises(OSError, match="No such file"):
        opened("/dev/no-such-port")
    with pytest.raises(OSError, match="configure"):
        opened("/dev/null")
    with pytest.raises(OSError, match="baudrate"):
        PySerialPort("/dev/null", -1)
    with pytest.raises(OSError, match="Bad file descriptor"):
        InheritedPort(10_000)


@pytest.mark.parametrize("make", ERRORS, ids=name)
def test_whatever_opening_raises_is_an_os_error(make: Callable[[], Exception]) -> None:
    with (
        patch.object(serial_port.serial, "Serial", side_effect=make()),
        pytest.raises(OSError, match=r"\w"),
    ):
        opened("/dev/ttyUSB0")


@pytest.mark.parametrize("make", ERRORS, ids=name)
def test_whatever_the_system_raises_is_an_os_error(line, make):
    def fail(*_: object) -> None:
        raise make()

    broken = SimpleNamespace(read=fail, write=fail, close=os.close)
    os.write(line.far.ours, b"x")
    with patch.object(serial_port, "os", broken):
        for use in USES[:3]:
            with pytest.raises(OSError, match=r"\w"):
                use(line)
    with patch.object(serial_port.termios, "tcflush", fail), pytest.raises(OSError, match=r"\w"):
        line.port.discard()
    with (
        patch.object(serial_port, "select", SimpleNamespace(select=fail)),
        pytest.raises(OSError, match=r"\w"),
    ):
        line.port.read(1.0)
