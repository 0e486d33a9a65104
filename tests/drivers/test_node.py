"""NMT, heartbeats, EMCY and process data of the simulated devices, on the wire."""

from __future__ import annotations

import struct

import pytest

from drivers.errors import ObjectAccessError
from drivers.mock.canopen.node import Nmt

from .host import Host, frame


def nmt(host: Host, command: int, node: int = 1) -> None:
    host.bench.bus.send(frame(0x000, bytes([command, node])))


def listen(host: Host, seconds: float) -> list[tuple[int, bytes]]:
    """Everything the host hears in this time."""
    heard = []
    end = host.clock.now_ns() + round(seconds * 1e9)
    while (left := end - host.clock.now_ns()) > 0:
        message = host.bench.bus.recv(left / 1e9)
        if message is not None:
            heard.append((message.arbitration_id, bytes(message.data)))
    return heard


def test_boots_into_pre_operational(host: Host) -> None:
    assert listen(host, 0.01) == [(0x701, b"\0"), (0x702, b"\0")]
    assert host.bench.drive.state is Nmt.PRE_OPERATIONAL


@pytest.mark.parametrize(("command", "state"), [(1, 5), (2, 4), (128, 127)])
@pytest.mark.parametrize("address", [0, 1])
def test_nmt_commands(host: Host, command: int, state: int, address: int) -> None:
    nmt(host, command, address)
    listen(host, 0.001)
    assert host.bench.drive.state == state
    assert host.bench.encoder.state == (state if address == 0 else Nmt.PRE_OPERATIONAL)


@pytest.mark.parametrize(("command", "kept"), [(129, False), (130, True)])
def test_resets_boot_again_and_drop_what_they_should(host: Host, command: int, kept: bool) -> None:
    host.drive.write(0x1017, 0, 20)
    host.drive.write(0x6085, 0, 777)
    nmt(host, command)
    heard = listen(host, 0.1)
    assert heard.count((0x701, b"\0")) == 1
    assert (0x701, b"\x7f") not in heard
    assert (host.drive.read(0x6085) == 777) is kept


def test_heartbeat_producer_keeps_its_period_and_tells_the_state(host: Host) -> None:
    listen(host, 0.01)
    host.drive.write(0x1017, 0, 10)
    assert len([h for h in listen(host, 0.1) if h == (0x701, b"\x7f")]) == 10
    nmt(host, 1)
    assert set(listen(host, 0.05)) == {(0x701, b"\x05")}
    host.drive.write(0x1017, 0, 0)
    assert listen(host, 0.1) == []


def test_heartbeat_watch_starts_with_the_first_heartbeat(host: Host) -> None:
    host.drive.write(0x1016, 1, 0x7F << 16 | 100)
    listen(host, 1.0)
    assert host.drive.read(0x1001) == 0
    host.bench.bus.send(frame(0x77F, b"\x05"))
    assert listen(host, 0.099) == []
    host.bench.bus.send(frame(0x77F, b"\x05"))
    assert listen(host, 0.099) == []
    assert listen(host, 0.01) == [(0x081, struct.pack("<HB5x", 0x8130, 0x11))]
    # One loss, one message; the watch then waits for the next first heartbeat.
    assert listen(host, 1.0) == []


@pytest.mark.parametrize(
    ("behaviour", "state"), [(0, Nmt.PRE_OPERATIONAL), (1, Nmt.OPERATIONAL), (2, Nmt.STOPPED)]
)
def test_error_behaviour_after_heartbeat_loss(host: Host, behaviour: int, state: Nmt) -> None:
    host.drive.write(0x1029, 1, behaviour)
    host.drive.write(0x1016, 1, 0x7F << 16 | 50)
    nmt(host, 1)
    host.bench.bus.send(frame(0x77F, b"\x05"))
    listen(host, 0.2)
    assert host.bench.drive.state is state


def test_error_history_is_newest_first_and_can_only_be_cleared(host: Host) -> None:
    host.bench.drive.emergency(0x2310, 0x02)
    host.bench.drive.emergency(0x4310, 0x08)
    assert host.drive.read(0x1003, 0) == 2
    assert [host.drive.read(0x1003, sub) for sub in (1, 2)] == [0x4310, 0x2310]
    assert host.drive.read(0x1001) == 0x0B
    with pytest.raises(ObjectAccessError, match="06090030"):
        host.drive.write(0x1003, 0, 1)
    host.drive.write(0x1003, 0, 0)
    assert [host.drive.read(0x1003, sub) for sub in (0, 1)] == [0, 0]


