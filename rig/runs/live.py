"""Streams a recording to Foxglove and PlotJuggler by Foxglove's WebSocket protocol.

The stream only reads the recording, and has no way to command a bench. A browser lets every web
page open a WebSocket to this computer, and the protocol has no password. The address therefore
contains a token, and a request without the token is refused.

Each client receives each topic from its beginning and at its own pace: a record of the recording is
sent when the client has taken the record before.

Source: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
import struct
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple
from urllib.parse import parse_qs, urlsplit

from wsproto import ConnectionType, WSConnection
from wsproto.events import (
    AcceptConnection,
    BytesMessage,
    CloseConnection,
    Event,
    Ping,
    RejectConnection,
    RejectData,
    Request,
    TextMessage,
)
from wsproto.utilities import RemoteProtocolError

from rig.runs.mcap import ros
from rig.runs.mcap.layout import (
    EVENT_JSON_SCHEMA,
    EVENT_TOPIC,
    FRAMES_TOPIC,
    SAMPLE_TOPIC,
    decode_frames,
)
from rig.runs.mcap.reader import START, DamageError, Message, Piece, RecordFile

HOST: Final = "127.0.0.1"
NAMES: Final = frozenset({HOST, "localhost"})
"""Accepted names of this computer in the field ``Host``. A request with another name may come from
a web page whose owner makes this name point to this computer (DNS rebinding).
"""
APP: Final = "https://app.foxglove.dev"  # origin of Foxglove in a browser
PROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
MOST_CLIENTS: Final = 16
_REQUEST_S: Final = 5.0  # greatest time from the connection of a client to its request, s
_READ_BYTES: Final = 1 << 16
_LONGEST_MESSAGE: Final = 1 << 16  # greatest length of a message of a client, characters
_POLL_S: Final = 0.05  # period at which new data of the recording are read, s
_CLOCK_NS: Final = 20_000_000
"""Period, in ns of the recording's time, at which this time is sent to the client."""
_DATA: Final = struct.Struct("<BIQ")
_TIME: Final = struct.Struct("<BQ")
_ERROR: Final = 2


