"""Ports of simulated devices: taken away, garbled, shared, and in front of a host that does not
read.
"""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterator

import pytest

from benchmarks.adapters import Ports


class Echo:
    """A station that says what it hears, and when asked a lot of it."""

    def __init__(self, times: int = 1) -> None:
        self._times = times

    def receive(self, data: bytes) -> bytes:
        return data * self._times


@pytest.fixture
def ports() -> Iterator[Ports]:
    made = Ports()
    yield made
    made.close()


def test_what_a_host_has_open_fails_once_the_terminal_is_unplugged(ports: Ports) -> None:
    path = ports.open_pty(Echo())
    host = os.open(path, os.O_RDWR | os.O_NOCTTY)
    ports.unplug(path)
    with pytest.raises(OSError) as caught:  # noqa: PT011 - the number is what counts
        os.write(host, b"x")
    assert caught.value.errno == errno.EIO
    os.close(host)


def test_babble_reaches_the_host_and_no_station_has_said_it(ports: Ports) -> None:
    path = ports.open_pty(Echo())
    host = os.open(path, os.O_RDWR | os.O_NOCTTY)
    ports.babble(path, b"noise")
    assert os.read(host, 100) == b"noise"
    assert ports.traffic[path].given == 0
    os.close(host)


def test_a_host_that_does_not_read_holds_nobody_up(ports: Ports) -> None:
    path = ports.open_pty(Echo(1_000_000))
    host = os.open(path, os.O_RDWR | os.O_NOCTTY)
    os.write(host, b"x")
    ports.serve(ports.wait(10.0))
    os.write(host, b"y")
    ports.serve(ports.wait(10.0))
    assert ports.traffic[path].taken == 2
    os.close(host)


def test_a_server_serves_every_connection_until_it_is_unplugged(ports: Ports) -> None:
    number = ports.open_server(Echo)
    hosts = [socket.create_connection(("127.0.0.1", number)) for _ in range(2)]
    for _ in hosts:
        ports.serve(ports.wait(10.0))
    for text, host in zip((b"one", b"two"), hosts, strict=True):
        host.sendall(text)
        ports.serve(ports.wait(10.0))
        assert host.recv(100) == text
    ports.unplug(number)
    assert [host.recv(100) for host in hosts] == [b"", b""]
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", number))
    for host in hosts:
        host.close()
