"""Streams recordings to Foxglove and PlotJuggler.

The modules here only read recordings, and have no way to command a bench.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
import socket
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, NamedTuple
from urllib.parse import parse_qs, urlsplit

from drivers.interfaces import RawFrame
from rig.common.errors import InputError
from rig.runs.mcap import ros
from rig.runs.mcap.layout import (
    EVENT_JSON_SCHEMA,
    EVENT_TOPIC,
    FRAMES_TOPIC,
    SAMPLE_TOPIC,
    decode_frames,
)
from rig.runs.mcap.reader import START, Message, Piece, Tail
from rig.runs.mcap.records import DamageError

HEAD_BYTES = 8192
"""Greatest length of the head of a request, bytes."""
END = b"\r\n\r\n"
NAMES = frozenset({"127.0.0.1", "localhost"})
"""Accepted names of this computer in the field ``Host``. A request with another name may come from
a web page whose owner makes this name point to this computer (DNS rebinding).
"""
APP = "https://app.foxglove.dev"
"""Origin of Foxglove in a browser."""
_PASSED = (
    "upgrade",
    "connection",
    "sec-websocket-key",
    "sec-websocket-version",
    "sec-websocket-protocol",
)
"""Fields of a request that the server behind the gate needs. The field for compression is left out,
because the session counts the bytes that pass, and loopback needs no compression.
"""


class RefusedError(Exception):
    """A request is refused; the message states the reason and the remedy."""


@dataclass(frozen=True)
class Gate:
    """Conditions that a request must meet.

    Attributes:
        port: The port at which the request arrived.
        token: The token that the address of the request must contain, or None for no token.
    """

    port: int
    token: str | None

    def pass_on(self, head: bytes, inner: str) -> bytes:
        """Return the head of a request for the server behind the gate.

        Args:
            head: Head of the request, with the blank line at its end.
            inner: Host and port of the server behind the gate.

        Raises:
            RefusedError: The request must not pass.
        """
        target, fields = _parse(head)
        host = fields.get("host", "")
        name, _, port = host.rpartition(":")
        if name not in NAMES or port != str(self.port):
            raise RefusedError(f"Host is {host!r}, not 127.0.0.1:{self.port}")
        if self.token is None:
            origin = fields.get("origin", "")
            if origin not in ("", APP):
                raise RefusedError(
                    "the stream was started with --no-token and therefore refuses web pages, "
                    f"also the page of {origin}; start `rig watch` without --no-token"
                )
        elif not self._carries_token(target):
            raise RefusedError(
                "the address lacks the token of this start; use the address "
                "that the command printed"
            )
        lines = [f"{key}: {fields[key]}" for key in _PASSED if key in fields]
        return "\r\n".join(["GET / HTTP/1.1", f"Host: {inner}", *lines]).encode("latin-1") + END

    def _carries_token(self, target: str) -> bool:
        given = parse_qs(urlsplit(target).query).get("token", [""])[0]
        return hmac.compare_digest(given.encode(), (self.token or "").encode())


def _parse(head: bytes) -> tuple[str, Mapping[str, str]]:
    """Return target and fields (names in lower case) of a GET request.

    Raises:
        RefusedError: The text is not a GET request, or a field occurs twice.
    """
    first, *rest = head.removesuffix(END).decode("latin-1").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or words[0] != "GET" or not words[2].startswith("HTTP/1."):
        raise RefusedError("not a WebSocket request")
    fields: dict[str, str] = {}
    for line in rest:
        name, colon, value = line.partition(":")
        key = name.lower()
        if not colon or key in fields:
            raise RefusedError(f"the field {name!r} of the request is malformed or repeated")
        fields[key] = value.strip()
    return words[1], fields


def refusal(words: str) -> bytes:
    """Return the answer to a request that is refused."""
    body = words.encode() + b"\n"
    head = (
        "HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain; charset=utf-8\r\n"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + body


_FILES = {"foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}


def layout(tool: Literal["foxglove", "plotjuggler"]) -> Path:
    """Return the path of the layout file for a tool."""
    return Path(__file__).parent / "layouts" / _FILES[tool]


@dataclass(frozen=True)
class Topic:
    """One topic of the stream.

    Attributes:
        name: Name of the topic for the client.
        recorded: Topic of the recording from which the messages come.
        encoding: Encoding of the messages.
        schema: Name, encoding and text of the definition of the messages.
    """

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
"""PlotJuggler reads only ROS 2 messages from a live stream; samples and frames are therefore
encoded as ROS 2 messages.
"""


class Outgoing(NamedTuple):
    """One message of the stream."""

    topic: str
    time_ns: int
    data: bytes


def outgoing(messages: Iterable[tuple[str, Message]], wanted: frozenset[str]) -> Iterator[Outgoing]:
    """Yield the messages of the stream that follow from a record of the recording, in recorded
    order.

    Args:
        messages: Recorded topic and message.
        wanted: Names of the topics that the client has subscribed to.
    """
    for recorded, group in groupby(messages, lambda item: item[0]):
        rows = [message for _, message in group]
        yield from _WRITERS[recorded](rows, wanted)


def _samples(rows: Sequence[Message], wanted: frozenset[str]) -> Iterator[Outgoing]:
    if SAMPLE_TOPIC in wanted:
        for row, data in zip(rows, ros.samples([row.data for row in rows]), strict=True):
            yield Outgoing(SAMPLE_TOPIC, row.time_ns, data)


def _events(rows: Sequence[Message], wanted: frozenset[str]) -> Iterator[Outgoing]:
    if EVENT_TOPIC in wanted:
        for row in rows:
            yield Outgoing(EVENT_TOPIC, row.time_ns, json_without_nan(row.data))


def _frames(rows: Sequence[Message], wanted: frozenset[str]) -> Iterator[Outgoing]:
    if not wanted & {ros.CAN_TOPIC, ros.SERIAL_TOPIC}:
        return
    for row in rows:
        for frame in decode_frames(row.data):
            item = _frame(row.time_ns, frame)
            if item.topic in wanted:
                yield item


def _frame(time_ns: int, frame: RawFrame) -> Outgoing:
    if ros.is_serial(frame):
        return Outgoing(ros.SERIAL_TOPIC, time_ns, ros.serial_bytes(frame))
    return Outgoing(ros.CAN_TOPIC, time_ns, ros.can_frame(frame))


_WRITERS: dict[str, Callable[[Sequence[Message], frozenset[str]], Iterator[Outgoing]]] = {
    SAMPLE_TOPIC: _samples,
    EVENT_TOPIC: _events,
    FRAMES_TOPIC: _frames,
}


def json_without_nan(data: bytes) -> bytes:
    """Return an event as strict JSON: NaN and infinities, which JSON lacks, become text.

    An event without NaN and infinities is returned unchanged.
    """
    found: list[str] = []

    def text(word: str) -> str:
        found.append(word)
        return word

    event = json.loads(data, parse_constant=text)
    return json.dumps(event).encode() if found else data


BACKLOG_MESSAGES = 1 << 16
IN_FLIGHT_BYTES = 1 << 20
"""Greatest number of bytes inside the server. The shortest message has 57 bytes with its frame, so
that fewer than :data:`BACKLOG_MESSAGES` messages are queued.
"""
_POLL_S = 0.05
"""Period at which new data of the recording are read, s."""
_SINK_POLL_S = 0.002
_CLOCK_NS = 20_000_000
"""Period, in ns of the recording's time, at which this time is sent to the client."""
_CLOCK_BYTES = 11


