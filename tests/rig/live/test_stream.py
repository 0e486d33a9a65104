"""The stream against the recording, read by a plain WebSocket client by the published protocol:
every value to the last bit, while the recording grows and when it is complete. Also `rig watch` as
a shell starts it, and the layouts that it names.
"""

import asyncio
import json
import math
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import foxglove.layouts
import numpy as np
import pytest
from mcap_ros2._dynamic import generate_dynamic
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from wsproto.events import Request

from drivers.can.port import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from drivers.interfaces import RawFrame
from drivers.serial_port import SERIAL_FLAG
from rig.cli.entry import status
from rig.common.sample import Sample
from rig.runs.live import HOST, TOPICS, Offer, layout, refusal, serve
from rig.runs.mcap.layout import FRAMES_TOPIC, SAMPLE_TOPIC, decode_frames
from rig.runs.mcap.reader import Log, read_run
from rig.runs.recorder import Recorder, open_recorder
from tests.rig.conftest import run_in

PROTOCOL = "foxglove.sdk.v1"
NAN = struct.unpack("<d", b"\x01\x02\x03\x04\x05\x06\xf8\x7f")[0]
WAIT_S = 60.0


def sample(k: int) -> Sample:
    values = [math.sin(k * 0.001 + n) * 10.0 ** (n - 6) for n in range(13)]
    values[0] = k * 1e-3
    return Sample(*values, statusword=0x27, segment=1, fresh=k % 7 != 0, pressure=NAN)  # type: ignore[misc]


def frames(k: int) -> list[RawFrame]:
    time_ns = k * 1_000_000 + 5_000_000_000
    return [
        RawFrame(time_ns, 0x80, b"", True),
        RawFrame(time_ns + 1, 0x181, struct.pack("<q", k), False),
        RawFrame(time_ns + 2, 0x18FF1234 | EXTENDED_FLAG, b"\x00\xff", False),
        RawFrame(time_ns + 3, 0x7A | REMOTE_FLAG, b"", True),
        RawFrame(time_ns + 4, 0x20 | ERROR_FLAG, bytes(8), False),
        RawFrame(time_ns + 5, SERIAL_FLAG | 0x54, b"\x54", True),
        RawFrame(time_ns + 6, SERIAL_FLAG | 0x54, bytes(range(8)), False),
    ]


def record(recorder: Recorder, begin: int, end: int, step: int = 10) -> None:
    for k in range(begin, end):
        recorder.sample(k * 1_000_000, sample(k), frames(k) if k % step == 0 else [])
    recorder.event(end * 1_000_000, "moved", to=end / 7, limit=math.nan)


@contextmanager
def served(path: Path, token: str | None = "secret", last_s: float | None = None) -> Iterator[str]:
    """Serve a recording in a thread; yields the address."""
    ports: list[int] = []
    ready = threading.Event()
    loop = asyncio.new_event_loop()

    def started(port: int) -> None:
        ports.append(port)
        ready.set()

    task = loop.create_task(serve(Offer(path, "test", token, last_s), 0, started))

    def run() -> None:
        try:
            loop.run_until_complete(task)
        except asyncio.CancelledError:
            pass
        finally:
            loop.close()
            ready.set()

    thread = threading.Thread(target=run)
    thread.start()
    assert ready.wait(WAIT_S)
    query = "" if token is None else f"/?token={token}"
    try:
        yield f"ws://{HOST}:{ports[0]}{query}"
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join()


