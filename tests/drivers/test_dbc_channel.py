"""Counters, checksums and freshness, without a bus."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.dbc.bind import bind
from drivers.dbc.channel import DbcChannel
from drivers.dbc.codec import crc8_j1850
from drivers.dbc.file import read_dbc
from drivers.errors import DriveFault
from drivers.interfaces import ServoState
from drivers.mock.dbc_drive import DRIVE_DBC

from .dbc_host import MAP

WIRING = bind(MAP, read_dbc(DRIVE_DBC))
MOTION, POWER, STATUS = 0x190, 0x191, 0x1A0
OFF, RUN, FAULT = 0, 2, 5


def guarded(body: bytes) -> bytes:
    return body + bytes([crc8_j1850(body + b"\0")])


def motion(life: int, state: int = RUN) -> bytes:
    return guarded(bytes(6) + bytes([state | (life & 15) << 4]))


@pytest.fixture
def channel() -> DbcChannel:
    made = DbcChannel(WIRING, "the drive")
    made.set_cycle(0.001)
    return made


def cycle(channel: DbcChannel, number: int, *frames: tuple[int, bytes]) -> None:
    """Run exchange ``number``, from 1; status comes every hundredth."""
    channel.begin(number * 1_000_000)
    if number % 100 == 1:
        channel.receive(
            channel.slots[STATUS],
            guarded(bytes([0, 0, 0, 0, (number // 100 & 15) << 4])),
            number * 10**6,
        )
    for identifier, data in frames:
        channel.receive(channel.slots[identifier], data, number * 1_000_000)


def whole(number: int) -> tuple[tuple[int, bytes], ...]:
    return (MOTION, motion(number)), (POWER, bytes(7) + bytes([(number & 15) << 4]))


def test_a_whole_answer_is_fresh_for_as_long_as_it_comes(channel: DbcChannel) -> None:
    for number in range(1, 300):
        cycle(channel, number, *whole(number))
        assert channel.fresh
    cycle(channel, 300)
    assert not channel.fresh
    cycle(channel, 301, *whole(301))
    assert channel.fresh


def test_a_message_on_its_own_period_ages(channel: DbcChannel) -> None:
    cycle(channel, 1, *whole(1))
    for number in range(2, 252):
        channel.begin(number * 1_000_000)
        for identifier, data in whole(number):
            channel.receive(channel.slots[identifier], data, number * 1_000_000)
        assert channel.fresh is (number <= 251)
    channel.begin(252 * 1_000_000)
    for identifier, data in whole(252):
        channel.receive(channel.slots[identifier], data, 252 * 1_000_000)
    assert not channel.fresh


@pytest.mark.parametrize(
    "bad",
    [
        motion(1),  # the counter stands still
        motion(0),  # or runs backwards
        motion(2)[:7],
        motion(2) + b"\0",
        motion(2)[:7] + bytes([motion(2)[7] ^ 1]),
        b"",
    ],
    ids=["still", "backwards", "short", "long", "checksum", "empty"],
)
def test_a_bad_frame_updates_nothing(channel: DbcChannel, bad: bytes) -> None:
    cycle(channel, 1, *whole(1))
    slot = channel.slots[MOTION]
    before = slot.data
    cycle(channel, 2, (MOTION, bad), whole(2)[1])
    assert slot.data == before
    assert (slot.count, slot.refused) == (1, 1)
    assert not channel.fresh


@pytest.mark.parametrize("lost", range(8))
def test_frames_that_were_lost_before_do_not_spoil_a_good_one(channel, lost):
    cycle(channel, 1, *whole(1))
    number = 2 + lost
    cycle(channel, number, *whole(number))
    assert channel.fresh


def test_a_drive_that_restarted_its_counter_costs_one_sample(channel: DbcChannel) -> None:
    cycle(channel, 1, (MOTION, motion(5)), whole(1)[1])
    cycle(channel, 2, (MOTION, motion(1)), whole(2)[1])
    assert not channel.fresh
    cycle(channel, 3, (MOTION, motion(2)), whole(3)[1])
    assert channel.fresh


@given(
    frames=st.lists(
        st.tuples(st.sampled_from([MOTION, POWER, STATUS]), st.binary(max_size=8)), max_size=20
    )
)
def test_no_bytes_make_it_fail_and_none_get_past_the_checksum(frames):
    channel = DbcChannel(WIRING, "the drive")
    channel.set_cycle(0.001)
    for number, (identifier, data) in enumerate(frames):
        channel.begin(number)
        slot = channel.slots[identifier]
        before, count = slot.data, slot.count
        channel.receive(slot, data, number)
        if slot.count == count:
            assert slot.data is before
        else:
            assert len(data) == slot.message.size
            if slot.message.checksum is not None:
                assert data[-1] == crc8_j1850(data[:-1] + b"\0")
        assert channel.state is None or isinstance(channel.state, ServoState)


@pytest.mark.parametrize(
    ("state", "faulty"), [(OFF, False), (1, False), (3, False), (FAULT, True), (4, True)]
)
def test_a_drive_that_stopped_by_itself_is_not_asked_to_run_again(channel, state, faulty):
    cycle(channel, 1, *whole(1))
    channel.order(WIRING.enable[ServoState.OPERATION_ENABLED], hold=True)
    channel.settle()
    assert next(iter(channel.frames()))[1][0] & 15 == 2
    cycle(channel, 2, (MOTION, motion(2, state)), whole(2)[1])
    if faulty:
        with pytest.raises(DriveFault, match="the drive is in fault"):
            channel.settle()
    channel.settle()
    assert next(iter(channel.frames()))[1][0] & 15 == 0


def test_a_counter_that_turns_before_its_width() -> None:
    """AUTOSAR's profile 1 counts 0 to 14; 15 stands for no value."""
    motion_guard = replace(MAP.messages["DRV_Motion"], counter_last=14)
    command_guard = replace(MAP.messages["DRV_Command"], counter_last=14)
    messages = {**MAP.messages, "DRV_Motion": motion_guard, "DRV_Command": command_guard}
    channel = DbcChannel(bind(replace(MAP, messages=messages), read_dbc(DRIVE_DBC)), "the drive")
    slot = channel.slots[MOTION]
    for life, good in ((13, True), (14, True), (0, True), (15, False), (1, True), (1, False)):
        count = slot.count
        channel.receive(slot, motion(life), 0)
        assert (slot.count > count) is good, life
    lives = [data[0] >> 4 for _ in range(31) for _, data in channel.frames()]
    assert lives == [(n + 1) % 15 for n in range(31)]