def sdk() -> Any:
    """Import the Foxglove SDK.

    Raises:
        InputError: The Foxglove SDK is not installed.
    """
    try:
        import foxglove
        import foxglove.websocket
    except ImportError as error:
        raise InputError(
            "--foxglove needs the Foxglove SDK, which is not installed; install it with: pip "
            "install 'loadrig[live]'"
        ) from error
    return foxglove


class Session:
    """Sends the recording to one client.

    Args:
        name: Name of the source that the client shows.
        host: Address on which the server of this client listens.
        tail: The recording.
        last_s: Length of the recorded part that a new subscriber gets, s, or None for all.
    """

    def __init__(self, name: str, host: str, tail: Tail, last_s: float | None) -> None:
        foxglove = sdk()
        self._foxglove = foxglove
        self._loop = asyncio.get_running_loop()
        self._tail = tail
        self._last_s = last_s
        self._at: dict[str, int] = {}
        self._changed = asyncio.Event()
        self._handed = self._passed = 0
        self._clock_ns = -1
        # The SDK deletes the channels of a context with the context.
        self._context = context = foxglove.Context()
        self._channels: Mapping[str, Any] = {
            topic.name: foxglove.Channel(
                topic.name,
                schema=foxglove.Schema(
                    name=topic.schema[0], encoding=topic.schema[1], data=topic.schema[2]
                ),
                message_encoding=topic.encoding,
                context=context,
            )
            for topic in TOPICS
        }
        # Without capabilities, a client cannot publish, call or set anything.
        self._server = foxglove.start_server(
            name=name,
            host=host,
            port=0,
            capabilities=[foxglove.websocket.Capability.Time],
            server_listener=_Listener(self),
            context=context,
            message_backlog_size=BACKLOG_MESSAGES,
        )
        self.address = (host, int(self._server.port))

    def subscribed(self, topic: str) -> None:
        """Accept a subscription; called from the server's thread."""
        self._loop.call_soon_threadsafe(self._set, topic, True)

    def unsubscribed(self, topic: str) -> None:
        """Remove a subscription; called from the server's thread."""
        self._loop.call_soon_threadsafe(self._set, topic, False)

    def passed(self, size: int) -> None:
        """Count bytes that have left the server."""
        self._passed += size
        self._changed.set()

    async def feed(self) -> None:
        """Pass the recording, including later additions, to the server until cancelled.

        At a damaged place the stream stops, and the client shows the reason.
        """
        while True:
            if not self._at:
                await self._wait(None)
                continue
            if not all(self._channels[name].base.has_sinks() for name in self._at):
                # The SDK calls the listener before a message would reach the subscriber.
                await asyncio.sleep(_SINK_POLL_S)
                continue
            offset = min(self._at.values())
            try:
                piece = self._tail.at(offset)
            except (DamageError, OSError) as error:
                self._say(f"the rest of the recording cannot be read: {error}")
                self._at.clear()
                continue
            if piece is None:
                await self._wait(_POLL_S)
            else:
                await self._hand(offset, piece)

    async def close(self) -> None:
        """Stop the server."""
        for channel in self._channels.values():
            channel.close()
        await asyncio.to_thread(self._server.stop)

    def _set(self, topic: str, wanted: bool) -> None:
        if not wanted:
            self._at.pop(topic, None)
        else:
            self._at[topic] = START if self._last_s is None else self._tail.since(self._last_s)
        self._changed.set()

    async def _hand(self, offset: int, piece: Piece) -> None:
        """Pass the messages of a piece to the topics that are complete up to ``offset``, and
        advance these topics.
        """
        topics = frozenset(name for name, at in self._at.items() if at == offset)
        for item in outgoing(piece.messages, topics):
            await self._room()
            if self._at.get(item.topic) == offset:
                self._log(item)
        for name in topics:
            # Meanwhile the client may have ended its subscription, or subscribed again.
            if self._at.get(name) == offset:
                if piece.following is None:
                    del self._at[name]
                else:
                    self._at[name] = piece.following
        await asyncio.sleep(0)

    def _log(self, item: Outgoing) -> None:
        if item.time_ns >= self._clock_ns + _CLOCK_NS:
            self._clock_ns = item.time_ns
            self._server.broadcast_time(item.time_ns)
            self._handed += _CLOCK_BYTES
        self._channels[item.topic].log(item.data, log_time=item.time_ns)
        self._handed += framed(len(item.data))

    async def _room(self) -> None:
        while self._handed - self._passed > IN_FLIGHT_BYTES:
            await self._wait(None)

    async def _wait(self, timeout_s: float | None) -> None:
        try:
            await asyncio.wait_for(self._changed.wait(), timeout_s)
        except TimeoutError:
            return
        self._changed.clear()

    def _say(self, words: str) -> None:
        self._server.publish_status(words, self._foxglove.StatusLevel.Error)


