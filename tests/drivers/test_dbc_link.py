from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.dbc.bind import bind
from drivers.dbc.file import read_dbc
from drivers.dbc.link import DbcLink
from drivers.errors import ConfigurationError, DriveFault
from drivers.mock.dbc_drive import DRIVE_DBC, State
from drivers.mock.encoder import ENCODER_EDS

from .dbc_host import MAP, DbcHost, enabled, make_dbc_host, prepared

COMMAND, MOTION, POWER, STATUS, STOP = 0x110, 0x190, 0x191, 0x1A0, 0x010


@pytest.fixture
def host(dbc: DbcHost) -> DbcHost:
    return dbc


@pytest.mark.parametrize("identifier", [MOTION, POWER, COMMAND])
def test_a_lost_frame_makes_one_sample_stale(host: DbcHost, identifier: int) -> None:
    enabled(host)
    host.cycles(5)
    assert host.servo.sample().fresh
    host.lose(identifier, 1)
    host.cycles(1)
    assert not host.servo.sample().fresh
    host.cycles(1)
    assert host.servo.sample().fresh


def test_an_answer_of_the_cycle_before_is_not_taken_for_this_one(host: DbcHost) -> None:
    """It lies in the receive buffer when the exchange begins."""
    enabled(host)
    host.cycles(5)
    host.bench.drive._tell_power()
    seen: list[bytes] = []

    def keep_first(_time: int, found: int, data: bytes, _sent: bool) -> tuple[int, bytes] | None:
        if found == POWER:
            seen.append(data)
        return None if len(seen) > 1 and found == POWER else (found, data)

    host.bench.bus.frame_filters.append(keep_first)
    host.cycles(1)
    assert len(seen) == 2
    assert host.channel.slots[POWER].data == seen[0]
    assert not host.servo.sample().fresh


def test_command_and_sync_leave_together(host: DbcHost) -> None:
    prepared(host)
    host.cycles(3)
    host.link.take_frames()
    host.cycles(1)
    sent = [frame.identifier for frame in host.link.take_frames() if frame.sent]
    assert sent[:2] == [COMMAND, 0x080]


def test_closing_sends_the_stop_frame(host: DbcHost) -> None:
    enabled(host)
    host.cycles(3)
    host.link.take_frames()
    host.link.close()
    assert [(f.identifier, f.data) for f in host.link.take_frames() if f.sent] == [(STOP, b"\xa5")]
    host.wait(0.1)
    assert host.bench.drive.state is State.OFF
    assert not host.powered[-1]


def test_a_bus_that_was_only_listened_to_is_left_alone(host: DbcHost) -> None:
    host.servo.state()
    host.servo.identity()
    host.servo.read_limits()
    host.link.close()
    assert not [frame for frame in host.link.take_frames() if frame.sent]


def test_a_fault_while_running_is_raised_once(host: DbcHost) -> None:
    enabled(host)
    host.cycles(10)
    host.bench.drive.fail(0x42)
    with pytest.raises(DriveFault, match="0042h: the house servo is in fault") as caught:
        host.cycles(3)
    assert caught.value.code == 0x42
    host.cycles(50)
    assert host.bench.drive.state is State.FAULT


@pytest.mark.parametrize(
    ("change", "owner"),
    [
        ((" 400 ", " 386 "), "CANopen node 2"),
        ((" 272 ", " 128 "), "SYNC"),
        ((" 400 ", " 1919 "), "CANopen node 127"),
    ],
)
def test_identifiers_may_not_collide(
    host: DbcHost, tmp_path, change: tuple[str, str], owner: str
) -> None:
    path = tmp_path / "moved.dbc"
    path.write_text(DRIVE_DBC.read_text().replace(*change))
    link = DbcLink(host.clock, lambda: host.bench.bus, "simulated bus")
    link.add_node(2, ENCODER_EDS)
    link.add_channel(bind(MAP, read_dbc(path)), "the drive")
    with pytest.raises(ConfigurationError, match=f"the drive and {owner} both use the CAN identi"):
        link.open()


def test_a_command_may_go_less_often_than_the_cycle() -> None:
    messages = {**MAP.messages, "DRV_Command": replace(MAP.messages["DRV_Command"], period_ms=4)}
    # Then the drive answers as seldom, and the map says so.
    for name in ("DRV_Motion", "DRV_Power"):
        messages[name] = replace(messages[name], period_ms=4)
    host = make_dbc_host(spec=replace(MAP, messages=messages))
    enabled(host)
    host.link.take_frames()
    for _ in range(40):
        host.cycles(1, lambda t: 0.01)
        assert host.servo.sample().fresh
    assert sum(frame.identifier == COMMAND for frame in host.link.take_frames()) == 10
