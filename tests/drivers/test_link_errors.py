"""Whatever a port raises, a link raises nothing but DeviceError, and closing it raises nothing."""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any
from unittest.mock import Mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.amt21.encoder import COUNTS_PER_TURN, Amt21Encoder, Amt21Line, EncoderLink
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.link import CanopenLink
from drivers.clock import NS, SimulatedClock
from drivers.dbc.bind import bind
from drivers.dbc.file import read_dbc
from drivers.dbc.link import DbcLink
from drivers.dbc.servo import DbcServo
from drivers.epos.frames import Opcode, encode
from drivers.epos.link import EposSerialLink
from drivers.errors import DeviceError, LinkError
from drivers.interfaces import Link, RawFrame, Servo
from drivers.mock.bench import DRIVE_NODE, simulated_bench, simulated_dbc_bench
from drivers.mock.dbc_drive import DRIVE_DBC
from drivers.mock.drive import DRIVE_EDS, SimulatedEposPort
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.wires.serial_line import SimulatedLine
from drivers.port_errors import close_all, is_gone, os_errors, words
from drivers.units import EncoderScales

from .dbc_host import DRIVE, MAP
from .host import SCALES
from .library_errors import ERRORS, name, of_a_socket
from .serial_host import GATE

Make = Callable[[], BaseException]


class Broken:
    """A port that lets out whatever its library raises."""

    def __init__(self, inner: Any, make: Make, good: int = 0) -> None:
        self.inner = inner
        self.left = good
        self.made = 0
        self.opened = self.closed = 0
        self._make = make

    def open(self) -> Broken:
        self.opened += 1
        return self

    def _pass(self, method: str, *args: object) -> Any:
        if self.left <= 0:
            self.made += 1
            raise self._make()
        self.left -= 1
        return getattr(self.inner, method)(*args)

    def write(self, data: bytes) -> None:
        self._pass("write", data)

    def read(self, timeout_s: float) -> bytes:
        return self._pass("read", timeout_s)

    def discard(self) -> None:
        self._pass("discard")

    def transmit(self, identifier: int, data: bytes) -> None:
        self._pass("transmit", identifier, data)

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        return self._pass("collect", timeout_s)

    def close(self) -> None:
        self.closed += 1
        self._pass("close")

    shutdown = close


@dataclass
class Bench:
    link: Link
    servo: Servo | None
    uses: dict[str, Callable[[], object]]
    port: Broken


def canopen(make: Make, good: int = 0) -> Bench:
    simulated = simulated_bench(Machine(), 1)
    port = Broken(simulated.bus, make, good)
    link = CanopenLink(simulated.clock, port.open, "CAN")
    node = link.add_node(DRIVE_NODE, DRIVE_EDS)
    uses = {
        "exchange": link.exchange,
        "send": lambda: link.send(0x123, b""),
        "heartbeat": link.heartbeat,
        "pump": lambda: link.pump(lambda: False, 0.01),
        "read": lambda: node.read(0x6041),
        "read_text": lambda: node.read_text(0x1008),
        "write": lambda: node.write(0x6040, 0, 0),
        "insist": lambda: node.insist(0x6040, 0, 0),
        "map": lambda: node.map_process_data([], [], 0.001),
        "watch": lambda: node.watch(0.1),
        "unwatch": node.unwatch,
    }
    return Bench(link, Cia402Servo(node, link, SCALES), uses, port)


def dbc(make: Make, good: int = 0) -> Bench:
    simulated = simulated_dbc_bench(Machine(), 1, 1_000_000)
    port = Broken(simulated.bus, make, good)
    link = DbcLink(simulated.clock, port.open, "CAN")
    channel = link.add_channel(bind(MAP, read_dbc(DRIVE_DBC)), "the house servo")
    servo = DbcServo(link, channel, DRIVE)
    slot = next(iter(channel.slots.values()))
    uses = {
        "exchange": link.exchange,
        "send": lambda: link.send(0x123, b""),
        "command": lambda: link.command(channel),
        "await": lambda: link.await_frame(channel, slot, 0.01),
        "state": servo.state,
        "disable": servo.disable,
        "quick stop": servo.quick_stop,
    }
    return Bench(link, servo, uses, port)


def epos_line() -> SimulatedLine:
    simulated = simulated_bench(Machine(), 1)
    station = SimulatedEposPort(simulated.bus, simulated.clock, simulated.drive)
    return SimulatedLine(simulated.clock, 1_000_000, station)


def epos(make: Make, good: int = 0) -> Bench:
    line = epos_line()
    port = Broken(line, make, good)
    link = EposSerialLink(line._clock, port.open, "EPOS4")
    node = link.add_node(DRIVE_NODE, DRIVE_EDS)
    uses = {
        "set_cycle": lambda: link.set_cycle(0.002, "node 1"),
        "read": lambda: node.read(0x6041),
        "read_bytes": lambda: node.read_bytes(0x1008),
        "write": lambda: node.write(0x6040, 0, 0),
        "insist": lambda: node.insist(0x6040, 0, 0),
        "map": lambda: node.map_process_data([], [], 0.002),
    }
    return Bench(link, Cia402Servo(node, link, SCALES), uses, port)


