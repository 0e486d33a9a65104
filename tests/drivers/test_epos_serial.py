from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.epos.frames import DLE, Frame, FrameDecoder, Opcode, cycle_bits, encode

READ = bytes.fromhex("90 02 60 02 01 B0 30 00 2E 62")
ANSWER = bytes.fromhex("90 02 00 04 00 00 00 00 01 90 90 00 00 9A 5C")

frames = st.builds(
    Frame,
    st.integers(0, 255),
    st.binary(max_size=510).map(lambda data: data if len(data) % 2 == 0 else data[1:]),
)
doubled = st.lists(st.sampled_from([0x90, 0x02, 0x00]), max_size=20).map(bytes)


def test_the_frames_printed_by_the_maker() -> None:
    assert encode(Opcode.READ_OBJECT, bytes.fromhex("01 B0 30 00")) == READ
    assert encode(Opcode.ANSWER, bytes.fromhex("00 00 00 00 01 90 00 00")) == ANSWER
    assert FrameDecoder().feed(READ + ANSWER) == [
        Frame(0x60, bytes.fromhex("01 B0 30 00")),
        Frame(0x00, bytes.fromhex("00 00 00 00 01 90 00 00")),
    ]


def test_odd_data_gets_a_dummy_byte() -> None:
    assert FrameDecoder().feed(encode(0x6A, b"\x01\x02\x03")) == [Frame(0x6A, b"\x01\x02\x03\x00")]


def test_too_much_data_is_refused() -> None:
    with pytest.raises(
        ValueError, match="512 bytes do not fit into a frame, which has at most 510"
    ):
        encode(0, bytes(511))


@given(st.lists(frames, max_size=4), st.data())
def test_frames_survive_any_cutting(sent: list[Frame], data: st.DataObject) -> None:
    stream = b"".join(encode(*frame) for frame in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    decoder = FrameDecoder()
    got = []
    for first, last in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        got += decoder.feed(stream[first:last])
    assert got == sent
    assert decoder.bad == 0


@settings(max_examples=50)
@given(st.one_of(st.binary(max_size=40), doubled), frames)
def test_a_frame_behind_garbage_is_found_at_the_latest_after_another(
    garbage: bytes, frame: Frame
) -> None:
    decoder = FrameDecoder()
    decoder.feed(garbage)
    # What looks like the start of a long frame may swallow the next one or two, no more than its
    # length.
    got = [found for _ in range(600) for found in decoder.feed(encode(*frame))]
    assert got[-1] == frame
    assert len(got) >= 1


@given(frames, st.data())
def test_one_wrong_bit_never_gives_another_frame(frame: Frame, data: st.DataObject) -> None:
    wire = bytearray(encode(*frame))
    bit = data.draw(st.integers(0, 8 * len(wire) - 1))
    wire[bit // 8] ^= 1 << bit % 8
    decoder = FrameDecoder()
    assert all(found == frame for found in decoder.feed(bytes(wire)))


def test_a_broken_frame_is_dropped_and_the_next_is_read() -> None:
    decoder = FrameDecoder()
    assert decoder.feed(READ[:-3] + READ) == [Frame(0x60, bytes.fromhex("01 B0 30 00"))]
    assert decoder.feed(READ[:-1] + b"\x00" + ANSWER) == [
        Frame(0, bytes.fromhex("00 00 00 00 01 90 00 00"))
    ]
    assert decoder.bad >= 2


def test_a_megabaud_line_carries_five_objects_in_two_milliseconds() -> None:
    worst = bytes([DLE]) * 4
    write = len(encode(Opcode.WRITE_OBJECT, b"\x01\x7a\x60\x00" + worst)) + len(
        encode(Opcode.ANSWER, bytes(4))
    )
    read = len(encode(Opcode.READ_OBJECT, b"\x01\x64\x60\x00")) + len(
        encode(Opcode.ANSWER, bytes(4) + worst)
    )
    assert write * 10 <= cycle_bits(1, 0)
    assert read * 10 <= cycle_bits(0, 1)
    assert cycle_bits(1, 4) <= 0.8 * 2000
