"""The LAWICEL protocol: its decoder against anything, and the port behind a bad line."""

from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.can import slcan
from drivers.can.port import EXTENDED_FLAG, REMOTE_FLAG
from drivers.can.slcan import SlcanPort
from drivers.canopen.link import CanopenLink
from drivers.clock import NS, RealClock, SimulatedClock
from drivers.errors import LinkError

from .pty_line import Pty, pty_line

FRAMES = st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8))
PIECES = st.one_of(
    st.binary(max_size=80),
    FRAMES.map(lambda frame: slcan.encode(*frame)),
    st.sampled_from(
        [b"\r", b"\a", b"z\r", b"Z\r", b"t\r", b"t181", b"r1230\r", b"F00\r", b"t12310x\r"]
    ),
)


def decoded(*pieces: bytes) -> tuple[list[tuple[int, bytes]], int]:
    decoder = slcan.LineDecoder()
    return [frame for piece in pieces for frame in decoder.feed(piece)], decoder.bad


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (b"t1230\r", (0x123, b"")),
        (b"t7ff2aBcD\r", (0x7FF, b"\xab\xcd")),
        (b"t1231AA0F3C\r", (0x123, b"\xaa")),
        (b"T000001231AA\r", (0x123 | EXTENDED_FLAG, b"\xaa")),
        (b"T1FFFFFFF0\r", (0x1FFFFFFF | EXTENDED_FLAG, b"")),
        (b"r1238\r", (0x123 | REMOTE_FLAG, b"")),
        (b"R000001230\r", (0x123 | EXTENDED_FLAG | REMOTE_FLAG, b"")),
        (b"R0000012300F3C\r", (0x123 | EXTENDED_FLAG | REMOTE_FLAG, b"")),
    ],
)
def test_lines_that_are_frames(line: bytes, frame: tuple[int, bytes]) -> None:
    assert decoded(line) == ([frame], 0)


@pytest.mark.parametrize(
    "line",
    [
        *b"t t123 t12 t8000 t-120 t1_20 t1232AAB t1232AA t1231AABB t1231AA0F3C4 t123x".split(),
        *b"T200000000 T1230 r1231AA d1231AA x000001230 t1230t1230 V1013".split(),
        *(b"t 120", b"t1231A B", b"t1231AA\n", b"\xfft1230", b"\xd9\xa3"),
        *(b"t1239" + b"00" * 9, b"t1230" + b"0" * 100),
    ],
)
@pytest.mark.parametrize("end", [b"\r", b"\a"])
def test_a_line_that_is_no_frame_is_counted_and_the_next_is_read(line: bytes, end: bytes) -> None:
    assert decoded(line + end + b"t1231AA\r") == ([(0x123, b"\xaa")], 1)


def test_answers_to_commands_are_neither_frames_nor_bad() -> None:
    assert decoded(b"\r\a\rz\rZ\r\az\r") == ([], 0)