def layout(tool: Literal["foxglove", "plotjuggler"]) -> Path:
    """Return the path of the packaged layout file for a tool."""
    name = {"foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}[tool]
    return Path(__file__).parent / "layouts" / name


def refusal(request: Request, port: int, token: str | None) -> str | None:
    """Return why a request is refused, or None if it is accepted."""
    name, _, given_port = request.host.rpartition(":")
    if name not in NAMES or given_port != str(port):
        return f"Host is {request.host!r}, not {HOST}:{port}"
    if token is not None:
        given = parse_qs(urlsplit(request.target).query).get("token", [""])[0]
        if hmac.compare_digest(given.encode(), token.encode()):
            return None
        return "the address lacks the token of this start; use the address that the command printed"
    origins = [value.decode("latin-1") for key, value in request.extra_headers if key == b"origin"]
    if set(origins) <= {"", APP}:
        return None
    return (
        "the stream was started with --no-token and therefore refuses web pages, also the page of "
        f"{', '.join(origins)}; start `rig watch` without --no-token"
    )


@dataclass(frozen=True)
class Topic:
    """One topic of the stream."""

    name: str
    recorded: str
    encoding: str
    schema: tuple[str, str, bytes]


def _ros(name: str, recorded: str, kind: str, text: str) -> Topic:
    return Topic(name, recorded, ros.ENCODING, (kind, ros.SCHEMA_ENCODING, text.encode()))


TOPICS = (
    _ros(SAMPLE_TOPIC, SAMPLE_TOPIC, ros.SAMPLE_TYPE, ros.SAMPLE_TEXT),
    Topic(EVENT_TOPIC, EVENT_TOPIC, "json", ("loadrig.Event", "jsonschema", EVENT_JSON_SCHEMA)),
    _ros(ros.CAN_TOPIC, FRAMES_TOPIC, ros.FRAME_TYPE, ros.FRAME_TEXT),
    _ros(ros.SERIAL_TOPIC, FRAMES_TOPIC, ros.SERIAL_TYPE, ros.SERIAL_TEXT),
)
"""PlotJuggler reads only ROS 2 messages live; samples and frames are encoded so."""


class Outgoing(NamedTuple):
    """One message of the stream."""

    topic: str
    time_ns: int
    data: bytes


def outgoing(messages: Iterable[tuple[str, Message]], wanted: frozenset[str]) -> Iterator[Outgoing]:
    """Yield the messages of the stream that follow from a record, in recorded order."""
    for recorded, group in groupby(messages, lambda item: item[0]):
        rows = [message for _, message in group]
        if recorded == SAMPLE_TOPIC and recorded in wanted:
            for row, data in zip(rows, ros.samples([row.data for row in rows]), strict=True):
                yield Outgoing(SAMPLE_TOPIC, row.time_ns, data)
        elif recorded == EVENT_TOPIC and recorded in wanted:
            for row in rows:
                yield Outgoing(EVENT_TOPIC, row.time_ns, _json_without_nan(row.data))
        elif recorded == FRAMES_TOPIC and wanted & {ros.CAN_TOPIC, ros.SERIAL_TOPIC}:
            for row in rows:
                for frame in decode_frames(row.data):
                    serial = ros.is_serial(frame)
                    topic = ros.SERIAL_TOPIC if serial else ros.CAN_TOPIC
                    if topic in wanted:
                        data = ros.serial_bytes(frame) if serial else ros.can_frame(frame)
                        yield Outgoing(topic, row.time_ns, data)


def _json_without_nan(data: bytes) -> bytes:
    """Return an event as strict JSON: NaN and infinities become text."""
    found: list[str] = []

    def text(word: str) -> str:
        found.append(word)
        return word

    event = json.loads(data, parse_constant=text)
    return json.dumps(event).encode() if found else data


@dataclass(frozen=True)
class Offer:
    """Recording that is served, and how it is served."""

    recording: Path
    name: str  # name of the source that clients show
    token: str | None  # token that an address must contain, or None for no token
    # Length of the recorded part that a new subscriber gets, s, or None for all.
    last_s: float | None = None


async def serve(offer: Offer, port: int, started: Callable[[int], None]) -> None:
    """Serve the recording until the task is cancelled.

    Args:
        offer: Recording that is served.
        port: Port of this computer; 0 for a free port.
        started: Called with the port once clients can connect.

    Raises:
        OSError: The port cannot be used.
    """
    inside: set[asyncio.Task[None]] = set()

    async def opened(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        inside.add(task)
        try:
            full = len(inside) > MOST_CLIENTS
            await _Client(offer, reader, writer).serve(port, full)
        except (OSError, TimeoutError, RemoteProtocolError, StopAsyncIteration):
            pass  # the client has closed the connection, or sent no request of this protocol
        except asyncio.CancelledError:
            pass  # cancelled below; asyncio would report a raised exception as an error
        finally:
            inside.discard(task)
            writer.close()

    server = await asyncio.start_server(opened, HOST, port)
    port = server.sockets[0].getsockname()[1]
    async with server:
        started(port)
        try:
            await server.serve_forever()
        finally:
            for task in (tasks := list(inside)):
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


class _Client:
    """One client, to which the recording is sent."""

    def __init__(
        self, offer: Offer, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._offer, self._reader, self._writer = offer, reader, writer
        self._wire = WSConnection(ConnectionType.SERVER)
        self._topics: dict[int, str] = {}
        self._at: dict[int, int] = {}
        self._changed = asyncio.Event()
        self._clock_ns = -1

    async def serve(self, port: int, full: bool) -> None:
        """Answer the request of the client, then serve it until it closes the connection."""
        events = self._events()
        request = await asyncio.wait_for(anext(events), _REQUEST_S)
        if not isinstance(request, Request):
            return
        refused = refusal(request, port, self._offer.token)
        if refused is None and full:
            refused = f"{MOST_CLIENTS} clients are already connected; close one of them"
        if refused is not None:
            kind = [(b"content-type", b"text/plain; charset=utf-8")]
            await self._send(
                RejectConnection(status_code=403, headers=kind, has_body=True),
                RejectData(data=f"{refused}\n".encode()),
            )
            return
        spoken = next((name for name in PROTOCOLS if name in request.subprotocols), None)
        await self._send(AcceptConnection(subprotocol=spoken))
        await self._greet()
        with RecordFile(self._offer.recording) as file:
            tasks = [asyncio.ensure_future(self._feed(file))]
            tasks.append(asyncio.ensure_future(self._listen(events, file)))
            try:
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)

    async def _events(self) -> AsyncIterator[Event]:
        while data := await self._reader.read(_READ_BYTES):
            self._wire.receive_data(data)
            for event in self._wire.events():
                yield event

    async def _send(self, *events: Event) -> None:
        """Send events, and wait until the client has taken most of what was sent."""
        self._writer.write(b"".join(self._wire.send(event) for event in events))
        await self._writer.drain()

    async def _say(self, **message: Any) -> None:
        await self._send(TextMessage(data=json.dumps(message)))

    async def _greet(self) -> None:
        # Without other capabilities, a client cannot publish, call or set anything.
        await self._say(
            op="serverInfo",
            name=self._offer.name,
            capabilities=["time"],
            supportedEncodings=[],
            metadata={},
            sessionId=secrets.token_hex(8),
        )
        channels = [
            {
                "id": number,
                "topic": topic.name,
                "encoding": topic.encoding,
                "schemaName": topic.schema[0],
                "schemaEncoding": topic.schema[1],
                "schema": topic.schema[2].decode(),
            }
            for number, topic in enumerate(TOPICS, start=1)
        ]
        await self._say(op="advertise", channels=channels)

    async def _listen(self, events: AsyncIterator[Event], file: RecordFile) -> None:
        """Follow the client's subscriptions until the client closes the connection."""
        text = ""
        async for event in events:
            if isinstance(event, Ping):
                await self._send(event.response())
            elif isinstance(event, CloseConnection):
                await self._send(event.response())
                return
            elif isinstance(event, BytesMessage):
                await self._refuse("a client cannot publish")
            elif isinstance(event, TextMessage):
                text += event.data
                if len(text) > _LONGEST_MESSAGE:
                    return
                if event.message_finished:
                    await self._take(text, file)
                    text = ""

    async def _take(self, text: str, file: RecordFile) -> None:
        try:
            message = json.loads(text)
            if message["op"] == "subscribe":
                for each in message["subscriptions"]:
                    self._topics[int(each["id"])] = TOPICS[int(each["channelId"]) - 1].name
                    last_s = self._offer.last_s
                    at = START if last_s is None else file.since(last_s)
                    self._at[int(each["id"])] = at
            elif message["op"] == "unsubscribe":
                for number in message["subscriptionIds"]:
                    self._at.pop(int(number), None)
            else:
                await self._refuse(f"{message['op']!r} is not possible: this stream is read only")
        except (ValueError, TypeError, LookupError) as error:
            await self._refuse(f"not a message of this protocol: {error!r}")
        self._changed.set()

    async def _refuse(self, words: str) -> None:
        await self._say(op="status", level=_ERROR, message=words)

    async def _feed(self, file: RecordFile) -> None:
        """Send the recording, including later additions, until cancelled.

        At a damaged place the stream stops, and the client shows the reason.
        """
        while True:
            piece = None
            if self._at:
                offset = min(self._at.values())
                try:
                    piece = file.at(offset)
                except (DamageError, OSError) as error:
                    await self._refuse(f"the rest of the recording cannot be read: {error}")
                    self._at.clear()
                    continue
            if piece is not None:
                await self._hand(offset, piece)
                continue
            with suppress(TimeoutError):
                await asyncio.wait_for(self._changed.wait(), _POLL_S if self._at else None)
            self._changed.clear()

    async def _hand(self, offset: int, piece: Piece) -> None:
        """Send a piece to the subscriptions that are complete up to ``offset``; advance them."""
        ready = {self._topics[number]: number for number, at in self._at.items() if at == offset}
        events: list[Event] = []
        for item in outgoing(piece.messages, frozenset(ready)):
            if item.time_ns >= self._clock_ns + _CLOCK_NS:
                self._clock_ns = item.time_ns
                events.append(BytesMessage(data=_TIME.pack(2, item.time_ns)))
            head = _DATA.pack(1, ready[item.topic], item.time_ns)
            events.append(BytesMessage(data=head + item.data))
        # Meanwhile the client may end its subscription, or subscribe again.
        for number in ready.values():
            if piece.following is None:
                del self._at[number]
            else:
                self._at[number] = piece.following
        await self._send(*events)
