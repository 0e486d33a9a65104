"""The port over python-can: what its interfaces raise, say and do not heed."""

import json
import socket
import time
from threading import Thread

import can
import pytest

from drivers.can.port import (
    ERROR_FLAG,
    EXTENDED_FLAG,
    MAX_COLLECTED,
    REMOTE_FLAG,
    SEND_LIMIT_S,
    PythonCanPort,
)
from drivers.canopen.link import CanopenLink
from drivers.clock import RealClock, SimulatedClock
from drivers.errors import LinkError
from drivers.mock.drive import DRIVE_EDS

from .host import frame
from .library_errors import ERRORS, name


class Interface(can.BusABC):
    """An interface whose every part can fail."""

    def __init__(
        self, *messages: can.Message | Exception, on_send: Exception | None = None
    ) -> None:
        super().__init__(channel=0)
        self.messages = list(messages)
        self.on_send = on_send
        self.limits: list[float | None] = []
        self.on_shutdown: Exception | None = None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self.limits.append(timeout)
        if self.on_send is not None:
            raise self.on_send

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.messages:
            return None, False
        message = self.messages.pop(0)
        if isinstance(message, Exception):
            raise message
        return message, False

    def shutdown(self) -> None:
        super().shutdown()
        if self.on_shutdown is not None:
            raise self.on_shutdown


@pytest.mark.parametrize("make", ERRORS, ids=name)
def test_a_link_over_any_interface_raises_link_errors_and_goes_on(make):
    """A message that its backend could not read costs one error; what comes after it is read."""
    bus = Interface(make(), frame(0x701, b"\x05"), on_send=make())
    link = CanopenLink(RealClock(), lambda: PythonCanPort(bus, RealClock()), "CAN at can0")
    node = link.add_node(1, DRIVE_EDS)
    link.open()
    with pytest.raises(LinkError, match=r"can0 cannot receive frames: \S.*; check the interface"):
        link.pump(lambda: False, 1.0)
    with pytest.raises(LinkError, match=r"CAN at can0 cannot send a frame: \S.*; check cabling"):
        link.heartbeat()
    assert link.pump(lambda: node.nmt_state == 5, 1.0)
    bus.on_shutdown = make()
    link.close()
    link.close()


def test_every_frame_is_sent_with_a_time_limit() -> None:
    with Interface() as bus:
        PythonCanPort(bus, SimulatedClock()).transmit(0x123, bytes(8))
        assert bus.limits == [SEND_LIMIT_S]


@pytest.mark.parametrize(
    ("found", "identifier"),
    [
        (can.Message(0, 0x7FF, is_extended_id=False), 0x7FF),
        (can.Message(0, 0x800, is_extended_id=False), 0x800 | EXTENDED_FLAG),
        (can.Message(0, -0x12, is_extended_id=False), 0x1FFFFFEE | EXTENDED_FLAG),
        (can.Message(0, 1 << 40 | 0x12, is_extended_id=False), 0x12 | EXTENDED_FLAG),
        (can.Message(0, 0x12, is_extended_id=True), 0x12 | EXTENDED_FLAG),
        (can.Message(0, 0x12, is_extended_id=False, is_remote_frame=True), 0x12 | REMOTE_FLAG),
        (can.Message(0, 0, is_extended_id=False, is_error_frame=True), ERROR_FLAG),
    ],
)
def test_identifiers_that_do_not_exist_are_no_base_format_ones(found, identifier):
    with Interface(found) as bus:
        (read,) = PythonCanPort(bus, SimulatedClock()).collect(0.0)
    assert read.identifier == identifier
    assert 0 <= read.identifier < 1 << 32


def test_frames_of_can_fd_are_passed_over() -> None:
    flexible = can.Message(0, 0x181, is_extended_id=False, is_fd=True, data=bytes(8))
    with Interface(flexible, frame(0x182, b"\x01"), flexible) as bus:
        assert [f.identifier for f in PythonCanPort(bus, SimulatedClock()).collect(0.0)] == [0x182]
    with Interface(*[flexible] * (MAX_COLLECTED + 1)) as bus:
        assert PythonCanPort(bus, SimulatedClock()).collect(0.0) == []
        assert len(bus.messages) == 1


def test_a_server_that_reads_nothing_is_an_error_within_the_limit() -> None:
    """python-can's socketcand takes a time limit and does not heed it."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        served: list[socket.socket] = []

        def greet() -> None:
            connection, _ = listener.accept()
            served.append(connection)
            connection.sendall(b"< hi >")
            for _ in range(2):
                connection.recv(100)
                connection.sendall(b"< ok >")

        server = Thread(target=greet)
        server.start()
        host, number = listener.getsockname()
        bus = can.Bus(interface="socketcand", channel="can0", host=host, port=number)
        server.join()
        for part in vars(bus).values():
            if isinstance(part, socket.socket):
                part.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        port = PythonCanPort(bus, RealClock())
        longest = 0.0
        words = r"did not accept a frame for sending within 0\.1 s"
        with pytest.raises(OSError, match=words):  # noqa: PT012  (it is not known which of them finds no room)
            while True:
                began = time.monotonic()
                try:
                    port.transmit(0x7FF, bytes(8))
                finally:
                    longest = max(longest, time.monotonic() - began)
        assert SEND_LIMIT_S * 0.5 < longest < SEND_LIMIT_S + 1.0
        port.shutdown()
        served[0].close()


def test_a_server_that_is_gone_is_an_error_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """python-can would try for 10 s, and a drive would stay energised as long."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        host, number = listener.getsockname()
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"host": host, "port": number}))
    monkeypatch.setattr(can, "Bus", lambda **_: pytest.fail("python-can tries"))
    with pytest.raises(LinkError):
        CanopenLink.on_interface(RealClock(), "socketcand", "can0", 500_000).open()