class _Listener:
    """Receives the subscriptions of the client. The SDK calls other methods of a listener only for
    capabilities that the server does not have.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    def on_subscribe(self, client: object, channel: Any) -> None:
        """Pass a new subscription to the session."""
        self._session.subscribed(channel.topic)

    def on_unsubscribe(self, client: object, channel: Any) -> None:
        """Pass the end of a subscription to the session."""
        self._session.unsubscribed(channel.topic)


def framed(size: int) -> int:
    """Return the number of bytes that a message of ``size`` bytes has in the stream: with opcode,
    subscription and time (13 bytes), in one WebSocket frame (RFC 6455, 5.2).
    """
    payload = size + 13
    return payload + (2 if payload < 126 else 4 if payload < 65536 else 10)


HOST = "127.0.0.1"
MOST_CLIENTS = 16
_HEAD_S = 5.0
"""Greatest time from the connection of a client to its first request, s."""
_READ_BYTES = 1 << 16


@dataclass(frozen=True)
class Offer:
    """Recording that is served, and how it is served.

    Attributes:
        recording: The file.
        name: Name of the source that clients show.
        token: Token that an address must contain, or None for no token.
        last_s: Length of the recorded part that a new subscriber gets, s, or None for all.
    """

    recording: Path
    name: str
    token: str | None
    last_s: float | None = None


def inner_host() -> str:
    """Return the address on which the servers behind the gate listen.

    If the system accepts every address of 127.0.0.0/8 without set-up, as Linux does, a random
    address is used, because no web page can try all of these addresses.
    """
    drawn = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
    with socket.socket() as probe:
        try:
            probe.bind((drawn, 0))
        except OSError:
            return HOST
    return drawn


async def serve(offer: Offer, port: int, started: Callable[[int], None]) -> None:
    """Serve the recording until the task is cancelled.

    Args:
        offer: Recording that is served.
        port: Port of this computer; 0 for a free port.
        started: Called with the port once clients can connect.

    Raises:
        OSError: The port cannot be used.
    """
    doors = _Doors(offer, inner_host())
    server = await asyncio.start_server(doors.open, HOST, port, limit=HEAD_BYTES)
    doors.port = server.sockets[0].getsockname()[1]
    async with server:
        started(doors.port)
        try:
            await server.serve_forever()
        finally:
            await doors.close()


class _Doors:
    """Accepts clients, and starts a session for each."""

    def __init__(self, offer: Offer, inner: str) -> None:
        self._offer = offer
        self._inner = inner
        self._inside: set[asyncio.Task[None]] = set()
        self.port = 0

    async def open(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client from its request to the end of its connection."""
        task = asyncio.current_task()
        assert task is not None
        self._inside.add(task)
        try:
            await self._serve(reader, writer)
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            pass  # the client has closed the connection, or sent no request in time
        except asyncio.CancelledError:
            pass  # cancelled by :meth:`close`; asyncio would report a raised exception as an error
        finally:
            self._inside.discard(task)
            writer.close()

    async def close(self) -> None:
        """End every session."""
        inside = list(self._inside)
        for task in inside:
            task.cancel()
        await asyncio.gather(*inside, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await asyncio.wait_for(reader.readuntil(END), _HEAD_S)
        gate = Gate(self.port, self._offer.token)
        try:
            gate.pass_on(head, "")
            if len(self._inside) > MOST_CLIENTS:
                raise RefusedError(
                    f"{MOST_CLIENTS} clients are already connected; close one of them"
                )
        except RefusedError as error:
            writer.write(refusal(str(error)))
            await writer.drain()
            return
        with Tail(self._offer.recording) as tail:
            session = Session(self._offer.name, self._inner, tail, self._offer.last_s)
            try:
                host, port = session.address
                inner_reader, inner_writer = await asyncio.open_connection(host, port)
                try:
                    inner_writer.write(gate.pass_on(head, f"{host}:{port}"))
                    await _until_one_ends(
                        _pump(reader, inner_writer, None),
                        _pump(inner_reader, writer, session.passed),
                        session.feed(),
                    )
                finally:
                    inner_writer.close()
            finally:
                await session.close()


async def _pump(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    count: Callable[[int], None] | None,
) -> None:
    while data := await reader.read(_READ_BYTES):
        writer.write(data)
        await writer.drain()
        if count is not None:
            count(len(data))


async def _until_one_ends(*work: Coroutine[Any, Any, None]) -> None:
    """Run all tasks until the first task ends, then cancel the others; raise the error of the first
    task.
    """
    tasks = [asyncio.ensure_future(one) for one in work]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