class Client:
    """Subscribes by name, and sorts what comes by topic."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.info = json.loads(socket.recv(WAIT_S))
        self.channels: dict[str, Any] = {}
        while len(self.channels) < 4:
            self._text(socket.recv(WAIT_S))
        self.received: dict[str, list[tuple[int, bytes]]] = {name: [] for name in self.channels}
        self.times: list[int] = []
        self.status: list[str] = []

    def _text(self, text: str | bytes) -> None:
        message = json.loads(text)
        if message["op"] == "advertise":
            self.channels |= {channel["topic"]: channel for channel in message["channels"]}
        elif message["op"] == "status":
            self.status.append(message["message"])

    def subscribe(self, *topics: str) -> None:
        items = [{"id": n["id"] + 100, "channelId": n["id"]} for n in map(self._channel, topics)]
        self.send({"op": "subscribe", "subscriptions": items})

    def _channel(self, topic: str) -> Any:
        return self.channels[topic]

    def send(self, message: Any) -> None:
        self._socket.send(json.dumps(message))

    def until(self, done: Callable[[], bool]) -> None:
        names = {channel["id"] + 100: topic for topic, channel in self.channels.items()}
        while not done():
            message = self._socket.recv(WAIT_S)
            if isinstance(message, str):
                self._text(message)
            elif message[0] == 1:
                number, time_ns = struct.unpack_from("<IQ", message, 1)
                self.received[names[number]].append((time_ns, message[13:]))
            else:
                self.times.append(struct.unpack_from("<Q", message, 1)[0])

    def count(self, topic: str) -> int:
        return len(self.received[topic])

    def decoded(self, topic: str) -> list[tuple[int, Any]]:
        """Decode by the definition that came with the channel, as Foxglove and ROS do."""
        channel = self.channels[topic]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        name = channel["schemaName"]
        decode = generate_dynamic(name, channel["schema"])[name]
        return [(time_ns, decode(data)) for time_ns, data in self.received[topic]]


@contextmanager
def client(address: str) -> Iterator[Client]:
    with connect(address, subprotocols=[PROTOCOL], max_size=None, close_timeout=0.2) as socket:  # type: ignore[list-item]
        yield Client(socket)


def stamped(message: Any, number: int) -> RawFrame:
    """Return a frame from its message, with its number on the wire."""
    stamp = message.header.stamp
    time_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    data = bytes(message.data)[: getattr(message, "dlc", None)]
    return RawFrame(time_ns, number, data, message.header.frame_id == "sent")


def assert_equal(got: Client, log: Log) -> None:
    """Compare all topics with the recording, bit by bit."""
    rows = got.decoded("/sample")
    assert [time_ns for time_ns, _ in rows] == [m.time_ns for m in log.messages[SAMPLE_TOPIC]]
    for name, expected in log.samples.items():
        values = np.array([getattr(row, name) for _, row in rows])
        assert values.tobytes() == expected.tobytes(), name
    events = [json.loads(data) for _, data in got.received["/event"]]
    assert [event["time"] for event in events] == [event["time"] for event in log.events]
    assert [event["to"] for event in events] == [event["to"] for event in log.events]
    found = [(time_ns, stamped(m, m.line | SERIAL_FLAG)) for time_ns, m in got.decoded("/serial")]
    for time_ns, m in got.decoded("/can"):
        flags = m.is_rtr * REMOTE_FLAG | m.is_extended * EXTENDED_FLAG | m.is_error * ERROR_FLAG
        found.append((time_ns, stamped(m, m.id | flags)))
    expected_frames = [
        (message.time_ns, frame)
        for message in log.messages[FRAMES_TOPIC]
        for frame in decode_frames(message.data)
    ]
    assert sorted(found, key=lambda item: (item[0], item[1].time_ns)) == expected_frames


def test_a_growing_recording_arrives_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "recording.mcap"
    recorder = open_recorder(path)
    record(recorder, 0, 400)
    with served(path) as address, client(address) as got:
        got.subscribe(*got.channels)
        # Topics are asked for one after another; an event may arrive before the samples.
        got.until(lambda: (got.count("/event"), got.count("/sample")) == (1, 400))
        record(recorder, 400, 1000)
        got.until(lambda: (got.count("/event"), got.count("/sample")) == (2, 1000))
        record(recorder, 1000, 1300)
        recorder.close()
        got.until(lambda: (got.count("/event"), got.count("/sample")) == (3, 1300))
        assert_equal(got, read_run(path))
        assert got.times == sorted(got.times)
        assert got.times[-1] >= 1_270_000_000


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "recording.mcap"
    recorder = open_recorder(path)
    record(recorder, 0, 6_000)
    recorder.close()
    return path


def test_a_finished_recording_is_sent_from_its_start_to_each_client(whole: Path) -> None:
    with served(whole) as address, client(address) as one, client(address) as other:
        one.subscribe(*one.channels)
        other.subscribe("/sample")
        other.until(lambda: other.count("/sample") == 6_000)
        # The one reads nothing meanwhile, and the server waits for it; it gets everything.
        one.until(lambda: (one.count("/event"), one.count("/sample")) == (1, 6_000))
        assert_equal(one, read_run(whole))
        # A topic that is asked for later comes from its beginning too.
        other.subscribe("/event")
        other.until(lambda: other.count("/event") == 1)


def test_only_the_last_seconds_on_request(whole: Path) -> None:
    with served(whole, last_s=2.0) as address, client(address) as got:
        got.subscribe("/sample", "/event")
        got.until(lambda: got.count("/event") == 1)
        (first, _), *_, (last, _) = got.received["/sample"]
        assert 3_800_000_000 < first <= 4_000_000_000
        assert last == 5_999_000_000


def test_a_client_can_change_nothing(whole: Path) -> None:
    with served(whole) as address, client(address) as got:
        assert got.info["capabilities"] == ["time"]
        before = whole.read_bytes()
        channel = {"id": 1, "topic": "/command", "encoding": "json", "schemaName": "x"}
        got.send({"op": "advertise", "channels": [channel]})
        got.send({"op": "setParameters", "parameters": [{"name": "torque", "value": 1}]})
        got.until(lambda: len(got.status) == 2)
        assert whole.read_bytes() == before


def test_damage_is_said_and_what_is_before_it_arrives(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    with served(path) as address, client(address) as got:
        got.subscribe("/sample")
        got.until(lambda: bool(got.status))
        assert "the rest of the recording cannot be read: a chunk" in got.status[0]
        assert 2_000 < got.count("/sample") < 4_000


def test_a_wrong_token_is_refused(whole: Path) -> None:
    with served(whole) as address:
        bare = address.partition("/?")[0]
        for query in ("", "/?token="):
            with (
                pytest.raises(InvalidStatus) as refused,
                connect(bare + query, subprotocols=[PROTOCOL]),  # type: ignore[list-item]
            ):
                pass
            assert refused.value.response.status_code == 403
        # What is no request of a WebSocket ends that connection alone.
        port = int(bare.rpartition(":")[2])
        for sent in (b"POST / HTTP/1.1\r\nHost: x\r\n\r\n", b"\xff\xfe\x00\r\n\r\n"):
            with socket.create_connection((HOST, port), timeout=WAIT_S) as other:
                other.sendall(sent)
                assert b"101" not in other.recv(4096)
        with client(address) as got:
            assert got.info["op"] == "serverInfo"


def passes(host: str, target: str, origin: str, token: str | None) -> bool:
    request = Request(host=host, target=target, extra_headers=[(b"origin", origin.encode())])
    return refusal(request, 8765, token) is None


def test_a_request_needs_the_token_and_a_name_of_this_computer() -> None:
    own, right, token = "127.0.0.1:8765", "/?token=abc-123", "abc-123"
    # The page of another site has the token only if its user gave it the address.
    for host in (own, "localhost:8765"):
        assert passes(host, right, "https://a.example", token)
    for target in ("/", "/?token=abc-12", "/?token=abc-123x", "/?token=Abc-123", "/?Token=abc-123"):
        assert not passes(own, target, "", token)
    for host in ("127.0.0.1", "127.0.0.1:8766", "evil.example:8765", "127.0.0.1.evil.example:8765"):
        assert not passes(host, right, "", token)


def test_without_a_token_no_foreign_page_may_watch() -> None:
    for origin in ("", "https://app.foxglove.dev"):
        assert passes("127.0.0.1:8765", "/", origin, None)
    for origin in ("https://app.foxglove.dev.evil.example", "http://localhost:3000", "null"):
        assert not passes("127.0.0.1:8765", "/", origin, None)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(run_in(tmp_path_factory.mktemp("run")).path)


def test_an_address_is_printed_served_and_given_up_at_ctrl_c(run: str) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    start = "from rig.cli.entry import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", start, "watch", run, "--foxglove", "--port", "0"],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        text = ""
        while "Ctrl-C" not in text:
            line = process.stdout.readline()
            assert line, text
            text += line
        address = re.search(r"ws://127\.0\.0\.1:\d+/\?token=\S+", text)
        with connect(address.group(), subprotocols=["foxglove.sdk.v1"]) as client:  # type: ignore[list-item]
            info = json.loads(client.recv(60))
            # With a client connected, Ctrl-C ends it as well.
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=60)
    assert process.returncode == 0
    assert "simulated bench" in info["name"]
    assert str(layout("foxglove")) in text
    assert "REAL" not in text


def test_what_is_asked_wrongly(run: str, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        assert status(["watch", run, "--foxglove", "--port", port]) == 2
        assert f"--port: {port} cannot be used" in capsys.readouterr().err
    assert status(["watch", run]) == 2
    assert status(["watch", run, "--foxglove", "--part", "2"]) == 2
    assert "has 1 recording (got 2)" in capsys.readouterr().err


def _values(item: Any) -> Iterator[str]:
    if isinstance(item, dict):
        for key, value in item.items():
            if key in ("value", "topicPath"):
                yield value
            else:
                yield from _values(value)
    elif isinstance(item, list):
        for value in item:
            yield from _values(value)


def test_the_layout_for_foxglove_shows_topics_and_fields_that_are_served() -> None:
    content = json.loads(layout("foxglove").read_text(encoding="utf-8"))
    served = {topic.name for topic in TOPICS} | {f"/sample.{name}" for name in Sample._fields}
    named = set(_values(content["configById"]))
    assert len(named) > 6
    assert named <= served
    assert _places(content["layout"]) == set(content["configById"])
    # Its keys are those that the SDK writes.
    known = {
        "Plot": set(foxglove.layouts.PlotConfig()._to_dict()),
        "RawMessages": set(foxglove.layouts.RawMessagesConfig()._to_dict()),
    }
    series = set(foxglove.layouts.PlotSeries()._to_dict())
    for name, config in content["configById"].items():
        assert set(config) <= known[name.partition("!")[0]] | {"foxglovePanelTitle"}, name
        for path in config.get("paths", []):
            assert set(path) <= series


def _places(tree: Any) -> set[str]:
    return {tree} if isinstance(tree, str) else _places(tree["first"]) | _places(tree["second"])


def test_the_layout_for_plotjuggler_shows_fields_that_are_served() -> None:
    tree = ET.parse(layout("plotjuggler")).getroot()
    served = {f"/sample/{name}" for name in Sample._fields}
    curves = list(tree.iter("curve"))
    assert len(curves) > 5
    for curve in curves:
        if "curve_x" in curve.attrib:
            assert {curve.attrib["curve_x"], curve.attrib["curve_y"]} <= served
        else:
            assert curve.attrib["name"] in served
    for splitter in tree.iter("DockSplitter"):
        count = int(splitter.attrib["count"])
        assert count == len(splitter) == len(splitter.attrib["sizes"].split(";"))
    # PlotJuggler keeps this window and looks for this stream by name.
    assert tree.find("tabbed_widget").attrib["name"] == "Main Window"  # type: ignore[union-attr]
    assert tree.find("previouslyLoaded_Streamer").attrib["name"] == "Foxglove ROS2 Bridge"  # type: ignore[union-attr]