def amt21(make: Make, good: int = 0) -> Bench:
    clock = SimulatedClock()
    port = Broken(SimulatedLine(clock, 2_000_000, Mock(receive=lambda _data: b"")), make, good)
    line = Amt21Line(clock, port.open, "AMT21")
    uses = {"find_echo": line.find_echo, "ask": line.ask, "collect": line.collect}
    return Bench(line, None, uses, port)  # type: ignore[arg-type]


LINKS = (canopen, dbc, epos, amt21)
SERVO_LINKS = (canopen, dbc, epos)


def converted(make: Callable[[], Exception]) -> OSError:
    """Return an error as a port raises it."""

    @os_errors
    def fail() -> None:
        raise make()

    try:
        fail()
    except OSError as error:
        return error
    raise AssertionError("no error")


def test_a_socket_that_lost_its_adapter_is_gone() -> None:
    numbers = (errno.ENODEV, errno.ENXIO, errno.ENOBUFS)
    assert [is_gone(converted(lambda n=n: of_a_socket(n))) for n in numbers] == [True, True, False]


@pytest.mark.parametrize("make", ERRORS, ids=name)
@pytest.mark.parametrize("kind", LINKS)
def test_every_method_turns_it_into_a_link_error_with_cause_and_remedy(kind, make):
    bench = kind(make)
    bench.link.open()
    for what, use in bench.uses.items():
        failed = bench.port.made
        with pytest.raises(
            LinkError, match=r"(is gone|cannot send a frame|cannot receive frames): \S.*; check"
        ) as caught:
            use()
        assert bench.port.made > failed, what
        assert isinstance(caught.value.__cause__, type(make()))
    bench.link.take_frames()
    bench.link.close()
    bench.link.close()
    # A port that is dead is closed, and opened again at the next use.
    assert bench.port.closed == bench.port.opened
    assert (bench.port.opened > 1) is (is_gone(make()) and kind is not amt21)


def lived(bench: Bench) -> None:
    """Do what a short run does, in which each step fails or not."""
    link, servo = bench.link, bench.servo
    link.open()
    with suppress(DeviceError):
        servo.prepare(0.002)
        servo.enable()
        for _ in range(5):
            link.exchange()
    for step in (servo.quick_stop, link.exchange, servo.disable, servo.state):
        with suppress(DeviceError):
            step()
    link.take_frames()
    link.close()
    link.close()


@pytest.mark.parametrize("kind", SERVO_LINKS)
def test_a_port_that_breaks_at_any_call_leaves_nothing_but_device_errors(kind):
    whole = kind(AssertionError, good=1 << 30)
    lived(whole)
    calls = (1 << 30) - whole.port.left

    @settings(max_examples=40)
    @given(st.integers(0, calls), st.sampled_from(ERRORS))
    def breaks(good: int, make: Callable[[], Exception]) -> None:
        bench = kind(make, good)
        lived(bench)
        assert bench.port.closed == bench.port.opened >= 1
        assert bench.port.made or good == calls

    breaks()


@pytest.mark.parametrize("make", ERRORS, ids=name)
@pytest.mark.parametrize("kind", [CanopenLink, EposSerialLink, Amt21Line])
def test_whatever_opening_raises_is_a_link_error(kind, make):
    made = kind(SimulatedClock(), Mock(side_effect=make()), "port")
    with pytest.raises(LinkError, match=r"^port cannot be opened: \S.*; check the ") as caught:
        made.open()
    assert isinstance(caught.value.__cause__, type(make()))
    made.close()


@pytest.mark.parametrize("error", [LinkError("no such port"), KeyboardInterrupt()])
def test_where_the_encoder_cannot_be_opened_the_drive_is_closed(error: BaseException) -> None:
    servo_link, line = Mock(), Mock(address=0x54)
    servo_link.close.side_effect, line.open.side_effect = OSError(5), error
    with pytest.raises(type(error)) as caught:
        EncoderLink(servo_link, Amt21Encoder(line, EncoderScales(COUNTS_PER_TURN), GATE)).open()
    assert caught.value is error
    servo_link.close.assert_called_once()


def test_every_drive_is_sent_its_stop_frame_even_where_one_cannot_be_sent() -> None:
    port = Mock(collect=lambda _timeout_s: ())
    port.transmit.side_effect = [ValueError(), None]
    port.shutdown.side_effect = TypeError
    link = DbcLink(SimulatedClock(), lambda: port, "CAN")
    channels = [link.add_channel(bind(MAP, read_dbc(DRIVE_DBC)), f"drive {n}") for n in range(2)]
    link._channels = link._channels[:1]
    link.open()
    link._channels = tuple(channels)
    for channel in channels:
        channel.commanded = True
    link.close()
    stop = channels[0].wiring.stop_message.identifier
    assert [call.args[0] for call in port.transmit.call_args_list] == [stop, stop]
    port.shutdown.assert_called_once()


