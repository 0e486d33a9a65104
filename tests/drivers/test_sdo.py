"""The SDO server against hand-made frames, and against canopen's client through the link."""

import struct
from collections.abc import Callable

import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.sdo import PumpedSdoClient
from drivers.errors import ConfigurationError, LinkError, ObjectAccessError
from drivers.mock.canopen.dictionary import DeviceDictionary
from drivers.mock.canopen.node import SdoServer
from drivers.mock.drive import DRIVE_EDS

from .host import Host


def make_server() -> SdoServer:
    return SdoServer(DeviceDictionary(DRIVE_EDS, 1), lambda: None)


def abort_code(response: bytes | None) -> int | None:
    return struct.unpack_from("<I", response, 4)[0] if response[0] == 0x80 else None


def download(index: int, subindex: int, data: bytes) -> bytes:
    return struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")


def upload(index: int, subindex: int = 0) -> bytes:
    return struct.pack("<BHB4x", 0x40, index, subindex)


@given(st.lists(st.binary(min_size=0, max_size=9), max_size=20))
def test_any_bytes_get_one_whole_answer_or_none(requests: list[bytes]) -> None:
    server = make_server()
    for request in requests:
        response = server.answer(request)
        assert response is None or len(response) == 8
    assert abort_code(server.answer(upload(0x1000))) is None


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (upload(0x5000), 0x06020000),
        (upload(0x6041, 1), 0x06090011),
        (upload(0x607D, 3), 0x06090011),
        (download(0x5000, 0, b"\0"), 0x06020000),
        (download(0x6041, 0, b"\0\0"), 0x06010002),
        (download(0x1008, 0, b"abcd"), 0x06010002),
        (download(0x6040, 0, b"\0"), 0x06070010),
        (download(0x6040, 0, bytes(4)), 0x06070010),
        (download(0x6007, 0, struct.pack("<h", 4)), 0x06090030),
        (download(0x6007, 0, struct.pack("<h", -1)), 0x06090030),
        (b"\xa0" + bytes(7), 0x05040001),
        (b"\x60" + bytes(7), 0x05040001),
        (b"\x00" + bytes(7), 0x05040001),
    ],
)
def test_refusals(request_: bytes, code: int) -> None:
    assert abort_code(make_server().answer(request_)) == code


def test_refusals_become_errors_that_name_the_object(host: Host) -> None:
    with pytest.raises(
        ObjectAccessError, match=r"6007h:00h: node 1 refuses the access: Value range .*06090030h"
    ) as caught:
        host.drive.write(0x6007, 0, 9)
    assert (caught.value.index, caught.value.code) == (0x6007, 0x06090030)
    with pytest.raises(ConfigurationError, match="not in the device's EDS"):
        host.drive.read(0x5FFF)
    with pytest.raises(ConfigurationError, match="70000 does not fit"):
        host.drive.write(0x6040, 0, 70000)


def test_no_answer_is_a_link_error(host: Host) -> None:
    host.lose(0x601)
    before = host.clock.now_ns()
    with pytest.raises(LinkError, match=r"6041h:00h: no SDO response within 0\.3 s"):
        host.servo.state()
    assert 0.3e9 <= host.clock.now_ns() - before < 0.31e9


class LateWire:
    """A wire that delivers the given responses one by one, whatever was asked."""

    sdo_timeout_s = 0.3
    alive_until_ns = 0

    def keep_alive(self) -> None:
        pass

    def __init__(self, *responses: bytes) -> None:
        self._left = list(responses)
        self.client: PumpedSdoClient

    def pump(self, ready: Callable[[], bool], timeout_s: float) -> bool:
        if self._left:
            self.client.responses.put(self._left.pop(0))
        return ready()

    def send(self, identifier: int, data: bytes) -> None:
        """The frame goes nowhere."""


def late_client(*responses: bytes) -> PumpedSdoClient:
    wire = LateWire(*responses)
    wire.client = client = PumpedSdoClient(1, canopen.ObjectDictionary(), wire)
    return client


READ_6041 = bytes.fromhex("4041600000000000")
LATE_6064 = bytes.fromhex("4364600001000000")
ANSWER_6041 = bytes.fromhex("4B41600050020000")


def test_a_late_answer_to_another_request_is_passed_over() -> None:
    assert late_client(LATE_6064, ANSWER_6041).request_response(READ_6041) == ANSWER_6041
    late_abort = bytes.fromhex("8064600000000205")
    assert late_client(late_abort, ANSWER_6041).request_response(READ_6041) == ANSWER_6041


def test_only_late_answers_are_none() -> None:
    with pytest.raises(SdoCommunicationError, match="no SDO response"):
        late_client(LATE_6064).request_response(READ_6041)


@pytest.mark.parametrize("abort", ["8041600000000206", "8000000000000206"])
def test_an_abort_is_taken_with_or_without_the_object(abort: str) -> None:
    with pytest.raises(SdoAbortedError):
        late_client(bytes.fromhex(abort)).request_response(READ_6041)
