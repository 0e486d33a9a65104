"""NMT, heartbeats, EMCY and process data of the simulated devices, on the wire."""

import struct

import pytest

from drivers.errors import ObjectAccessError

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
        (0x1A01, 1, 0x60850020, 0x06040041),  # cannot be mapped
        (0x1A01, 1, 0x60410020, 0x06040041),  # wrong length
        (0x1601, 1, 0x60410010, 0x06040041),  # an input is no output
        (0x1A00, 1, 0x60640020, 0x08000022),  # the PDO is in use
        (0x1801, 2, 241, 0x06090030),
    ],
)
def test_bad_mappings_are_refused(host, index, subindex, value, code):
    with pytest.raises(ObjectAccessError) as caught:
        host.drive.write(index, subindex, value)
    assert caught.value.code == code