class Babble:
    """A line that never falls silent."""

    def __init__(self, clock: SimulatedClock, pieces: Sequence[bytes]) -> None:
        self.reads = 0
        self._clock = clock
        self._pieces = pieces

    def write(self, _data: bytes) -> None:
        """Nobody listens."""

    def read(self, _timeout_s: float) -> bytes:
        self._clock.sleep_until_ns(self._clock.now_ns() + NS // 200)
        self.reads += 1
        return self._pieces[self.reads % len(self._pieces)]

    def discard(self) -> None:
        """There is more where that came from."""

    def close(self) -> None:
        """Nothing to close."""


PIECES = st.lists(
    st.one_of(
        st.binary(min_size=1, max_size=40),
        st.sampled_from([b"\x90\x02", b"\x90\x02\x00\x02" + bytes(6)]),
    ),
    min_size=1,
    max_size=5,
)


@settings(max_examples=40)
@given(PIECES)
def test_a_serial_line_that_babbles_is_a_link_error_in_time(pieces: list[bytes]) -> None:
    clock = SimulatedClock()
    link = EposSerialLink(clock, lambda: Babble(clock, pieces), "EPOS4")
    node = link.add_node(1, DRIVE_EDS)
    link.open()
    with pytest.raises(DeviceError):
        node.read(0x6041)
    assert clock.now_ns() < 2 * NS
    with suppress(DeviceError):
        link.exchange()
    line = Amt21Line(clock, lambda: Babble(clock, pieces), "AMT21")
    line.open()
    with suppress(LinkError):
        line.find_echo()
    for _ in range(3):
        line.ask()
        line.collect()
    assert clock.now_ns() < 3 * NS
    assert len(link.take_frames()) + len(line.take_frames()) > 0


def test_good_frames_without_end_are_no_answer_either() -> None:
    """Whole frames of another content must not keep up the search for the drive for ever."""
    line = epos_line()
    clock = line._clock
    link = EposSerialLink(clock, lambda: line, "EPOS4")
    node = link.add_node(DRIVE_NODE, DRIVE_EDS)
    link.open()
    link.set_cycle(0.002, "node 1")
    link._port = Babble(clock, [encode(Opcode.ANSWER, bytes(8))])
    link._in_step = False
    began = clock.now_ns()
    with pytest.raises(LinkError, match="no correct answer"):
        node.read(0x6041)
    assert clock.now_ns() - began < 2 * NS


def test_answers_to_other_requests_without_end_are_none_to_this_one() -> None:
    late = RawFrame(0, 0x581, bytes.fromhex("4364600001000000"), False)
    link = CanopenLink(SimulatedClock(), lambda: Mock(collect=lambda _timeout_s: (late,)), "CAN")
    node = link.add_node(1, DRIVE_EDS)
    link.open()
    with pytest.raises(LinkError, match=r"object 6041h:00h: the first 64 SDO responses belong to"):
        node.read(0x6041)
    link.close()


def raising(error: BaseException) -> Callable[..., None]:
    def action(*_args: object) -> None:
        raise error

    return action


@pytest.mark.parametrize("make", ERRORS, ids=name)
def test_only_os_errors_get_out_and_they_have_words(make: Callable[[], Exception]) -> None:
    error = make()
    with pytest.raises(OSError, match=r"\w") as caught:
        os_errors(raising(error))()
    assert caught.value is error or caught.value.__cause__ is error
    assert words(caught.value) == words(error) or isinstance(error, OSError)


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_who_ends_the_program_is_not_held_up(error: type[BaseException]) -> None:
    with pytest.raises(error):
        os_errors(raising(error()))()


def test_words_name_the_type_where_the_text_is_no_sentence() -> None:
    assert words(KeyError(12)) == "KeyError: 12"
    assert words(NotImplementedError()) == "NotImplementedError"
    assert words(OSError(5, "Input/output error")) == "[Errno 5] Input/output error"
    assert words(OSError()) == "OSError"


@pytest.mark.parametrize("make", ERRORS, ids=name)
def test_everything_is_closed_whatever_closing_raises(make: Callable[[], Exception]) -> None:
    closed: list[int] = []
    close_all(raising(make()), lambda: closed.append(1), raising(make()), lambda: closed.append(2))
    assert closed == [1, 2]
    with pytest.raises(KeyboardInterrupt):
        close_all(raising(KeyboardInterrupt()), lambda: closed.append(3), raising(make()))
    assert closed == [1, 2, 3]


def test_a_traceback_inside_a_message_is_left_out() -> None:
    error = OSError("Failed to receive: bad byte  Traceback (most recent call last):\n  File x")
    assert words(error) == "Failed to receive: bad byte"
    assert words(ValueError("\n  second\n")) == "ValueError: second"