@given(st.lists(PIECES, max_size=20), st.lists(st.integers(0, 400), max_size=8))
def test_any_bytes_give_the_same_however_they_come(pieces: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(pieces)
    ends = sorted({min(cut, len(stream)) for cut in cuts} | {0, len(stream)})
    frames, bad = decoded(*[stream[a:b] for a, b in pairwise(ends)])
    assert (frames, bad) == decoded(stream)
    assert bad <= stream.count(b"\r") + stream.count(b"\a")
    for identifier, data in frames:
        assert 0 <= identifier < 1 << 32
        assert len(data) <= 8


@given(st.binary(), st.lists(FRAMES, max_size=5))
def test_after_any_bytes_and_one_end_of_line_everything_good_is_read(garbage, good):
    decoder = slcan.LineDecoder()
    decoder.feed(garbage + b"\r")
    assert decoder.feed(b"".join(slcan.encode(*frame) for frame in good)) == good


def test_a_line_without_end_takes_no_memory() -> None:
    decoder = slcan.LineDecoder()
    for _ in range(1000):
        decoder.feed(b"t1" * 500)
    assert len(decoder._rest) <= slcan.MAX_LINE
    assert decoder.feed(b"\rt1230\r") == [(0x123, b"")]
    assert decoder.bad == 1


class Script:
    """A byte port that reads what it is given, piece by piece, and keeps what is written."""

    def __init__(self, clock: SimulatedClock) -> None:
        self.pieces: list[bytes] = []
        self.written: list[bytes] = []
        self.closed = 0
        self.endless = b""
        self._clock = clock

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def read(self, timeout_s: float) -> bytes:
        if self.pieces:
            return self.pieces.pop(0)
        if self.endless:
            self._clock.sleep_until_ns(self._clock.now_ns() + 1000)
            return self.endless
        self._clock.sleep_until_ns(self._clock.now_ns() + round(timeout_s * NS))
        return b""

    def discard(self) -> None:
        self.pieces.clear()

    def close(self) -> None:
        self.closed += 1


def test_the_channel_is_closed_set_up_and_opened() -> None:
    clock = SimulatedClock()
    line = Script(clock)
    line.pieces = [b"t7", b"FF0\r"]
    port = SlcanPort(line, clock, 500_000)
    assert b"".join(line.written) == b"C\rC\rS6\rO\r"
    assert port.collect(0.0) == []
    port.shutdown()
    assert line.written[-1] == b"C\r"
    assert line.closed == 1


def test_a_frame_in_pieces_is_waited_for_and_stamped_when_it_is_whole() -> None:
    clock = SimulatedClock()
    line = Script(clock)
    port = SlcanPort(line, clock, 1_000_000)
    line.pieces = [b"t12", b"31", b"AA\rt1", b"240\r"]
    first = port.collect(1.0)
    assert [(f.identifier, f.data) for f in first] == [(0x123, b"\xaa")]
    assert [(f.identifier, f.data) for f in port.collect(1.0)] == [(0x124, b"")]
    assert clock.now_ns() == 0
    assert port.collect(0.5) == []
    assert clock.now_ns() == NS // 2


@given(st.binary(min_size=1, max_size=30))
def test_a_line_that_never_falls_silent_does_not_hold_the_loop(garbage: bytes) -> None:
    clock = SimulatedClock()
    line = Script(clock)
    port = SlcanPort(line, clock, 1_000_000)
    line.endless = garbage
    port.collect(0.001)
    assert clock.now_ns() <= NS // 1000 + 1000


@pytest.fixture
def adapter() -> Iterator[Pty]:
    with pty_line() as far:
        yield far


def slcan_link(path: str) -> CanopenLink:
    return CanopenLink.on_interface(RealClock(), "slcan", path, 1_000_000, {"sleep_after_open": 0})


def test_an_adapter_that_is_pulled_out_is_a_link_error(adapter: Pty) -> None:
    link = slcan_link(adapter.path)
    link.open()
    adapter.hang_up()
    with pytest.raises(LinkError, match=r"cannot receive frames: the adapter was unplugged"):
        link.pump(lambda: False, 1.0)
    for _ in range(2):
        with pytest.raises(LinkError, match=r"cannot be opened: .*No such file"):
            link.pump(lambda: False, 1.0)
        with pytest.raises(LinkError, match=r"cannot be opened: .*No such file"):
            link.send(0x601, bytes(8))
    link.close()
    link.close()


def test_an_adapter_that_cannot_be_set_up_is_closed_again(adapter: Pty) -> None:
    with pytest.raises(
        LinkError, match="cannot be opened: an slcan adapter does not support 33333 bit/s"
    ):
        CanopenLink.on_interface(
            RealClock(), "slcan", adapter.path, 33_333, {"sleep_after_open": 0}
        ).open()
    for option in ({"btr": "031C"}, {"tty_baudrate": "fast"}):
        with pytest.raises(
            LinkError, match=r"cannot be opened: (Type|Value)Error: .*; check the interface"
        ):
            CanopenLink.on_interface(RealClock(), "slcan", adapter.path, 1_000_000, option).open()
    link = slcan_link(f"{adapter.path}@9600")
    link.open()
    link.close()
