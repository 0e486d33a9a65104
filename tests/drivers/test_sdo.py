"""The SDO server against hand-made frames, and against canopen's client through the link."""

from __future__ import annotations

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

from .host import Host, frame

SCALARS = {
    0x6040: ("<H", 0, 0xFFFF),
    0x607A: ("<i", -(1 << 31), (1 << 31) - 1),
    0x6065: ("<I", 0, 0xFFFFFFFF),
    0x1017: ("<H", 0, 0xFFFF),
    0x6007: ("<h", 0, 3),
}


def make_server() -> SdoServer:
    return SdoServer(DeviceDictionary(DRIVE_EDS, 1), lambda: None)


def abort_code(response: bytes | None) -> int | None:
    assert response is not None
    return struct.unpack_from("<I", response, 4)[0] if response[0] == 0x80 else None


def download(index: int, subindex: int, data: bytes) -> bytes:
    return struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")


def upload(index: int, subindex: int = 0) -> bytes:
    return struct.pack("<BHB4x", 0x40, index, subindex)


@given(
    st.sampled_from(sorted(SCALARS)).flatmap(
        lambda i: st.tuples(st.just(i), st.integers(*SCALARS[i][1:]))
    )
)
def test_expedited_round_trip(case: tuple[int, int]) -> None:
    index, value = case
    server = make_server()
    data = struct.pack(SCALARS[index][0], value)
    assert abort_code(server.answer(download(index, 0, data))) is None
    response = server.answer(upload(index))
    assert response is not None
    size = 4 - (response[0] >> 2 & 3)
    assert response[0] & 0xE3 == 0x43
    assert response[4 : 4 + size] == data


@given(st.integers(-(1 << 31), (1 << 31) - 1))
def test_segmented_download_round_trip(value: int) -> None:
    server = make_server()
    data = struct.pack("<i", value)
    assert server.answer(struct.pack("<BHBI", 0x21, 0x607A, 0, 4)) == struct.pack(
        "<BHB4x", 0x60, 0x607A, 0
    )
    assert server.answer(bytes([(7 - 4) << 1 | 1]) + data.ljust(7, b"\0")) == b"\x20".ljust(
        8, b"\0"
    )
    assert server.answer(upload(0x607A))[4:] == data


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


def test_write_only_objects_cannot_be_read() -> None:
    dictionary = DeviceDictionary(DRIVE_EDS, 1)
    number = 0x6040 << 8
    entry = dictionary.entries[number]
    dictionary.entries[number] = type(entry)(**{**vars(entry), "readable": False})
    assert abort_code(SdoServer(dictionary, lambda: None).answer(upload(0x6040))) == 0x06010001


@pytest.mark.parametrize(
    ("value", "shown"), [(-1, 0), (0, 0), (65535, 65535), (65536, 65535), (10**400, 65535)]
)
def test_an_object_shows_the_nearest_value_that_it_holds(value: int, shown: int) -> None:
    dictionary = DeviceDictionary(DRIVE_EDS, 1)
    assert dictionary.entries[0x6040 << 8].code == "H"
    dictionary.values[0x6040 << 8] = value
    assert int.from_bytes(dictionary.read(0x6040, 0), "little") == shown


def test_segments_must_alternate_their_toggle_bit() -> None:
    server = make_server()
    server.answer(upload(0x1008))
    assert server.answer(b"\x60" + bytes(7))[0] & 0x10 == 0
    assert abort_code(server.answer(b"\x60" + bytes(7))) == 0x05030000


def test_a_segmented_download_must_keep_its_announced_length() -> None:
    server = make_server()
    server.answer(struct.pack("<BHBI", 0x21, 0x607A, 0, 4))
    assert abort_code(server.answer(bytes([(7 - 3) << 1 | 1]) + bytes(7))) == 0x06070010


def test_a_client_abort_ends_the_transfer() -> None:
    server = make_server()
    server.answer(upload(0x1008))
    assert server.answer(b"\x80" + bytes(7)) is None
    assert abort_code(server.answer(b"\x60" + bytes(7))) == 0x05040001


def test_text_and_numbers_through_the_link(host: Host) -> None:
    assert host.drive.read_text(0x1008) == "loadrig simulated drive"
    host.drive.write(0x607D, 1, -5)
    assert host.drive.read(0x607D, 1) == -5
    assert host.drive.read(0x1018, 2) == 0x402


def test_canopen_can_force_a_segmented_download(host: Host) -> None:
    host.drive.remote.sdo.download(0x607A, 0, struct.pack("<i", -123456), force_segment=True)
    assert host.drive.read(0x607A) == -123456


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
    host.bench.bus.frame_filters.append(lambda _t, i, d, sent: None if i == 0x601 else (i, d))
    before = host.clock.now_ns()
    with pytest.raises(LinkError, match=r"6041h:00h: no SDO response within 0\.3 s"):
        host.servo.state()
    assert 0.3e9 <= host.clock.now_ns() - before < 0.31e9


def test_a_stopped_node_answers_no_sdo(host: Host) -> None:
    host.bench.bus.send(frame(0x000, bytes([2, 1])))
    with pytest.raises(LinkError):
        host.drive.read(0x1000)


class LateWire:
    """A wire that delivers the given responses one by one, whatever was asked."""

    sdo_timeout_s = 0.3
    cycle = 0
    master_id = 127
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

    def send_message(self, identifier: int, data: bytes) -> None:
        """The frame goes nowhere."""


def late_client(*responses: bytes) -> PumpedSdoClient:
    wire = LateWire(*responses)
    wire.client = client = PumpedSdoClient(0x601, 0x581, canopen.ObjectDictionary(), wire)
    client.network = wire
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