def remap(host: Host, index: int, entries: list[int], kind: int, identifier: int) -> None:
    write = host.drive.write
    write(index, 1, 1 << 31 | identifier)
    write(index, 2, kind)
    write(index + 0x200, 0, 0)
    for sub, entry in enumerate(entries, 1):
        write(index + 0x200, sub, entry)
    write(index + 0x200, 0, len(entries))
    write(index, 1, identifier)


def test_a_remapped_pdo_carries_the_new_objects_every_nth_sync(host: Host) -> None:
    listen(host, 0.01)
    remap(host, 0x1800, [0x60410010, 0x60790020], 3, 0x191)
    nmt(host, 1)
    for _ in range(6):
        host.bench.bus.send(frame(0x080))
    assert listen(host, 0.01) == [(0x191, struct.pack("<HI", 0x0250, 60000))] * 2


def test_synchronous_outputs_act_at_the_sync_and_others_at_once(host: Host) -> None:
    remap(host, 0x1400, [0x607A0020], 1, 0x201)
    remap(host, 0x1401, [0x60400010], 255, 0x301)
    nmt(host, 1)
    host.bench.bus.send(frame(0x201, struct.pack("<i", 1234)))
    assert host.drive.read(0x607A) == 0
    host.bench.bus.send(frame(0x080))
    assert host.drive.read(0x607A) == 1234
    host.bench.bus.send(frame(0x301, b"\x06\0"))
    assert host.drive.read(0x6041) & 0x6F == 0x21


def test_event_driven_pdo_reports_changes_and_its_timer(host: Host) -> None:
    listen(host, 0.01)
    remap(host, 0x1800, [0x60410010], 255, 0x181)
    nmt(host, 1)
    host.link.take_frames()
    for _ in range(3):
        host.drive.write(0x6040, 0, 0x06)
    assert [f.data for f in host.link.take_frames() if f.identifier == 0x181] == [b"\x31\x02"]
    host.drive.write(0x1800, 5, 20)
    assert listen(host, 0.101) == [(0x181, b"\x31\x02")] * 5


def test_a_short_pdo_changes_nothing_and_is_reported(host: Host) -> None:
    remap(host, 0x1400, [0x60400010, 0x607A0020], 1, 0x201)
    nmt(host, 1)
    listen(host, 0.01)
    host.bench.bus.send(frame(0x201, b"\x06\0\x01"))
    host.bench.bus.send(frame(0x080))
    heard = dict(listen(host, 0.01))
    assert heard[0x081][:2] == struct.pack("<H", 0x8210)
    assert host.drive.read(0x6041) & 0x6F == 0x40


@pytest.mark.parametrize(
    ("index", "subindex", "value", "code"),
    [
        (0x1A01, 1, 0x50000020, 0x06020000),  # no such object
        (0x1A01, 1, 0x60410510, 0x06090011),  # no such subindex
        (0x1A01, 1, 0x60850020, 0x06040041),  # cannot be mapped
        (0x1A01, 1, 0x60410020, 0x06040041),  # wrong length
        (0x1601, 1, 0x60410010, 0x06040041),  # an input is no output
        (0x1A01, 0, 1, 0x06040041),  # nothing is mapped there yet
        (0x1A00, 1, 0x60640020, 0x08000022),  # the PDO is in use
        (0x1801, 2, 0, 0x06090030),
        (0x1801, 2, 241, 0x06090030),
    ],
)
def test_bad_mappings_are_refused(
    host: Host, index: int, subindex: int, value: int, code: int
) -> None:
    with pytest.raises(ObjectAccessError) as caught:
        host.drive.write(index, subindex, value)
    assert caught.value.code == code


def test_a_mapping_in_use_cannot_change(host: Host) -> None:
    host.drive.write(0x1A01, 1, 0x60640020)
    host.drive.write(0x1A01, 0, 1)
    with pytest.raises(ObjectAccessError, match="08000022"):
        host.drive.write(0x1A01, 1, 0x606C0020)
    with pytest.raises(ObjectAccessError, match="08000022"):
        host.drive.write(0x1800, 1, 0x191)
