"""What every port must do, real or simulated; one joins by giving ``line`` or ``wire``."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from drivers.can.port import FramePort
from drivers.serial_port import BytePort

IDENTIFIER = 0x123
"""The frames of the contract have it."""


@dataclass
class FarLine:
    """A byte port, and what its far end says and hears."""

    port: BytePort
    say: Callable[[bytes], None]
    heard: Callable[[], bytes]


class BytePortContract:
    @pytest.fixture
    def line(self) -> FarLine:
        raise NotImplementedError

    def test_what_is_written_arrives(self, line: FarLine) -> None:
        line.port.write(b"\x90\x02\r\n\x00\xff")
        line.port.write(b"more")
        assert line.heard() == b"\x90\x02\r\n\x00\xffmore"

    def test_what_comes_is_read(self, line: FarLine) -> None:
        line.say(bytes(range(256)))
        assert line.port.read(1.0) == bytes(range(256))
        assert line.port.read(0.0) == b""

    def test_silence_is_no_error(self, line: FarLine) -> None:
        assert line.port.read(0.001) == b""
        assert line.port.read(0.0) == b""
        assert line.port.read(-1.0) == b""

    def test_what_is_discarded_is_never_read(self, line: FarLine) -> None:
        line.say(b"old")
        line.port.discard()
        line.say(b"new")
        assert line.port.read(1.0) == b"new"

    def test_nothing_written_is_nothing(self, line: FarLine) -> None:
        line.port.write(b"")
        assert line.heard() == b""

    def test_a_closed_line_is_an_error_and_closing_again_is_none(self, line: FarLine) -> None:
        line.port.close()
        line.port.close()
        for use in (lambda: line.port.write(b"x"), lambda: line.port.read(0.0), line.port.discard):
            with pytest.raises(OSError, match="closed"):
                use()


@dataclass
class FarBus:
    """A frame port, and what another controller on the bus says and hears of :data:`IDENTIFIER`."""

    port: FramePort
    say: Callable[[bytes], None]
    heard: Callable[[], list[bytes]]


class FramePortContract:
    @pytest.fixture
    def wire(self) -> FarBus:
        raise NotImplementedError

    def test_frames_of_any_length_arrive(self, wire: FarBus) -> None:
        frames = [bytes(range(length)) for length in range(9)]
        for data in frames:
            wire.port.transmit(IDENTIFIER, data)
        assert wire.heard() == frames

    def test_frames_of_any_length_are_collected(self, wire: FarBus) -> None:
        for length in range(9):
            wire.say(bytes(range(0xF0, 0xF0 + length)))
        found = []
        while frames := wire.port.collect(0.1):
            found += frames
        assert [(f.identifier, f.sent) for f in found] == [(IDENTIFIER, False)] * 9
        assert [f.data for f in found] == [bytes(range(0xF0, 0xF0 + length)) for length in range(9)]
        assert [f.time_ns for f in found] == sorted(f.time_ns for f in found)

    def test_silence_is_no_error(self, wire: FarBus) -> None:
        assert not wire.port.collect(0.001)
        assert not wire.port.collect(0.0)

    def test_a_bus_that_is_shut_is_an_error_and_shutting_again_is_none(self, wire: FarBus) -> None:
        wire.port.shutdown()
        wire.port.shutdown()
        with pytest.raises(OSError, match=r"shut|closed"):
            wire.port.transmit(IDENTIFIER, b"")
        with pytest.raises(OSError, match=r"shut|closed"):
            wire.port.collect(0.0)
